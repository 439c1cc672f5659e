"""Phase: sign, validity, noise, fringe orders."""

import numpy as np
import pytest
import xarray as xr
from numba import get_num_threads, set_num_threads

from fringedic.errors import ImageError, PhaseError
from fringedic.frames.noise import CameraNoise
from fringedic.patterns.pattern import ProjectedPattern
from fringedic.patterns.sequences import fringe_sequence
from fringedic.phase import absolute_phase, demodulate, unwrap_hierarchical
from fringedic.phase.noise import estimate_noise
from fringedic.virtual_rig import VirtualRig

PITCHES = [800.0, 160.0, 40.0, 10.0]
NOISE = CameraNoise(read=1.0, shot=0.02)


def grey_levels(ideal: np.ndarray, rng: np.random.Generator | None, noise: CameraNoise = NOISE) -> np.ndarray:
    """Return ideal intensities as an 8-bit camera sees them; `noise.read` contains the rounding."""
    if rng is not None:
        read_variance = noise.read**2 - 1 / 12
        ideal = ideal + rng.normal(size=ideal.shape) * np.sqrt(read_variance + noise.shot * ideal)
    return np.clip(np.round(ideal), 0, 255).astype(np.uint8)


def stack_of(
    column: np.ndarray,
    patterns: list[ProjectedPattern],
    mean: float | np.ndarray,
    contrast: float,
    rng: np.random.Generator | None = None,
) -> np.ndarray:
    """Return frames of a surface on which every pixel sees one projector column of an 800 px wide projector."""
    return np.array(
        [
            grey_levels(
                mean * (1 + contrast * np.cos(2 * np.pi * ((column - 399.5) / each.pitch - each.shift / each.shifts))),
                rng,
            )
            for each in patterns
        ]
    )


