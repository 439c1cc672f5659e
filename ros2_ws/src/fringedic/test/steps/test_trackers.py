"""The step functions: parameters, references and what the trackers keep."""

import math
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from aligned_rig import aligned_rig
from pydantic import ValidationError
from scipy.ndimage import gaussian_filter

from fringedic.errors import ErrorCode, FringedicError, PhaseError, StepError
from fringedic.frames.collector import Stack
from fringedic.frames.records import FrameRecord
from fringedic.frames.region import Polygon, Region
from fringedic.patterns.pattern import Orientation, PatternKind, ProjectedPattern
from fringedic.patterns.sequences import fringe_sequence, gray_code_sequence, one_image_sequence
from fringedic.phase.findings import FindingKind
from fringedic.steps.displacement_tracker import DisplacementTracker, moved_mask, white_texture
from fringedic.steps.parameters import CouplingParameters, DicParameters, PhaseParameters
from fringedic.steps.phase import phase_step
from fringedic.steps.remarks import Correction, CorrectionKind
from fringedic.steps.shape_tracker import ShapeTracker
from fringedic.steps.step_results import DicResult, PhaseResult, displacement_field
from fringedic.virtual_rig import VirtualRig

MODELS = (PhaseParameters, DicParameters, CouplingParameters)
PITCHES = (80.0, 20.0)
RIG = aligned_rig((72, 60), 2e-4, (80, 60), 900.0, projector_position=(0.15, 0.0, 0.38))


@pytest.mark.parametrize("model", MODELS)
def test_every_parameter_is_bounded_and_described(model):
    for name, field in model.model_fields.items():
        assert len(field.description) > 20, name
        if isinstance(field.default, float):
            for value in (math.nan, math.inf, -math.inf):
                with pytest.raises(ValidationError):
                    model(**{name: value})
        if not isinstance(field.default, str | bool):
            for value in (-1, 1e9, "many", True, *([] if field.default is None else [None])):
                with pytest.raises(ValidationError):
                    model(**{name: value})
    with pytest.raises(ValidationError):
        model(unheard_of=1)


def stack(step=0, phase=None, kind=PatternKind.FRINGES, shape=(60, 72), mean=100.0, amplitude=60.0):
    """Frames of a surface whose phase at the finest pitch is given."""
    if phase is None:
        phase = np.broadcast_to(np.linspace(-6.0, 6.5, shape[1]), shape)
    patterns = [ProjectedPattern(kind, Orientation.VERTICAL, pitch, k, 4) for pitch in PITCHES for k in (1, 2, 3, 4)]
    noise = np.random.default_rng(step)
    frames = [
        mean
        + amplitude * np.cos(phase * PITCHES[-1] / p.pitch - 2 * np.pi * p.shift / 4)
        + noise.normal(0, 1, phase.shape)
        for p in patterns
    ]
    records = [FrameRecord("e", step, i, len(frames), p, 100 * step + i, 0.01) for i, p in enumerate(patterns)]
    return Stack("e", step, records, np.rint(frames).astype(np.uint8), records[-1].stamp)


def test_phase_step_says_what_it_measured():
    whole = stack(3)
    result = phase_step(whole, PhaseParameters())
    assert (result.experiment, result.step, result.stamp) == ("e", 3, 307)
    assert (result.pitch, result.orientation) == (20.0, Orientation.VERTICAL)
    assert {each.dtype.name for each in (result.phase, result.sigma, result.modulation, result.texture)} == {"float32"}
    assert result.valid_fraction > 0.99
    assert np.nanmax(np.abs(result.phase - np.linspace(-6.0, 6.5, 72))) < 0.1
    assert result.rms == pytest.approx(np.sqrt(2 / 4) * np.hypot(1, 1 / np.sqrt(12)) / 60, rel=0.1)
    assert result.texture.mean() == pytest.approx(100, abs=0.2)


