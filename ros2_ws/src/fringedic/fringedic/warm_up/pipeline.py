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
from fringedic.frames.records import FrameRecord
from fringedic.models.sampling import sample
from fringedic.patterns.sequences import fringe_sequence
from fringedic.rig.model import RigModel
from fringedic.steps.displacement_tracker import DisplacementTracker, white_texture
from fringedic.steps.parameters import CouplingParameters, DicParameters, PhaseParameters
from fringedic.steps.phase import phase_step
from fringedic.steps.shape_tracker import ShapeTracker
from fringedic.surface import PreparedShape, couple, surface_strain, to_local_frame
from fringedic.surface.planes import fit_planes
from fringedic.surface.shading import LitTexture
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration, preset

SIZE = 96  # [px]: enough for every stage, and negligible against the compilation
WINDOW = 11  # [px] of local frame and strain
_PHASE = PhaseParameters(lens_blur_px=0.5)
DENSE = {"window_px": 32, "method": "dense"}


def _rig() -> RigModel:
    """Return a projector to the right of a camera whose pixels coincide with the projected ones."""
    middle = (SIZE - 1) / 2
    return RigModel(
        camera_width=SIZE,
        camera_height=SIZE,
        camera_distance=0.5,
        pixel_size=1e-4,
        pixel_aspect=1.0,
        principal_column=middle,
        principal_row=middle,
        projector_width=SIZE,
        projector_height=SIZE,
        projector_position=(0.2, 0.0, 0.5),
        projector_focal_length=5000.0,
        projector_principal_column=middle,
        projector_principal_row=middle,
    )


def _stack(dtype: type[np.unsignedinteger], step: int) -> Stack:
    """Return fringes on a rough texture in images of 8 or 16 bits."""
    sequence = fringe_sequence(SIZE, SIZE, [SIZE, SIZE / 8], 4)
    texture = 0.5 + 0.5 * np.random.default_rng(1).random((SIZE, SIZE))
    grey = np.stack([frame * texture for frame in sequence]) * (np.iinfo(dtype).max / 255)
    records = [
        FrameRecord("warm up", step, index, len(sequence), pattern, stamp=index, exposure_time=0.01, dropped=0)
        for index, pattern in enumerate(sequence.patterns)
    ]
    return Stack(np.dtype(dtype).name, step, records, grey.astype(dtype), stamp=len(sequence))


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
        _turning_relief()


def _pipeline(dtype: type[np.unsignedinteger]) -> None:
    """Measure three steps as the nodes do; what the parts have not compiled is compiled here."""
    tracker = DisplacementTracker(DicParameters())
    shapes = ShapeTracker(CouplingParameters(local_frame_window_px=WINDOW, strain_window_px=WINDOW))
    shapes.set_calibration(_rig())
    for step in (0, 1, 2):
        phase = phase_step(_stack(dtype, step), _PHASE)
        # nodes work on read-only arrays of messages, for which kernels are compiled, too
        _set_writable(phase.maps, step != 2)
        found = tracker.step(phase.experiment, phase.step, phase.stamp, phase.texture)
        _set_writable(found.field, step != 2)
        shapes.step(phase, found)


def _phase() -> None:
    with _part("phase"):
        for dtype in (np.uint8, np.uint16):
            phase_step(_stack(dtype, 0), _PHASE)
            phase_step(_twice_exposed(_stack(dtype, 0)), _PHASE)


def _displacement() -> None:
    tracker = DisplacementTracker(DicParameters())
    with _part("displacement"):
        for dtype in (np.uint8, np.uint16):
            white = _stack(dtype, 0).frames[0]
            texture = white_texture(white)
            for step in (0, 1):
                tracker.step("warm up", step, step, texture)
            texture.setflags(write=False)
            tracker.step("warm up", 2, 2, texture)
            measure_displacement(white, white, initial=_still(1))
            measure_displacement(texture, texture, spacing=2, initial=_still(2))


def _surface() -> None:
    """Reconstruct, couple and differentiate a plane at rest."""
    pitch = SIZE / 8
    column = np.arange(SIZE, dtype=np.float32)
    phase = np.tile((column - column.mean()) * np.float32(2 * np.pi / pitch), (SIZE, 1))
    sigma, still = np.full_like(phase, 0.01), np.zeros_like(phase)
    with _part("shape, coupling and strain"):
        calibration = _rig()
        shape = calibration.reconstruct(phase, pitch, sigma)
        prepared = PreparedShape(shape, z_filter=CouplingParameters().z_filter_px, calibration=calibration)
        field = dict(
            zip(("displacement_x", "displacement_y", "sigma_x", "sigma_y"), (still, still, sigma, sigma), strict=True)
        )
        axes = {"row": np.arange(SIZE), "column": np.arange(SIZE)}
        displacement = xr.Dataset({name: (("row", "column"), values) for name, values in field.items()}, axes, DENSE)
        for writable in (False, True):
            _set_writable(displacement, writable)
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


def _set_writable(dataset: xr.Dataset, writable: bool) -> None:
    for array in dataset.values():
        array.values.setflags(write=writable)


def _turning_relief() -> None:
    """Take out the motion that the light on a relief imitates; in the pipeline above the relief is at rest."""
    random = np.random.default_rng(1)
    phase = np.tile(np.arange(SIZE, dtype=np.float32) * np.float32(16 * np.pi / SIZE), (SIZE, 1))
    sigma, texture = np.full_like(phase, 0.01), random.random((SIZE, SIZE)).astype(np.float32)
    relief = random.normal(0, 0.1, (SIZE, SIZE)).astype(np.float32)
    calibration, width = _rig(), CouplingParameters().z_filter_px
    still, turned = (
        PreparedShape(calibration.reconstruct(each + relief, SIZE / 8, sigma), z_filter=width, calibration=calibration)
        for each in (phase, 1.2 * phase)
    )
    field = measure_displacement(texture, texture, spacing=2, initial=_still(2))
    LitTexture(still, texture, calibration.projector_position, field).without_shading(field, turned)


def _discontinuous_surface() -> None:
    """Fit planes on both sides of a discontinuity, as the strain does after the first crack."""
    row, column = np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="ij")
    names = (*"xyzuvw", "noise_z", "noise_z_deformed", "displacement_sigma_x", "displacement_sigma_y")
    values = dict.fromkeys(names, (("row", "column"), np.ones((SIZE, SIZE), np.float32)))
    values |= {"x": (("row", "column"), column.astype(np.float32)), "y": (("row", "column"), row.astype(np.float32))}
    cloud = xr.Dataset(values, {"row": np.arange(SIZE), "column": np.arange(SIZE)})
    fit_planes(cloud, names[2:6], 11, names[6:], np.abs(row - SIZE // 2) < 2)


def _still(spacing: int) -> tuple[np.ndarray, np.ndarray]:
    """Return an initial displacement of zero."""
    points = -(-SIZE // spacing)
    return np.zeros((points, points), np.float32), np.zeros((points, points), np.float32)


@contextmanager
def _part(name: str) -> Iterator[None]:
    """Write what was compiled, and how long it took; parts of several processes end in any order."""
    begin = time.monotonic()
    yield
    sys.stdout.write(f"{name}: {time.monotonic() - begin:.1f} s\n")
    sys.stdout.flush()
