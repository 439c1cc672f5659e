"""A small step for each node, before its first real one: machine code is loaded while the rig is being set up.

The arrays are read-only as those of messages, for which the kernels have code of their own. Each function imports what
its node needs: the modules of all three together take another node a second to load.
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from fringedic.frames.collector import Stack
from fringedic.frames.records import FrameRecord
from fringedic.patterns.sequences import PatternSequence, fringe_sequence, moving_sequence
from fringedic.rig.model import RigModel
from fringedic.steps.parameters import CouplingParameters, DicParameters, PhaseParameters
from fringedic.steps.step_results import DicResult, PhaseResult

SIZE = 96  # [px]: enough for every stage, and negligible beside compiling or loading its kernels
WINDOW = 11  # [px] of local frame and strain


def rehearse_phase() -> None:
    """Measure the phase of small stacks of 8 bits, at rest and in motion."""
    from fringedic.steps.phase import phase_step

    for stack in (small_stack(np.uint8, 0), small_moving_stack(np.uint8)):
        phase_step(stack, PhaseParameters())


def rehearse_displacement() -> None:
    """Measure the displacement of a small texture at rest."""
    from fringedic.steps.displacement_tracker import DisplacementTracker, white_texture

    tracker = DisplacementTracker(DicParameters())
    texture = _with_gaps(white_texture(small_stack(np.uint8, 0).frames[0]))
    texture.setflags(write=False)
    for step in (0, 1):
        tracker.step("rehearsal", step, step, texture)


def rehearse_coupling() -> None:
    """Couple two steps of a small relief that turns, so that the light on it changes."""
    from fringedic.correlation import measure_displacement
    from fringedic.steps.shape_tracker import ShapeTracker

    random = np.random.default_rng(1)
    plane = np.tile((np.arange(SIZE) - SIZE / 2) * (16 * np.pi / SIZE), (SIZE, 1))
    relief = random.normal(0, 0.1, (SIZE, SIZE))
    texture = _with_gaps(random.random((SIZE, SIZE)).astype(np.float32))
    field = measure_displacement(texture, texture, initial=at_rest(1))
    set_writable(field, False)
    tracker = ShapeTracker(CouplingParameters(local_frame_window_px=WINDOW, strain_window_px=WINDOW))
    tracker.set_calibration(small_rig())
    for step, tilt in enumerate((1.0, 1.2)):
        values = {"phase": tilt * plane + relief, "sigma": np.full((SIZE, SIZE), 0.01), "texture": texture}
        maps = xr.Dataset({name: (("row", "column"), each.astype(np.float32)) for name, each in values.items()})
        set_writable(maps, False)
        phase = PhaseResult("rehearsal", step, step, maps, pitch=SIZE / 8)
        surface = tracker.surface(phase)
        tracker.step(phase, DicResult("rehearsal", step, step, 0, 0, field), surface=surface)


def small_rig() -> RigModel:
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


def small_stack(dtype: type[np.unsignedinteger], step: int) -> Stack:
    """Return fringes on a rough texture in images of 8 or 16 bits."""
    return _stack_of(fringe_sequence(SIZE, SIZE, [SIZE, SIZE / 8], 4), dtype, step)


def small_moving_stack(dtype: type[np.unsignedinteger]) -> Stack:
    """Return the same surface, at rest, with the sequence of one that moves."""
    order = (3, 2, 1, 4, 3, 2, 1, 4)
    return _stack_of(moving_sequence(SIZE, SIZE, [SIZE, SIZE / 8], [4], order=order, parts=4), dtype, 0)


def _stack_of(sequence: PatternSequence, dtype: type[np.unsignedinteger], step: int) -> Stack:
    texture = 0.5 + 0.5 * np.random.default_rng(1).random((SIZE, SIZE))
    grey = np.stack([frame * texture for frame in sequence]) * (np.iinfo(dtype).max / 255)
    records = [
        FrameRecord(
            "warm up", step, index, len(sequence), pattern, stamp=10_000_000 * index, exposure_time=0.01, dropped=0
        )
        for index, pattern in enumerate(sequence.patterns)
    ]
    return Stack(np.dtype(dtype).name, step, records, grey.astype(dtype), stamp=records[-1].stamp)


def at_rest(spacing: int) -> tuple[np.ndarray, np.ndarray]:
    """Return an initial displacement of zero."""
    points = -(-SIZE // spacing)
    return np.zeros((points, points), np.float32), np.zeros((points, points), np.float32)


def _with_gaps(texture: np.ndarray) -> np.ndarray:
    """Return a texture with pixels that are not measured, a single one and many."""
    texture[SIZE // 2, SIZE // 2] = np.nan
    texture[: SIZE // 4, : SIZE // 4] = np.nan
    return texture


def set_writable(dataset: xr.Dataset, writable: bool) -> None:
    """Make the arrays of a dataset writable or read-only: kernels are compiled for each."""
    for array in dataset.values():
        array.values.setflags(write=writable)
