"""Compile every Numba kernel of the library for the types that measurements use, and keep the machine code.

Run once after installation, `python -m fringedic.warm_up`: the first step of an experiment then starts at once.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import xarray as xr

from fringedic.chain import (
    CouplingParameters,
    DicParameters,
    DisplacementTracker,
    PhaseParameters,
    ShapeTracker,
    phase_step,
    white_texture,
)
from fringedic.correlation import measure_displacement
from fringedic.patterns import fringe_sequence
from fringedic.rig import RigModel
from fringedic.sequence import FrameRecord, Stack
from fringedic.surface.planes import fit_planes

SIZE = 96  # [px]: enough for every stage, compilation takes all the time anyway


def _rig() -> RigModel:
    """A projector to the right of a camera that sees the projected image pixel by pixel."""
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
    """Fringes on a rough texture as a camera of 8 or 16 bits sees them."""
    sequence = fringe_sequence(SIZE, SIZE, [SIZE, SIZE / 8], 4)
    texture = 0.5 + 0.5 * np.random.default_rng(1).random((SIZE, SIZE))
    grey = np.stack([frame * texture for frame in sequence]) * (np.iinfo(dtype).max / 255)
    records = [
        FrameRecord("warm up", step, index, len(sequence), projection, stamp=index, exposure_time=0.01, dropped=0)
        for index, projection in enumerate(sequence.projections)
    ]
    return Stack("warm up", step, records, grey.astype(dtype), stamp=len(sequence))


def _twice_exposed(stack: Stack) -> Stack:
    """The same frames as if each pattern had been taken at two exposure times."""
    records = [
        replace(record, index=2 * record.index + number, count=2 * record.count, exposure_time=0.01 * (number + 1))
        for record in stack.records
        for number in (0, 1)
    ]
    return replace(stack, records=records, frames=np.repeat(stack.frames, 2, axis=0))


def warm_up() -> None:
    """Send small frames through the whole chain, printing the seconds that each part takes."""
    tracker = DisplacementTracker(DicParameters())
    shapes = ShapeTracker(CouplingParameters(local_frame_window_px=11, strain_window_px=11))
    shapes.set_calibration(_rig())
    for dtype in (np.uint8, np.uint16):
        with _Part(f"phase, displacement and coupling of {np.dtype(dtype).name} frames"):
            for step in (0, 1, 2):
                phase = phase_step(_stack(dtype, step), PhaseParameters(lens_blur_px=0.5))
                # arrays of messages, which the nodes take, are read-only: kernels are compiled once more for them
                phase.texture.setflags(write=step != 2)
                found = tracker.step(np.dtype(dtype).name, step, 0, phase.texture)
                for array in (phase.phase, phase.sigma, found.displacement, found.sigma):
                    array.setflags(write=step != 2)
                shapes.step(
                    np.dtype(dtype).name,
                    step,
                    0,
                    phase.phase,
                    phase.sigma,
                    found.displacement,
                    found.sigma,
                    pitch=phase.pitch,
                    orientation=phase.orientation,
                    spacing=found.spacing,
                    origin=found.origin,
                    window=DicParameters().window,
                )
        with _Part(f"exposures of {np.dtype(dtype).name} frames"):
            phase_step(_twice_exposed(_stack(dtype, 0)), PhaseParameters())
        with _Part(f"displacement of white {np.dtype(dtype).name} images"):
            white = _stack(dtype, 0).frames[0]
            measure_displacement(white, white, initial=_still(1))
            measure_displacement(white_texture(white), white_texture(white), spacing=2, initial=_still(2))
    with _Part("strain beside a tear"):
        _torn_surface()


def _torn_surface() -> None:
    """Fit planes on both sides of a tear, as the strain does it: the kernels for that wait for the first crack."""
    row, column = np.meshgrid(np.arange(SIZE), np.arange(SIZE), indexing="ij")
    names = (*"xyzuvw", "noise_z", "noise_z_deformed", "displacement_sigma_x", "displacement_sigma_y")
    values = dict.fromkeys(names, (("row", "column"), np.ones((SIZE, SIZE), np.float32)))
    values |= {"x": (("row", "column"), column.astype(np.float32)), "y": (("row", "column"), row.astype(np.float32))}
    cloud = xr.Dataset(values, {"row": np.arange(SIZE), "column": np.arange(SIZE)})
    fit_planes(cloud, names[2:6], 11, names[6:], np.abs(row - SIZE // 2) < 2)


def _still(spacing: int) -> tuple[np.ndarray, np.ndarray]:
    """No motion, as a displacement to start from."""
    points = -(-SIZE // spacing)
    return np.zeros((points, points), np.float32), np.zeros((points, points), np.float32)


class _Part:
    """Prints what is being compiled, and for how long."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __enter__(self) -> None:
        print(f"{self.name} ...", end=" ", flush=True)
        self.begin = time.monotonic()

    def __exit__(self, *_: object) -> None:
        print(f"{time.monotonic() - self.begin:.1f} s", flush=True)


if __name__ == "__main__":
    warm_up()