def test_phase_parameters_have_an_effect():
    whole = stack()
    known = phase_step(whole, PhaseParameters(read_noise_grey_level=3.0))
    assert known.rms == pytest.approx(np.sqrt(2 / 4) * 3.0 / 60, rel=0.02)
    shot = phase_step(whole, PhaseParameters(read_noise_grey_level=3.0, shot_noise_grey_level=0.16))
    assert shot.rms == pytest.approx(np.sqrt(2 / 4) * 5.0 / 60, rel=0.02)
    with pytest.raises(StepError, match=r"step 0: 100% of the image saturates") as caught:
        phase_step(whole, PhaseParameters(saturation_grey_level=90.0))
    assert isinstance(caught.value, StepError)
    assert caught.value.step == 0
    with pytest.raises(StepError, check=lambda e: e.code is ErrorCode.TOO_FEW_VALID):
        phase_step(whole, PhaseParameters(minimum_modulation_grey_level=65.0))
    half = stack(amplitude=np.where(np.arange(72) < 36, 0.0, 60.0))
    with pytest.raises(StepError, match=r"only 50\.0% .* requires 60\.0%"):
        phase_step(half, PhaseParameters(minimum_valid_fraction=0.6))


def frames_of(rig, sequence, **changes):
    """A stack of the virtual rig's unloaded surface."""
    records = [FrameRecord("e", 7, i, len(sequence), each, i, 0.01) for i, each in enumerate(sequence.patterns)]
    frames = np.array([rig.expose(image, 0.0, index, **changes) for index, image in enumerate(sequence)])
    return Stack("e", 7, records, frames, records[-1].stamp)


@pytest.fixture(scope="module")
def small_rig():
    return VirtualRig.from_preset("sphere", size="small")


def turns_off(result, rig):
    """What the phase errs by [turn]."""
    column = rig.view(0.0).projector_column - (rig.projector_shape[1] - 1) / 2
    return result.phase / (2 * np.pi) - column / result.pitch


def test_a_gray_code_gives_the_orders_of_a_step(small_rig):
    rows, columns = small_rig.projector_shape
    sequence = gray_code_sequence(columns, rows, 8, 4)
    whole = frames_of(small_rig, sequence)
    result = phase_step(whole, PhaseParameters())
    assert np.nanmax(np.abs(turns_off(result, small_rig))) < 0.1
    assert (result.relative, result.remarks, result.pitch) == (False, (), 8.0)
    for first, second in ((1, 2), (0, 4)):
        faulty = frames_of(small_rig, sequence)
        faulty.frames[[first, second]] = faulty.frames[[second, first]]
        with pytest.raises(StepError, match=f"step 7: frames {first} and {second} are inter"):
            phase_step(faulty, PhaseParameters())


def test_one_pitch_is_relative_and_has_to_be_accepted(small_rig):
    rows, columns = small_rig.projector_shape
    whole = frames_of(small_rig, fringe_sequence(columns, rows, [8], 4))
    with pytest.raises(PhaseError, match="one pitch of 8 px repeat in view"):
        phase_step(whole, PhaseParameters())
    result = phase_step(whole, PhaseParameters(relative_phase="accept"))
    assert result.relative
    assert [each.kind for each in result.remarks] == [FindingKind.RELATIVE_ONE_PITCH]
    error = turns_off(result, small_rig)
    offset = np.nanmedian(error)
    assert np.nanmax(np.abs(error - offset)) < 0.1
    assert abs(offset - round(offset)) < 1e-3
    covering = phase_step(frames_of(small_rig, fringe_sequence(columns, rows, [columns], 4)), PhaseParameters())
    assert not covering.relative, "one fringe over the whole view is absolute"


@pytest.mark.parametrize("grey", [False, True])
def test_one_image_is_measured_when_there_is_no_more(small_rig, grey):
    rows, columns = small_rig.projector_shape
    whole = frames_of(small_rig, one_image_sequence(columns, rows, 10, grey=grey))
    with pytest.raises(PhaseError, match="one fringe image"):
        phase_step(whole, PhaseParameters())
    result = phase_step(whole, PhaseParameters(relative_phase="accept"))
    error = turns_off(result, small_rig)
    assert result.relative
    assert result.valid_fraction > 0.9
    spread = np.nanstd(error[20:-20, 20:-20])
    assert spread < (0.01 if grey else 0.06), spread
    stepped = frames_of(small_rig, fringe_sequence(columns, rows, [columns, 10], 4))
    chosen = phase_step(stepped, PhaseParameters(method="one_image", relative_phase="accept"))
    assert chosen.relative
    assert not phase_step(stepped, PhaseParameters()).relative
    dull = frames_of(small_rig, one_image_sequence(columns, rows, 10, grey=grey))
    dull.frames[-1] = 60
    with pytest.raises(StepError, match=r"step 7: frame .: no fringes"):
        phase_step(dull, PhaseParameters(relative_phase="accept"))