def columns_in_view(rows: int = 60, columns: int = 300) -> np.ndarray:
    """Return a ramp of projector columns with a step of 90 px in its middle: 9 of the finest fringes."""
    ramp = np.linspace(40.0, 650.0, columns)[None, :] + np.linspace(0.0, 12.0, rows)[:, None]
    ramp[:, columns // 2 :] += 90.0
    return ramp


@pytest.mark.parametrize(("shifts", "periods"), [(3, 1), (4, 1), (5, 2), (8, 1), (8, 3)])
def test_demodulate_returns_plus_phi(shifts: int, periods: int) -> None:
    truth = np.linspace(-3.1, 3.1, 400).reshape(20, 20)
    k = np.arange(1, shifts * periods + 1)[:, None, None]
    frames = (120 + 80 * np.cos(truth - 2 * np.pi * k / shifts)).astype(np.float32)
    measured = demodulate(frames, shifts, noise=0.5)
    assert np.abs(measured.phase - truth).max() < 2e-6
    assert np.abs(measured.modulation - 80).max() < 1e-4
    assert np.abs(measured.texture - 120).max() < 1e-4
    assert np.allclose(measured.sigma, np.sqrt(2 / (shifts * periods)) * 0.5 / 80, rtol=1e-5)
    assert bool(measured.valid.all())


def test_absolute_phase_on_a_stepped_object() -> None:
    column = columns_in_view()
    truth = 2 * np.pi * (column - 399.5) / PITCHES[-1]
    patterns = list(fringe_sequence(800, 600, PITCHES, 4).patterns)
    wrong = measured_pixels = 0
    for seed in range(12):
        frames = stack_of(column, patterns, 90.0, 0.8, np.random.default_rng(seed))
        result = absolute_phase(frames, patterns, noise=NOISE)
        wrong += int((np.abs(result.phase - truth) > np.pi).sum())
        measured_pixels += int(result.valid.sum())
    assert measured_pixels == 12 * column.size
    assert wrong <= 1e-5 * measured_pixels


def test_no_wrong_order_where_the_modulation_is_low() -> None:
    """Pixels that are too dark for a certain order become NaN and not a wrong height."""
    column = columns_in_view()
    truth = 2 * np.pi * (column - 399.5) / PITCHES[-1]
    patterns = list(fringe_sequence(800, 600, PITCHES, 4).patterns)
    mean = np.geomspace(2.0, 60.0, column.shape[1])[None, :]
    wrong = valid = 0
    for seed in range(12):
        frames = stack_of(column, patterns, mean, 0.8, np.random.default_rng(seed))
        result = absolute_phase(frames, patterns, noise=NOISE)
        assert np.array_equal(np.isfinite(result.phase), result.valid)
        wrong += int((np.abs(result.phase - truth) > np.pi).sum())
        valid += int(result.valid.sum())
    assert 0.4 < valid / (12 * column.size) < 0.9
    assert wrong <= 1e-5 * valid


@pytest.mark.parametrize(("shifts", "periods"), [(3, 1), (4, 1), (8, 1), (4, 2)])
def test_sigma_is_the_standard_deviation(shifts: int, periods: int) -> None:
    column = columns_in_view()
    patterns = list(fringe_sequence(800, 600, PITCHES, shifts, periods=periods).patterns)
    truth = 2 * np.pi * (column - 399.5) / PITCHES[-1]
    mean = np.linspace(40.0, 120.0, column.shape[1])[None, :]
    frames = stack_of(column, patterns, mean, 0.7, np.random.default_rng(3))
    result = absolute_phase(frames, patterns, noise=NOISE)
    score = float(((result.phase - truth) / result.sigma).std())
    assert 0.97 < score < 1.03


@pytest.mark.parametrize("shifts", [4, 8])
def test_noise_is_estimated_from_the_stack(shifts: int) -> None:
    column = columns_in_view(200, 400)
    patterns = list(fringe_sequence(800, 600, PITCHES, shifts).patterns)
    mean = np.linspace(20.0, 120.0, column.shape[1])[None, :]
    frames = stack_of(column, patterns, mean, 0.8, np.random.default_rng(5))
    estimated = estimate_noise(frames, patterns)
    assert estimated is not None
    assert estimated.read == pytest.approx(NOISE.read, rel=0.06)
    assert estimated.shot == pytest.approx(NOISE.shot, rel=0.1)
    known = absolute_phase(frames, patterns, noise=NOISE)
    unknown = absolute_phase(frames, patterns)
    assert np.allclose(known.phase, unknown.phase, equal_nan=True)
    assert float((unknown.sigma / known.sigma).mean()) == pytest.approx(1, rel=0.03)


def test_three_frames_leave_the_noise_unknown() -> None:
    column = columns_in_view()
    patterns = list(fringe_sequence(800, 600, PITCHES, 3).patterns)
    result = absolute_phase(stack_of(column, patterns, 90.0, 0.8), patterns)
    assert bool(result.valid.all())
    assert bool(result.sigma.isnull().all())


def test_rendered_frames_of_a_stepped_speckled_object() -> None:
    """Rendered by the digital twin: shadows, walls, blur, speckle, noise; no fringe order may be wrong."""
    twin = VirtualRig.from_preset("stepped", size="small")
    rows, columns = twin.projector_shape
    sequence = fringe_sequence(columns, rows, [columns, 40, 10], [4, 4, 8])
    frames = np.array([twin.expose(image, 0.0, index) for index, image in enumerate(sequence)])
    sensor = twin.configuration.sensor
    noise = CameraNoise(float(np.hypot(sensor.read_noise_grey_level, 12**-0.5)), sensor.shot_noise_grey_level)
    result = absolute_phase(frames, list(sequence.patterns), noise=noise)
    truth = twin.truth(0.0)
    error = result.phase - 2 * np.pi * (truth.projector_column - (columns - 1) / 2) / 10
    wrong = int((np.abs(error) > np.pi).sum())
    score = float((error / result.sigma).where(np.abs(error) < np.pi).std())
    assert float(result.valid.mean()) > 0.95
    assert not result.valid.where(~truth.lit, other=False).any(), "nothing is measured in the shadow"
    assert wrong == 0
    assert 0.95 < score < 1.05


def test_saturated_and_unmodulated_pixels_are_nan() -> None:
    column = columns_in_view()
    patterns = list(fringe_sequence(800, 600, PITCHES, 4).patterns)
    mean = np.full(column.shape, 90.0)
    mean[:10, :20] = 200.0  # glare
    frames = stack_of(column, patterns, mean, 0.8, np.random.default_rng(0))
    frames[:, 30:40, 50:70] = grey_levels(np.full((len(frames), 10, 20), 30.0), np.random.default_rng(1))  # shadow
    result = absolute_phase(frames, patterns, noise=NOISE)
    expected = np.ones(column.shape, bool)
    expected[:10, :20] = False
    expected[30:40, 50:70] = False
    assert np.array_equal(result.valid, expected)
    assert np.array_equal(np.isnan(result.phase), ~expected)
    assert np.array_equal(np.isnan(result.sigma), ~expected)
    assert bool(np.isfinite(result.texture).all()), "the texture is measured in the shadow too"
    assert bool(absolute_phase(frames, patterns, noise=NOISE, saturation=100).valid.sum() == 0)
    weak = absolute_phase(frames, patterns, noise=NOISE, minimum_modulation=80)
    assert not weak.valid.any()


def test_types_of_pixels_agree() -> None:
    column = columns_in_view()
    patterns = list(fringe_sequence(800, 600, PITCHES, 4).patterns)
    frames = stack_of(column, patterns, 90.0, 0.8, np.random.default_rng(0))
    expected = absolute_phase(frames, patterns, noise=NOISE)
    for kind in (np.uint16, np.float32):
        xr.testing.assert_identical(absolute_phase(frames.astype(kind), patterns, noise=NOISE), expected)
    twelve_bits = frames.astype(np.uint16) * 16
    scaled = absolute_phase(twelve_bits, patterns, noise=CameraNoise(16.0, 0.32), saturation=4095)
    assert np.allclose(scaled.phase, expected.phase, atol=1e-5)
    assert np.allclose(scaled.sigma, expected.sigma, rtol=1e-5)


def test_texture_is_the_mean_of_the_whole_stack() -> None:
    column = columns_in_view()
    patterns = list(fringe_sequence(800, 600, PITCHES, [4, 4, 4, 8]).patterns)
    frames = stack_of(column, patterns, 90.0, 0.8, np.random.default_rng(0))
    result = absolute_phase(frames, patterns, noise=NOISE)
    assert np.allclose(result.texture, frames.mean(axis=0), atol=1e-4)
    assert abs(float(result.texture.mean()) - 90) < 0.05


def test_fused_unwrapping_agrees_with_the_plain_one() -> None:
    column = columns_in_view()
    sequence = fringe_sequence(800, 600, PITCHES, [3, 4, 5, 8])
    patterns = list(sequence.patterns)
    frames = stack_of(column, patterns, 90.0, 0.8, np.random.default_rng(0))
    wrapped, first = [], 0
    for shifts in (3, 4, 5, 8):
        wrapped.append(demodulate(frames[first : first + shifts], shifts, noise=NOISE).phase)
        first += shifts
    plain = unwrap_hierarchical(wrapped, PITCHES)
    fused = absolute_phase(frames, patterns, noise=NOISE).phase
    assert plain.dims == ("row", "column")
    assert np.abs(plain - fused).max() < 1e-4


def test_horizontal_fringes_have_the_same_zero() -> None:
    sequence = fringe_sequence(80, 100, [100, 20], 4, "horizontal")
    result = absolute_phase(np.array(list(sequence)), list(sequence.patterns), noise=1.0)
    expected = 2 * np.pi * (49.5 - np.arange(100)) / 20
    assert np.abs(result.phase.values - expected[:, None]).max() < 0.02


def test_result_does_not_depend_on_the_number_of_threads() -> None:
    column = columns_in_view()
    patterns = list(fringe_sequence(800, 600, PITCHES, 4).patterns)
    frames = stack_of(column, patterns, 90.0, 0.8, np.random.default_rng(0))
    before = get_num_threads()
    try:
        set_num_threads(1)
        one = absolute_phase(frames, patterns)
    finally:
        set_num_threads(before)
    xr.testing.assert_identical(one, absolute_phase(frames, patterns))


def test_unwrapping_keeps_nan() -> None:
    coarse = np.array([[0.1, np.nan, 0.2]])
    fine = np.array([[0.5, 1.0, np.nan]])
    result = unwrap_hierarchical([coarse, fine], [50, 10]).values
    assert result[0, 0] == pytest.approx(0.5)
    assert np.isnan(result[0, 1:]).all()


def test_bad_input_is_refused() -> None:
    frames = np.zeros((7, 4, 4), np.uint8)
    with pytest.raises(PhaseError, match="whole cycles"):
        demodulate(frames, 4)
    with pytest.raises(PhaseError, match="at least 3"):
        demodulate(frames[:2], 2)
    with pytest.raises(PhaseError, match="not empty"):
        demodulate(frames[:0], 4)
    patterns = list(fringe_sequence(64, 48, [64, 8], 4).patterns)
    with pytest.raises(ImageError, match="8 patterns"):
        absolute_phase(frames, patterns)
    with pytest.raises(PhaseError, match="finer"):
        absolute_phase(np.zeros((8, 4, 4), np.uint8), patterns[4:] + patterns[:4])
    mixed = patterns[:4] + list(fringe_sequence(64, 48, [8], 4, "horizontal").patterns)
    with pytest.raises(PhaseError, match="mixed"):
        absolute_phase(np.zeros((8, 4, 4), np.uint8), mixed)
    with pytest.raises(ImageError, match="one for each"):
        unwrap_hierarchical([np.zeros((2, 2))], [10, 5])
    with pytest.raises(ImageError, match="differ in size"):
        unwrap_hierarchical([np.zeros((2, 2)), np.zeros((2, 3))], [10, 5])
