"""Fringe orders from Gray codes, over the image, and from another phase; both orientations."""

import numpy as np
import pytest
import xarray as xr

from fringedic.errors import ImageError, PhaseError
from fringedic.frames.collector import FrameCollector
from fringedic.frames.noise import CameraNoise
from fringedic.frames.records import FrameRecord
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.patterns.sequences import PatternSequence, fringe_sequence, gray_code_sequence
from fringedic.phase import absolute_phase, assign_orders, unwrap_spatial
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

NOISE = CameraNoise(read=1.05, shot=0.02)


def stepped(**projector: float) -> VirtualRig:
    entries = {"preset": "stepped", "size": "small", "seed": 3, "projector": projector}
    return VirtualRig(VirtualRigConfiguration.from_dict(entries))


def phase_error(twin: VirtualRig, sequence: PatternSequence) -> tuple[xr.Dataset, np.ndarray]:
    """Measure the unloaded surface of the virtual rig; return the result and the error of the phase [fringe]."""
    frames = np.array([twin.expose(image, 0.0, index) for index, image in enumerate(sequence)])
    result = absolute_phase(frames, sequence.patterns, noise=NOISE)
    view = twin.view(0.0)
    rows, columns = twin.projector_shape
    if sequence.patterns[-1].orientation == 0:
        position = view.projector_column - (columns - 1) / 2
    else:
        position = (rows - 1) / 2 - view.projector_row
    pitch = sequence.patterns[-1].pitch
    return result, result.phase.values / (2 * np.pi) - position / pitch


@pytest.mark.parametrize("orientation", ["vertical", "horizontal"])
@pytest.mark.parametrize(("shifts", "periods"), [(3, 2), (4, 1), (5, 1)])
@pytest.mark.parametrize("code", [False, True])
def test_absolute_order_in_both_orientations(orientation: str, shifts: int, periods: int, code: bool) -> None:
    # a projector above the camera sees the relief through horizontal fringes
    twin = stepped() if orientation == "vertical" else stepped(x_mm=1.5, y_mm=180.0)
    rows, columns = twin.projector_shape
    length = columns if orientation == "vertical" else rows
    if code:
        sequence = gray_code_sequence(columns, rows, 8, shifts, orientation, periods=periods)
    else:
        sequence = fringe_sequence(columns, rows, [length, 40, 8], shifts, orientation, periods=periods)
    result, error = phase_error(twin, sequence)
    wrong, valid = int((np.abs(error) > 0.5).sum()), int(result.valid.sum())
    small = error[np.abs(error) < 0.5]
    assert valid > 0.9 * result.valid.size
    assert wrong == 0
    score = small / (result.sigma.values[np.abs(error) < 0.5] / (2 * np.pi))
    # three shifts are sensitive to harmonics of the projector's rounding, which is not noise
    assert 0.93 < np.std(score) < (1.3 if shifts == 3 else 1.07), np.std(score)
    assert not result.valid.values[~twin.view(0.0).lit].any()


def test_code_edges_between_pixels_make_no_wrong_order() -> None:
    """All positions against the code, noise, and blur of the code wider than a projector pixel."""
    column = np.linspace(9.0, 790.0, 40_000).reshape(200, 200)
    near = np.rint(column).astype(int)[..., None] + np.arange(-9, 10)  # the others have weights below 1e-10
    sequence = gray_code_sequence(800, 10, 10, 4)
    rng = np.random.default_rng(4)
    wrong = valid = 0
    for blur in (0.4, 1.2):
        weights = np.exp(-0.5 * ((near - column[..., None]) / blur) ** 2)
        weights /= weights.sum(axis=-1, keepdims=True)
        ideal = np.array([0.6 * (image[0][near] * weights).sum(axis=-1) for image in sequence])
        noisy = ideal + rng.normal(size=ideal.shape) * np.sqrt(1 + 0.02 * ideal)
        result = absolute_phase(np.clip(np.rint(noisy), 0, 255).astype(np.uint8), sequence.patterns, noise=NOISE)
        error = result.phase.values / (2 * np.pi) - (column - 399.5) / 10
        wrong += int((np.abs(error) > 0.5).sum())
        valid += int(result.valid.sum())
    assert valid > 0.999 * 2 * column.size
    assert wrong == 0