def test_lens_blur_is_corrected_on_request(small_rig):
    rows, columns = small_rig.projector_shape
    whole = frames_of(small_rig, fringe_sequence(columns, rows, [columns, 40, 10], 4))
    plain, corrected = (phase_step(whole, PhaseParameters(lens_blur_px=blur)) for blur in (0.0, 0.8))
    difference = corrected.phase - plain.phase
    assert 0 < np.nanstd(difference) < 0.5
    assert not corrected.relative
    assert np.array_equal(np.isnan(corrected.phase), np.isnan(plain.phase))


def test_a_phase_needs_fringes():
    white = Stack(
        "e", 1, [FrameRecord("e", 1, 0, 1, ProjectedPattern(PatternKind.WHITE), 5, 0.01)], np.ones((1, 4, 5)), 5
    )
    with pytest.raises(StepError, match="step 1: shows WHITE"):
        phase_step(white, PhaseParameters())
    assert white_texture(np.full((2, 3), 65535, np.uint16)).dtype == np.float32


@pytest.fixture(scope="module")
def surface():
    """A random texture, larger than the images of it."""
    pattern = gaussian_filter(np.random.default_rng(7).normal(size=(200, 400)), 1.5)
    return (100 + 30 * pattern / pattern.std()).astype(np.float32)


def seen(surface, dx, dy, shape=(96, 128)):
    """An image in which the material has moved by whole pixels: dx to the right, dy downwards."""
    return np.ascontiguousarray(surface[40 - dy : 40 - dy + shape[0], 200 - dx : 200 - dx + shape[1]])


def median(result):
    return np.nanmedian(result.displacement.reshape(-1, 2), axis=0)


def test_displacement_is_measured_against_the_first_step(surface):
    tracker = DisplacementTracker(DicParameters(window=24, spacing=4))
    first = tracker.step("e", 5, 50, seen(surface, 0, 0))
    assert first.reference_step == 5
    assert first.rms == 0
    assert set(np.unique(first.displacement[np.isfinite(first.displacement)])) == {0.0}
    assert first.displacement.shape == (24, 32, 2)
    assert first.displacement.dtype == np.float32
    moved = tracker.step("e", 6, 60, seen(surface, 3, -2))
    assert (moved.reference_step, moved.origin, moved.spacing) == (5, (0, 0), 4)
    assert median(moved) == pytest.approx([3, -2], abs=0.01)
    assert moved.rms == pytest.approx(np.hypot(3, 2), abs=0.02)


def test_an_earlier_step_can_become_the_reference(surface):
    tracker = DisplacementTracker(DicParameters(window=24, spacing=4))
    for step, moved in enumerate((0, 2, 5)):
        tracker.step("e", step, step, seen(surface, moved, 0))
    tracker.set_reference("e", 1)
    later = tracker.step("e", 3, 3, seen(surface, 6, 1))
    assert later.reference_step == 1
    assert median(later) == pytest.approx([4, 1], abs=0.01)
    tracker.set_reference("e", 0)
    assert median(tracker.step("e", 4, 4, seen(surface, 6, 1))) == pytest.approx([6, 1], abs=0.01)


