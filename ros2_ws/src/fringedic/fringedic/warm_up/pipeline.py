"""Small frames through the whole pipeline: compiles every Numba kernel for the types of measurements."""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import numpy as np
import xarray as xr

from fringedic.correlation import measure_displacement
from fringedic.frames.collector import Stack
from fringedic.frames.records import FrameRecord
from fringedic.models.sampling import sample
from fringedic.patterns.sequences import fringe_sequence
from fringedic.rig.model import RigModel
from fringedic.steps.displacement_tracker import DisplacementTracker, white_texture
from fringedic.steps.parameters import CouplingParameters, DicParameters, PhaseParameters
from fringedic.steps.phase import phase_step
from fringedic.steps.shape_tracker import ShapeTracker
from fringedic.surface.planes import fit_planes
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration, preset

SIZE = 96  # [px]: enough for every stage, and negligible against the compilation


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
    """Process small frames by the whole pipeline, with the time that each part takes on standard output."""
    tracker = DisplacementTracker(DicParameters())
    shapes = ShapeTracker(CouplingParameters(local_frame_window_px=11, strain_window_px=11))
    shapes.set_calibration(_rig())
    for dtype in (np.uint8, np.uint16):
        with _Part(f"phase, displacement and coupling of {np.dtype(dtype).name} frames"):
            for step in (0, 1, 2):
                phase = phase_step(_stack(dtype, step), PhaseParameters(lens_blur_px=0.5))
                # nodes work on read-only arrays of messages, for which kernels are compiled, too
                _set_writable(phase.maps, step != 2)
                found = tracker.step(phase.experiment, phase.step, phase.stamp, phase.texture)
                _set_writable(found.field, step != 2)
                shapes.step(phase, found)
        with _Part(f"exposures of {np.dtype(dtype).name} frames"):
            phase_step(_twice_exposed(_stack(dtype, 0)), PhaseParameters())
        with _Part(f"displacement of white {np.dtype(dtype).name} images"):
            white = _stack(dtype, 0).frames[0]
            measure_displacement(white, white, initial=_still(1))
            measure_displacement(white_texture(white), white_texture(white), spacing=2, initial=_still(2))
    with _Part("strain beside a discontinuity"):
        _discontinuous_surface()
    with _Part("virtual rig"):
        for name in ("plate", "skin", "leather", "sphere"):
            virtual = VirtualRig(VirtualRigConfiguration.from_dict(preset(name, size="tiny")))
            virtual.expose(np.full(virtual.projector_shape, 128, np.uint8), 0.0, 0)
            virtual.truth(0.0)
    with _Part("comparison with a model"):
        triangle = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        sample(triangle, np.array([[0, 1, 2]]), triangle).interpolate(triangle)


def _set_writable(dataset: xr.Dataset, writable: bool) -> None:
    for array in dataset.values():
        array.values.setflags(write=writable)


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


class _Part:
    """Writes what is compiled, and how long it takes."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __enter__(self) -> None:
        _write(f"{self.name} ... ")
        self.begin = time.monotonic()

    def __exit__(self, *_: object) -> None:
        _write(f"{time.monotonic() - self.begin:.1f} s\n")


def _write(text: str) -> None:
    sys.stdout.write(text)
    sys.stdout.flush()