def test_a_code_that_cannot_be_read_is_not_measured() -> None:
    sequence = gray_code_sequence(400, 10, 10, 4)
    frames = np.array([np.broadcast_to(0.5 * image[0], (4, 400)) for image in sequence]).astype(np.uint8)
    code = len(sequence) - 4
    spoiled = frames.copy()
    spoiled[:code, :2] = frames[code:, :2].mean(axis=0)  # neither dark nor bright: every bit is uncertain
    result = absolute_phase(spoiled, sequence.patterns, noise=NOISE)
    assert not result.valid[:2].any()
    assert bool(result.valid[2:].all())


def test_layout_of_codes_is_checked() -> None:
    sequence = gray_code_sequence(400, 10, 10, 4)
    patterns = list(sequence.patterns)
    frames = np.zeros((len(patterns), 4, 5), np.uint8)
    for wrong, words in (
        (patterns[4:] + patterns[:4], "before all fringes"),
        ([patterns[1], patterns[0], *patterns[2:]], "every bit"),
        ([*patterns[:-4], *fringe_sequence(400, 10, [8], 4).patterns], "another pitch"),
        ([ProjectedPattern(PatternKind.GREY, shift=1, shifts=2), *patterns[1:]], "needs fringes"),
    ):
        with pytest.raises(PhaseError, match=words):
            absolute_phase(frames, wrong)


def test_code_and_fringes_are_one_step() -> None:
    sequence = gray_code_sequence(80, 10, 10, 4)
    collector = FrameCollector()
    for index, pattern in enumerate(sequence.patterns):
        record = FrameRecord("e", 0, index, len(sequence), pattern, index, 0.01)
        stack = collector.add(record, np.zeros((3, 4), np.uint8))
    assert stack is not None
    assert stack.kind == PatternKind.FRINGES


def test_spatial_unwrapping_is_relative_and_keeps_the_phase() -> None:
    column, row = np.meshgrid(np.arange(200), np.arange(150))
    phase = 0.3 * column + 8 * np.exp(-((column - 90) ** 2 + (row - 70) ** 2) / 1500) + 0.05 * row
    wrapped = np.angle(np.exp(1j * phase)).astype(np.float32)
    wrapped[:, 150:155] = np.nan  # the region behind has no order relative to the rest
    wrapped[60:64, 40:44] = np.nan
    result = unwrap_spatial(wrapped)
    assert result.attrs["relative"] == 1
    assert np.isnan(result.values[:, 150:]).all()
    assert np.isnan(result.values[60:64, 40:44]).all()
    turns = (result.values - phase)[:, :150] / (2 * np.pi)
    offset = np.nanmedian(turns)
    assert abs(offset - round(offset)) < 1e-6
    assert np.nanmax(np.abs(turns - offset)) < 1e-6
    assert np.array_equal(np.isnan(result), np.isnan(wrapped) | (column > 150))
    assert abs(np.nanmedian(result)) <= 2 * np.pi
    known = assign_orders(result, phase + 1.0)
    assert known.attrs["relative"] == 0
    assert np.nanmax(np.abs(known.values - phase)) < 1e-5
    assert np.isnan(unwrap_spatial(np.full((4, 5), np.nan))).all()
    with pytest.raises(ImageError, match="cannot take its orders"):
        assign_orders(result, phase[:-1])


def test_noise_of_each_pixel() -> None:
    sequence = fringe_sequence(80, 100, [80, 20], 4)
    frames = np.array(list(sequence))
    noise = np.full((100, 80), 2.0)
    noise[:50] = 0.5
    result = absolute_phase(frames, sequence.patterns, noise=noise)
    assert float(result.sigma[:50].mean() / result.sigma[50:].mean()) == pytest.approx(0.25, rel=1e-4)
    with pytest.raises(ImageError, match="noise of"):
        absolute_phase(frames, sequence.patterns, noise=noise[1:])
