"""Small frames through the whole pipeline: compiles every Numba kernel for the types of measurements.

Several processes compile its stages at once. The pipeline then finds their machine code and compiles what is left.
No two processes compile a kernel for different types at the same time, which Numba's files do not allow.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import xarray as xr

from fringedic.correlation import cell_kernels, measure_displacement, node_kernels
from fringedic.correlation.dense import BRIGHTNESS_PASSES, RELAXATIONS
from fringedic.correlation.window import design_window
from fringedic.frames.collector import Stack
from fringedic.models.sampling import sample
from fringedic.phase.beats import combine_beats
from fringedic.steps.displacement_tracker import DisplacementTracker, white_texture
from fringedic.steps.parameters import CouplingParameters, DicParameters, PhaseParameters
from fringedic.steps.phase import phase_step
from fringedic.steps.rehearsal import (
    SIZE,
    WINDOW,
    at_rest,
    rehearse_coupling,
    set_writable,
    small_moving_stack,
    small_rig,
    small_stack,
)
from fringedic.steps.shape_tracker import ShapeTracker
from fringedic.surface import PreparedShape, couple, surface_strain, to_local_frame
from fringedic.surface.planes import fit_planes
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration, preset

_PHASE = PhaseParameters(lens_blur_px=0.5)
DENSE = {"window_px": 32, "method": "dense"}


def _twice_exposed(stack: Stack) -> Stack:
    """Return the same frames as if each pattern had two exposure times."""
    records = [
        replace(record, index=2 * record.index + number, count=2 * record.count, exposure_time=0.01 * (number + 1))
        for record in stack.records
        for number in (0, 1)
    ]
    return replace(stack, records=records, frames=np.repeat(stack.frames, 2, axis=0))


def warm_up() -> None:
    """Process small frames by the whole pipeline, with the time that each part takes on standard output.

    Raises
    ------
    RuntimeError
        A process beside this one has failed; its traceback is on standard error.
    """
    parts = (_nodes, _surface, _phase, _virtual_rig, _model)
    processes = [get_context("spawn").Process(target=part) for part in parts]
    for process in processes:
        process.start()
    _displacement()
    for process in processes:
        process.join()
    if any(process.exitcode for process in processes):
        raise RuntimeError("a part of the kernels was not compiled: read the reason above, mend it and start again")
    with _part("whole pipeline"):
        for dtype in (np.uint8, np.uint16):
            _pipeline(dtype)
        _discontinuous_surface()
        rehearse_coupling()


def _pipeline(dtype: type[np.unsignedinteger]) -> None:
    """Measure three steps as the nodes do; what the parts have not compiled is compiled here."""
    tracker = DisplacementTracker(DicParameters())
    shapes = ShapeTracker(CouplingParameters(local_frame_window_px=WINDOW, strain_window_px=WINDOW))
    shapes.set_calibration(small_rig())
    for step in (0, 1, 2):
        phase = phase_step(small_stack(dtype, step), _PHASE)
        # nodes work on read-only arrays of messages, for which kernels are compiled, too
        set_writable(phase.maps, step != 2)
        found = tracker.step(phase.experiment, phase.step, phase.stamp, phase.texture)
        set_writable(found.field, step != 2)
        shapes.step(phase, found)


def _phase() -> None:
    with _part("phase"):
        for dtype in (np.uint8, np.uint16):
            phase_step(small_stack(dtype, 0), _PHASE)
            phase_step(_twice_exposed(small_stack(dtype, 0)), _PHASE)
            phase_step(small_moving_stack(dtype), _PHASE)
        alike = np.zeros((2, 1, 1), np.float32)
        combine_beats(alike, alike + 1, (21.0, 20.0), known_noise=True)


def _displacement() -> None:
    tracker = DisplacementTracker(DicParameters())
    with _part("displacement"):
        for dtype in (np.uint8, np.uint16):
            white = small_stack(dtype, 0).frames[0]
            texture = white_texture(white)
            for step in (0, 1):
                tracker.step("warm up", step, step, texture)
            texture.setflags(write=False)
            tracker.step("warm up", 2, 2, texture)
            measure_displacement(white, white, initial=at_rest(1))
            measure_displacement(texture, texture, spacing=2, initial=at_rest(2))


def _surface() -> None:
    """Reconstruct, couple and differentiate a plane at rest."""
    pitch = SIZE / 8
    column = np.arange(SIZE, dtype=np.float32)
    phase = np.tile((column - column.mean()) * np.float32(2 * np.pi / pitch), (SIZE, 1))
    sigma, still = np.full_like(phase, 0.01), np.zeros_like(phase)
    with _part("shape, coupling and strain"):
        calibration = small_rig()
        shape = calibration.reconstruct(phase, pitch, sigma)
        prepared = PreparedShape(shape, z_filter=CouplingParameters().z_filter_px, calibration=calibration)
        field = dict(
            zip(("displacement_x", "displacement_y", "sigma_x", "sigma_y"), (still, still, sigma, sigma), strict=True)
        )
        axes = {"row": np.arange(SIZE), "column": np.arange(SIZE)}
        displacement = xr.Dataset({name: (("row", "column"), values) for name, values in field.items()}, axes, DENSE)
        for writable in (False, True):
            set_writable(displacement, writable)
            cloud = couple(prepared, prepared, displacement, calibration=calibration, z_filter=prepared.z_filter)
        to_local_frame(cloud, window=WINDOW)
        surface_strain(cloud, window=WINDOW)


def _nodes() -> None:
    """Smooth fields at nodes: a third of the time of the displacement."""
    window = design_window(32)
    rows = columns = SIZE // window.cell
    cells = np.ones((cell_kernels.CHANNELS, rows, columns), np.float32)
    seen, planes = cells[0].copy(), np.zeros((2, 3), np.float32)
    start, moved, filters = cells[:2].copy(), cells[2:4].copy(), (window.taps, window.narrow_taps)
    with _part("fixed point at nodes"):
        sums = cells[: cell_kernels.GXE].copy()
        node_kernels.iterate_fixed_point(cells, sums, seen, start, filters, 1.0, RELAXATIONS[2], moved)
        node_kernels.bound_unresolved(cells, moved, seen)
        node_kernels.van_cittert(moved, start, seen, window.taps, BRIGHTNESS_PASSES)
        node_kernels.extrapolate(moved, planes, seen, window.taps)


def _virtual_rig() -> None:
    with _part("virtual rig"):
        for name in ("plate", "skin", "leather", "sphere"):
            virtual = VirtualRig(VirtualRigConfiguration.from_dict(preset(name, size="tiny")))
            virtual.expose(np.full(virtual.projector_shape, 128, np.uint8), 0.0, 0)
            virtual.truth(0.0)


def _model() -> None:
    with _part("comparison with a model"):
        triangle = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        sample(triangle, np.array([[0, 1, 2]]), triangle).interpolate(triangle)


def _discontinuous_surface() -> None:
    """Fit planes on both sides of a discontinuity, as the strain does after the first crack."""
    row, column = np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="ij")
    names = (*"xyzuvw", "noise_z", "noise_z_deformed", "displacement_sigma_x", "displacement_sigma_y")
    values = dict.fromkeys(names, (("row", "column"), np.ones((SIZE, SIZE), np.float32)))
    values |= {"x": (("row", "column"), column.astype(np.float32)), "y": (("row", "column"), row.astype(np.float32))}
    cloud = xr.Dataset(values, {"row": np.arange(SIZE), "column": np.arange(SIZE)})
    fit_planes(cloud, names[2:6], 11, names[6:], np.abs(row - SIZE // 2) < 2)


@contextmanager
def _part(name: str) -> Iterator[None]:
    """Write what was compiled, and how long it took; parts of several processes end in any order."""
    begin = time.monotonic()
    yield
    sys.stdout.write(f"{name}: {time.monotonic() - begin:.1f} s\n")
    sys.stdout.flush()