def test_a_step_to_come_can_be_the_reference(surface):
    tracker = DisplacementTracker(DicParameters(window=24, spacing=4))
    tracker.step("e", 0, 0, seen(surface, 0, 0))
    tracker.set_reference("e", 2)
    with pytest.raises(StepError, match="step 1: its reference, step 2, was not measured") as caught:
        tracker.step("e", 1, 1, seen(surface, 1, 0))
    assert (caught.value.experiment, caught.value.step) == ("e", 1)
    assert tracker.step("e", 2, 2, seen(surface, 2, 0)).rms == 0
    assert median(tracker.step("e", 3, 3, seen(surface, 5, 0))) == pytest.approx([3, 0], abs=0.01)


def test_textures_kept_are_limited_and_the_reference_stays(surface):
    tracker = DisplacementTracker(DicParameters(window=24, spacing=8, kept_steps=2))
    for step in range(5):
        tracker.step("e", step, step, seen(surface, step, 0))
    assert median(tracker.step("e", 5, 5, seen(surface, 4, 0))) == pytest.approx([4, 0], abs=0.01)
    for dropped in (1, 2, 3):
        tracker.set_reference("e", dropped)
        with pytest.raises(StepError, match="no longer kept; set another reference or raise kept_steps"):
            tracker.step("e", 6, 6, seen(surface, 4, 0))


def test_a_failed_step_leaves_the_next_one_alone(surface):
    texture = np.random.default_rng(3).normal(100, 20, (96, 128)).astype(np.float32)
    steps = [(step, seen(surface, 2 * step, 0)) for step in (0, 1, 2, 4)]
    untouched, disturbed = (DisplacementTracker(DicParameters(window=24, spacing=4)) for _ in range(2))
    for step, image in steps[:3]:
        untouched.step("e", step, step, image)
        disturbed.step("e", step, step, image)
    with pytest.raises(FringedicError):
        disturbed.step("e", 3, 3, texture)
    with pytest.raises(StepError, match="is 64x48 px, its reference step 0 has 128x96 px"):
        disturbed.step("e", 3, 3, texture[:48, :64])
    expected, result = (each.step("e", *steps[3][:1], 4, steps[3][1]) for each in (untouched, disturbed))
    assert np.array_equal(result.displacement, expected.displacement, equal_nan=True)


def test_a_first_step_that_fails_is_no_reference(surface):
    tracker = DisplacementTracker(DicParameters(window=24, spacing=4, minimum_valid_fraction=0.5))
    mostly_hidden = np.full((96, 128), np.nan, np.float32)
    mostly_hidden[:, :40] = seen(surface, 0, 0)[:, :40]
    with pytest.raises(StepError, match="minimum_valid_fraction requires 50"):
        tracker.step("e", 0, 0, mostly_hidden)
    assert tracker.step("e", 1, 1, seen(surface, 1, 0)).reference_step == 1


def test_each_experiment_has_its_own_reference(surface):
    tracker = DisplacementTracker(DicParameters(window=24, spacing=4))
    tracker.step("one", 0, 0, seen(surface, 0, 0))
    assert tracker.step("two", 0, 1, seen(surface, 5, 0)).rms == 0
    assert median(tracker.step("two", 1, 2, seen(surface, 6, 0))) == pytest.approx([1, 0], abs=0.01)
    assert median(tracker.step("one", 1, 3, seen(surface, 6, 0))) == pytest.approx([6, 0], abs=0.01)


def test_a_long_way_is_followed_in_small_steps(surface):
    """70 px in all, more than half of the image, always against the first one."""
    tracker = DisplacementTracker(DicParameters(window=24, spacing=4))
    for step in range(11):
        result = tracker.step("e", step, step, seen(surface, 7 * step, -step))
    assert result.reference_step == 0
    assert median(result) == pytest.approx([70, -10], abs=0.01)
    there = np.isfinite(result.displacement[..., 0])
    assert there[:, : (128 - 70) // 4 - 4].mean() > 0.7


def ageing(surface, steps=11, motion=3):
    """Images of a surface that moves while its texture turns into another one, a tenth of a right angle per step."""
    other = np.roll(surface[::-1, ::-1], 37, axis=1)
    for step in range(steps):
        angle = step * np.pi / 20
        texture = 100 + np.cos(angle) * (surface - 100) + np.sin(angle) * (other - 100)
        yield step, seen(texture.astype(np.float32), motion * step, -step)


def test_a_texture_that_changes_is_followed_from_step_to_step(surface):
    """Nothing of the last image agrees with the first; the displacement still counts from there."""
    tracker, alone = (
        DisplacementTracker(DicParameters(window=24, spacing=4, rereference_fraction=fraction)) for fraction in (0.8, 0)
    )
    results = [tracker.step("e", step, step, image) for step, image in ageing(surface)]
    images = [image for _, image in ageing(surface)]
    with pytest.raises(FringedicError):
        [alone.step("e", step, step, image) for step, image in enumerate(images)]
    assert all(each.reference_step == 0 for each in results)
    steps = [each.correlated_step for each in results]
    assert steps[1] == 0
    assert steps == sorted(steps)
    assert steps[-1] >= 3
    assert len(set(steps)) < len(steps)
    errors = [np.abs(median(each) - [3 * step, -step]).max() for step, each in enumerate(results)]
    sigmas = [np.nanmedian(each.sigma) for each in results]
    assert all(wrong < 3 * sigma for wrong, sigma in zip(errors[1:], sigmas[1:], strict=True))
    assert sigmas[-1] > 1.3 * sigmas[1]
    repeated = DisplacementTracker(DicParameters(window=24, spacing=4))
    for (step, image), first in zip(ageing(surface), results, strict=True):
        again = repeated.step("e", step, step, image)
        assert again.displacement.tobytes() == first.displacement.tobytes()
        assert again.sigma.tobytes() == first.sigma.tobytes()


def test_leaving_the_image_is_no_change_of_texture(surface):
    tracker = DisplacementTracker(DicParameters(window=24, spacing=4))
    steps = [tracker.step("e", step, step, seen(surface, 9 * step, 0)) for step in range(8)]
    assert steps[-1].valid_fraction < 0.6 * steps[0].valid_fraction
    assert [each.correlated_step for each in steps] == [0] * 8


def test_a_motion_that_turns_is_no_change_of_texture(surface):
    """The extrapolation is 40 px off, and the last step shows the reference image."""
    for fraction in (0.8, 0.0):
        tracker = DisplacementTracker(DicParameters(window=24, spacing=4, rereference_fraction=fraction))
        steps = [tracker.step("e", step, step, seen(surface, dx, 0)) for step, dx in enumerate((0, 20, 0, 0))]
        assert [each.correlated_step for each in steps] == [0] * 4
        assert steps[3].valid_fraction > 0.95 * steps[0].valid_fraction


def rectangle(left, top, right, bottom):
    """The region between two corners [px], as the parameter of the node."""
    corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
    return Region((Polygon(corners),), 128, 96).to_text()


def test_a_step_does_not_depend_on_those_before(speckle):
    """A stretch leads the prediction of the rotation after it astray; the reference is still seen everywhere."""
    surface = speckle((240, 320), 4)

    def rotation(x, y):
        c, s = np.cos(np.radians(5)), np.sin(np.radians(5))
        return (c - 1) * (x - 160) - s * (y - 120) + 6, s * (x - 160) + (c - 1) * (y - 120) + 3

    def stretched(part):
        return surface.image(lambda x, y: (part * x, part * y), noise=20).astype(np.float32)

    reference = surface.image(noise=20, seed=1).astype(np.float32)
    steps = [stretched(0.0075), stretched(0.01)]
    turned = surface.image(rotation, noise=20, seed=2).astype(np.float32)
    fields = []
    for between in ([], steps[:1], steps):
        tracker = DisplacementTracker(DicParameters(window=24, spacing=4))
        for number, texture in enumerate([reference, *between, turned]):
            result = tracker.step("test", number, number, texture)
        assert result.correlated_step == 0
        fields.append(result.field)
    for field in fields[1:]:
        assert np.isfinite(field.displacement_x).sum() > 0.999 * np.isfinite(fields[0].displacement_x).sum()
        away = (field.displacement_x - fields[0].displacement_x) / fields[0].sigma_x
        assert float(np.sqrt((away**2).mean())) < 0.05


def test_a_later_reference_is_measured_in_the_same_region(surface):
    """Beside the region another body moves otherwise; windows at the border would contain it."""
    tracker = DisplacementTracker(DicParameters(window=24, spacing=4, region=rectangle(0, 0, 72, 96)))
    for step, image in ageing(surface, steps=9, motion=1):
        edge = 72 + step
        image[:, edge:] = seen(surface[::-1, ::-1], -2 * step, 2 * step)[:, edge:]
        result = tracker.step("e", step, step, image)
        if step > 3:
            errors = result.displacement - np.float32([step, -step])
            border, inside = (np.sqrt(np.nanmean(errors[:, part] ** 2)) for part in (slice(14, 18), slice(2, 12)))
            assert border < 1.2 * inside, step
        assert np.isnan(result.displacement[:, 18:]).all()
    assert result.correlated_step > 3


def test_a_part_is_found_again_where_its_displacement_leads():
    row, column = np.mgrid[0:96:4, 0:128:4].astype(np.float32)
    vectors = np.stack([0.05 * column + 3, -0.03 * row - 2], axis=-1)
    vectors[:3] = np.nan
    field = displacement_field(vectors, vectors, origin=(0, 0), spacing=4, window=24, method="dense")
    mask = np.zeros((96, 128), bool)
    mask[30:70, 20:60] = True
    moved = np.argwhere(moved_mask(mask, field))
    first, last = moved.min(axis=0), moved.max(axis=0)
    assert np.abs(first - [30 - 0.9 - 2, 20 + 1 + 3]).max() <= 1
    assert np.abs(last - [69 - 2.07 - 2, 59 + 2.95 + 3]).max() <= 1
    assert len(moved) == np.prod(last - first + 1)


def test_a_changed_region_begins_again(surface):
    tracker = DisplacementTracker(DicParameters(window=24, spacing=4))
    for step in range(3):
        tracker.step("e", step, step, seen(surface, step, 0))
    tracker.parameters = DicParameters(window=24, spacing=4, region=rectangle(40, 30, 80, 70))
    for step in (3, 4):
        result = tracker.step("e", step, step, seen(surface, step, 0))
        assert result.correlated_step == 0
        assert 0.5 < result.valid_fraction <= 1
        assert np.isnan(result.displacement[:, :9]).all()


def test_a_changed_window_prepares_a_later_reference_again(surface):
    tracker = DisplacementTracker(DicParameters(window=24, spacing=4))
    images = dict(ageing(surface))
    for step in range(8):
        result = tracker.step("e", step, step, images[step])
    assert result.correlated_step > 0
    tracker.parameters = DicParameters(window=32, spacing=4)
    wider = tracker.step("e", 8, 8, images[8])
    assert wider.reference_step == 0
    assert median(wider) == pytest.approx([24, -8], abs=float(3 * np.nanmedian(wider.sigma)))


def test_parameters_change_between_steps(surface):
    tracker = DisplacementTracker(DicParameters(window=24, spacing=4))
    tracker.step("e", 0, 0, seen(surface, 0, 0))
    narrow = tracker.step("e", 1, 1, seen(surface, 3, 1))
    tracker.parameters = DicParameters(window=48, spacing=8)
    wide = tracker.step("e", 2, 2, seen(surface, 3, 1))
    assert wide.displacement.shape == (12, 16, 2)
    assert median(wide) == pytest.approx([3, 1], abs=0.01)
    assert np.nanmedian(wide.sigma) < np.nanmedian(narrow.sigma)


def plane(height, slope=0.0):
    """Phase and exact z of the plane z = height + slope x, as the camera sees it."""
    column, row = np.meshgrid(np.arange(72), np.arange(60))
    x_ray = RIG.pixel_size * (column - RIG.principal_column) / RIG.camera_distance
    z = (height + slope * x_ray * RIG.camera_distance) / (1 + slope * x_ray)
    x = x_ray * (RIG.camera_distance - z)
    y = -RIG.pixel_size * (row - RIG.principal_row) / RIG.camera_distance * (RIG.camera_distance - z)
    return RIG.phase(x, y, z, PITCHES[-1]).astype(np.float32), z


def couple_step(tracker, step, height, dx=0.0, dy=0.0, slope=0.0, reference=0):
    displacement = np.zeros((60, 72, 2), np.float32)
    displacement[..., 0], displacement[..., 1] = dx, dy
    small = np.full((60, 72), 1e-3, np.float32)
    sigma = np.full((60, 72, 2), 1e-3, np.float32)
    return tracker.step(
        phase_result(step, plane(height, slope)[0], small), dic_result(step, displacement, sigma, reference)
    )


def phase_result(step, phase, sigma):
    maps = xr.Dataset({"phase": (("row", "column"), phase), "sigma": (("row", "column"), sigma)})
    return PhaseResult("e", step, step, maps, pitch=PITCHES[-1])


def dic_result(step, displacement, sigma, reference=0):
    field = displacement_field(displacement, sigma, origin=(0, 0), spacing=1, window=0, method="")
    return DicResult("e", step, step, reference, reference, field)


def test_a_plane_that_moves_gives_its_motion_with_the_right_signs():
    tracker = ShapeTracker(CouplingParameters())
    with pytest.raises(StepError, match="step 0: no calibration yet"):
        couple_step(tracker, 0, 0.0)
    tracker.set_calibration(RIG)
    first = couple_step(tracker, 0, 0.0, slope=0.1)
    assert first.reference_step == 0
    assert np.nanmax(np.abs(first.displacement["w"])) == 0
    np.testing.assert_allclose(first.shape["z"], plane(0.0, 0.1)[1], atol=2e-6)
    assert list(first.shape) == ["x", "y", "z", "sigma_z"]
    level = ShapeTracker(CouplingParameters())
    level.set_calibration(RIG)
    couple_step(level, 0, 0.0)
    # 5 px to the right and 3 px down at 0.2 mm/px: u = 1 mm, v = -0.6 mm
    moved = couple_step(level, 1, 0.0, dx=5, dy=3).displacement
    expected = ["x", "y", "z", "u", "v", "w", "sigma_u", "sigma_v", "sigma_w", "noise_z", "noise_z_deformed"]
    assert list(moved) == [*expected, "u_t", "v_t", "w_n", "e_11", "e_22", "e_12"]
    assert np.nanmedian(moved["u"]) == pytest.approx(1e-3, abs=2e-6)
    assert np.nanmedian(moved["v"]) == pytest.approx(-0.6e-3, abs=2e-6)
    assert np.nanmedian(moved["w"]) == pytest.approx(0, abs=2e-6)
    lifted = couple_step(level, 2, 1e-3)
    assert np.nanmedian(lifted.displacement["w"]) == pytest.approx(1e-3, rel=1e-3)
    assert lifted.rms == pytest.approx(1e-3, rel=0.02)


def test_the_shape_of_an_earlier_step_can_become_the_reference():
    tracker = ShapeTracker(CouplingParameters(strain_window_px=0, local_frame_window_px=0))
    tracker.set_calibration(RIG)
    for step, height in enumerate((0.0, 1e-3, 3e-3)):
        couple_step(tracker, step, height)
    result = couple_step(tracker, 3, 3e-3, reference=1)
    assert result.reference_step == 1
    assert np.nanmedian(result.displacement["w"]) == pytest.approx(2e-3, rel=1e-3)
    assert "u_t" not in result.displacement
    assert "e_11" not in result.displacement
    with pytest.raises(StepError, match="step 4: its reference, step 7"):
        couple_step(tracker, 4, 0.0, reference=7)


def test_the_reference_of_the_shape_is_that_of_the_displacement():
    """The first step was coupled without a calibration; the second one would have become the reference of w alone."""
    tracker = ShapeTracker(CouplingParameters())
    with pytest.raises(StepError, match="step 0: no calibration yet"):
        couple_step(tracker, 0, 0.0)
    tracker.set_calibration(RIG)
    for step, height in ((1, 1e-3), (2, 3e-3)):
        with pytest.raises(StepError, match=f"step {step}: its reference, step 0, was not measured"):
            couple_step(tracker, step, height)


def test_a_step_that_was_rejected_as_the_reference_leaves_the_one_before():
    shapes = ShapeTracker(CouplingParameters(kept_steps=2))
    shapes.set_calibration(RIG)
    for step in range(4):
        couple_step(shapes, step, 1e-3 * step)
    couple_step(shapes, 4, 4e-3, reference=4)  # it did not hold
    assert np.nanmedian(couple_step(shapes, 5, 5e-3).displacement.w) == pytest.approx(5e-3, rel=1e-3)
    couple_step(shapes, 6, 6e-3, reference=6)
    couple_step(shapes, 7, 8e-3, reference=6)
    with pytest.raises(StepError, match="its reference, step 0, was not measured or is no longer kept"):
        couple_step(shapes, 8, 0.0)


def test_phases_that_were_corrected_otherwise_are_not_compared():
    tracker = ShapeTracker(CouplingParameters())
    tracker.set_calibration(RIG)
    couple_step(tracker, 0, 0.0)
    small, nothing = np.full((60, 72), 1e-3, np.float32), np.full((60, 72, 2), 1e-3, np.float32)
    corrected = replace(phase_result(1, plane(0.0)[0], small), corrections=(Correction(CorrectionKind.LENS_BLUR, 0.8),))
    with pytest.raises(
        StepError, match=r"corrected for lens blur 0\.8 px, and that of its reference step 0 for nothing"
    ):
        tracker.step(corrected, dic_result(1, nothing, nothing))


def test_a_new_calibration_holds_for_the_reference_too():
    tracker = ShapeTracker(CouplingParameters())
    tracker.set_calibration(RIG)
    couple_step(tracker, 0, 1e-3)
    tracker.set_calibration(replace(RIG, projector_k1=0.5))
    again = couple_step(tracker, 1, 1e-3)
    assert np.nanmax(np.abs(again.displacement["w"])) < 1e-9


def test_smoothing_lessens_the_noise_of_w_and_leaves_the_shape():
    noise = np.random.default_rng(5).normal(0, 0.02, (60, 72)).astype(np.float32)
    sigma, nothing = np.full((60, 72), 0.02, np.float32), np.zeros((60, 72, 2), np.float32)
    spread, shapes = [], []
    for filter_px in (0.0, 2.0):
        tracker = ShapeTracker(CouplingParameters(z_filter_px=filter_px))
        tracker.set_calibration(RIG)
        couple_step(tracker, 0, 0.0)
        phase = plane(0.0)[0] + noise
        result = tracker.step(phase_result(1, phase, sigma), dic_result(1, nothing, nothing))
        spread.append(np.nanstd(result.displacement["w"]))
        shapes.append(result.shape["z"])
    assert spread[1] < 0.3 * spread[0]
    assert np.array_equal(*shapes)


@pytest.mark.parametrize("outdated", ["no", "calibration", "filter"])
def test_a_surface_made_beforehand_gives_the_same_and_is_made_again_when_it_is_outdated(outdated):
    other = replace(RIG, projector_k1=0.5)
    used = other if outdated == "calibration" else RIG
    filters = (2.0, 3.0 if outdated == "filter" else 2.0)
    displacement = np.full((60, 72, 2), (0.3, -0.2), np.float32)
    results = []
    for beforehand in (False, True):
        tracker = ShapeTracker(CouplingParameters(z_filter_px=filters[0]))
        phase = phase_result(1, plane(1e-3)[0], np.full((60, 72), 0.02, np.float32))
        assert tracker.surface(phase) is None, "there is no calibration"
        tracker.set_calibration(RIG)
        couple_step(tracker, 0, 0.0)
        surface = tracker.surface(phase) if beforehand else None
        tracker.set_calibration(used)
        tracker.parameters = CouplingParameters(z_filter_px=filters[1])
        spread = np.full_like(displacement, 0.01)
        results.append(tracker.step(phase, dic_result(1, displacement, spread), surface=surface))
    for fields in ("shape", "displacement"):
        for name, array in getattr(results[0], fields).items():
            assert array.values.tobytes() == getattr(results[1], fields)[name].values.tobytes(), name
