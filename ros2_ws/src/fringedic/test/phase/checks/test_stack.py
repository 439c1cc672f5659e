"""Faulty stacks from the virtual rig: each is refused with its own error and a message that names the cause."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fringedic.errors import ErrorCode, StepError
from fringedic.patterns.pattern import PatternKind
from fringedic.patterns.sequences import PatternSequence, fringe_sequence, gray_code_sequence
from fringedic.phase.checks import check_stack
from fringedic.phase.sentences import describe
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration


def rig_of(**changes: object) -> VirtualRig:
    return VirtualRig(VirtualRigConfiguration.from_dict({"size": "small", "seed": 4, **changes}))


def stack_of(
    twin: VirtualRig, sequence: PatternSequence, position: Callable[[int], float] = lambda _: 0.0
) -> np.ndarray:
    return np.array([twin.expose(image, position(index), index) for index, image in enumerate(sequence)])


def sequence_of(
    twin: VirtualRig, shifts: int | list[int], pitches: tuple[float, ...] = (0.0, 40.0, 10.0)
) -> PatternSequence:
    rows, columns = twin.projector_shape
    return fringe_sequence(columns, rows, [pitch or columns for pitch in pitches], shifts)


@pytest.fixture(scope="module")
def plate() -> VirtualRig:
    return rig_of(preset="plate")


@pytest.fixture(scope="module", params=[4, 8])
def measured(request: pytest.FixtureRequest, plate: VirtualRig) -> tuple[PatternSequence, np.ndarray]:
    sequence = sequence_of(plate, request.param)
    return sequence, stack_of(plate, sequence)


@pytest.mark.parametrize("preset", ["plate", "skin", "leather", "stepped", "sphere"])
def test_a_good_stack_passes_without_remarks(preset: str) -> None:
    twin = rig_of(preset=preset)
    rows, columns = twin.projector_shape
    for shifts in (3, 4, 5):
        for sequence in (sequence_of(twin, shifts), gray_code_sequence(columns, rows, 10, shifts)):
            assert check_stack(stack_of(twin, sequence), sequence.patterns) == []


@pytest.mark.parametrize("kind", [np.uint8, np.float32])
def test_fringes_without_noise_are_good(kind: type[np.generic]) -> None:
    """Their modulation is the same at every pixel."""
    sequence = fringe_sequence(240, 180, [240, 40, 10], 4)
    frames = np.array([25 + 0.8 * image.astype(np.float32) for image in sequence]).astype(kind)
    assert check_stack(frames, sequence.patterns) == []


@pytest.fixture(scope="module")
def bent() -> VirtualRig:
    return rig_of(preset="plate", projector={"gamma": 2.2})


@pytest.mark.parametrize("shifts", [4, 5, 8])
def test_gamma_is_no_fault_of_the_stack(bent: VirtualRig, shifts: int) -> None:
    rows, columns = bent.projector_shape
    for sequence in (sequence_of(bent, shifts), gray_code_sequence(columns, rows, 10, shifts)):
        assert check_stack(stack_of(bent, sequence), sequence.patterns) == []


def test_gamma_with_three_shifts_is_named_where_it_spoils_the_orders(bent: VirtualRig) -> None:
    sequence = sequence_of(bent, 3)
    with pytest.raises(StepError, match="measure the response curve or show four"):
        check_stack(stack_of(bent, sequence), sequence.patterns)


@pytest.mark.parametrize("group", [0, 1, 2])
@pytest.mark.parametrize("pair", [(0, 1), (1, 3), (0, 3)])
def test_interchanged_frames_are_named(
    measured: tuple[PatternSequence, np.ndarray], group: int, pair: tuple[int, int]
) -> None:
    sequence, frames = measured
    first, second = (group * len(frames) // 3 + each for each in pair)
    frames = frames.copy()
    frames[[first, second]] = frames[[second, first]]
    with pytest.raises(StepError, match=f"frames {first} and {second} are interchanged"):
        check_stack(frames, sequence.patterns)


def test_a_camera_ahead_of_the_projector_is_named(measured: tuple[PatternSequence, np.ndarray]) -> None:
    sequence, frames = measured
    with pytest.raises(StepError, match="the pattern of the frame before"):
        check_stack(np.roll(frames, 1, axis=0), sequence.patterns)


@pytest.mark.parametrize("index", [1, 6, 11])
@pytest.mark.parametrize("shown", [0.0, 250.0])
def test_a_frame_without_its_pattern_is_named(
    plate: VirtualRig, measured: tuple[PatternSequence, np.ndarray], index: int, shown: float
) -> None:
    sequence, frames = measured
    frames = frames.copy()
    frames[index] = plate.expose(np.full(plate.projector_shape, shown, np.uint8), 0.0, 99)
    with pytest.raises(StepError, match=f"frame {index} does not show its pattern"):
        check_stack(frames, sequence.patterns)


@pytest.mark.parametrize("shown", ["dark", "the pattern before"])
@pytest.mark.parametrize("shifts", [3, 4])
def test_every_frame_is_checked_for_its_pattern(plate: VirtualRig, shifts: int, shown: str) -> None:
    """Also the first and the last of a pitch, three shifts, which fit any three grey levels, and each bit of a code."""
    rows, columns = plate.projector_shape
    dark = plate.expose(np.zeros(plate.projector_shape, np.uint8), 0.0, 99)
    for sequence in (sequence_of(plate, shifts), gray_code_sequence(columns, rows, 10, shifts)):
        good = stack_of(plate, sequence)
        for index, pattern in enumerate(sequence.patterns):
            frames = good.copy()
            frames[index] = dark if shown == "dark" else good[index - 1]
            with pytest.raises(StepError, check=lambda e: e.code is ErrorCode.WRONG_PATTERN) as caught:
                check_stack(frames, sequence.patterns)
            alone = pattern.kind == PatternKind.FRINGES and shifts == 3 and sequence.patterns[0].shifts != shifts
            first = len(sequence) - shifts  # with one pitch and three shifts the frame is not identified
            assert caught.value.index == (first if alone else index), (shown, index, str(caught.value))


@pytest.mark.parametrize("light", [0.1, 0.15])
def test_a_projector_that_stays_dark_for_three_frames_is_named(plate: VirtualRig, light: float) -> None:
    """All pixels then have the same phase, and the dark frames look like a harmonic."""
    sequence = sequence_of(plate, 4, (0.0, 10.0))
    first, second = stack_of(plate, sequence)[:2].astype(float)
    dark = plate.expose(np.zeros(plate.projector_shape, np.uint8), 0.0, 99).astype(float)
    late = [dark, dark, dark, dark + light * (first - dark), first, first, 0.6 * first + 0.4 * second, second]
    with pytest.raises(StepError, check=lambda e: e.code is ErrorCode.WRONG_PATTERN):
        check_stack(np.round(late).astype(np.uint8), sequence.patterns)


def test_the_number_of_a_frame_in_its_step_is_named(measured: tuple[PatternSequence, np.ndarray]) -> None:
    sequence, frames = measured
    frames = frames.copy()
    frames[2] = frames[1]
    numbers = [2 * index + 1 for index in range(len(frames))]
    with pytest.raises(StepError, match="frame 5 does not show") as caught:
        check_stack(frames, sequence.patterns, numbers=numbers)
    assert caught.value.index == 5


@pytest.mark.parametrize("group", [1, 2])
@pytest.mark.parametrize("factor", [0.8, 1.25])
def test_a_wrong_pitch_is_named(plate: VirtualRig, group: int, factor: float) -> None:
    sequence = sequence_of(plate, 4)
    pitches = [0.0, 40.0, 10.0]
    pitches[group] *= factor
    frames = stack_of(plate, sequence_of(plate, 4, tuple(pitches)))
    with pytest.raises(StepError, match="do not continue those of pitch") as caught:
        check_stack(frames, sequence.patterns)
    if group == 2:
        seen = float(str(caught.value).split("their pitch is ")[1].split()[0])
        assert seen == pytest.approx(pitches[2], rel=0.05)


def test_other_shifts_than_recorded_are_named(plate: VirtualRig) -> None:
    shown = sequence_of(plate, [4, 4, 8])
    frames = stack_of(plate, shown)
    recorded = sequence_of(plate, 4)
    with pytest.raises(StepError):
        check_stack(frames[:12], recorded.patterns)


def test_mirrored_fringes_are_named(plate: VirtualRig) -> None:
    sequence = sequence_of(plate, 4)
    images = list(sequence)
    shown = [image[:, ::-1] if index >= 8 else image for index, image in enumerate(images)]
    frames = np.array([plate.expose(np.ascontiguousarray(image), 0.0, index) for index, image in enumerate(shown)])
    with pytest.raises(StepError, match=r"grows the wrong way|out of order"):
        check_stack(frames, sequence.patterns)


def test_a_projector_that_stands_still_is_named(plate: VirtualRig) -> None:
    sequence = sequence_of(plate, 4)
    image = sequence.frame(0)
    frames = np.array([plate.expose(image, 0.0, index) for index in range(len(sequence))])
    with pytest.raises(StepError, match="show the same image: the projector does not change"):
        check_stack(frames, sequence.patterns)
    good = stack_of(plate, sequence)
    good[8:] = frames[8:]
    with pytest.raises(StepError, match="all frames of pitch 10 px show the same image"):
        check_stack(good, sequence.patterns)


def test_frames_taken_long_before_their_patterns_are_named(plate: VirtualRig) -> None:
    """The projector is dark at first and up to four patterns late, in 60 random rhythms of the camera."""
    rows, columns = plate.projector_shape
    sequence = fringe_sequence(columns, rows, [columns, 16], shifts=4)
    images = [np.zeros((rows, columns), np.uint8), *sequence]
    seen = [plate.expose(image, 0.0, k).astype(float) for k, image in enumerate(images)]
    random = np.random.default_rng(8)
    for trial in range(60):
        shown = np.cumsum(random.uniform(15.0, random.choice([20.0, 30.0, 60.0]), len(sequence)))
        lit = shown + 80.0
        end = shown + 15.0  # of exposures of 10 ms
        shares = np.array([np.clip(end - each, 0.0, 10.0) / 10 for each in (-np.inf, *lit, np.inf)])
        late = np.einsum("pf,prc->frc", shares[:-1] - shares[1:], np.array(seen))
        noise = random.normal(0.0, 0.7, late.shape)
        with pytest.raises(StepError) as told:
            check_stack(np.clip(np.round(late + noise), 0, 255).astype(np.uint8), sequence.patterns)
        assert told.value.code in (ErrorCode.WRONG_PATTERN, ErrorCode.FRAMES_OUT_OF_ORDER), f"rhythm {trial}"


def test_saturated_and_dark_stacks_are_named(plate: VirtualRig) -> None:
    sequence = sequence_of(plate, 4)
    bright = np.array([plate.expose(image, 0.0, k, exposure_factor=12.0) for k, image in enumerate(sequence)])
    with pytest.raises(StepError, match="% of the image saturates: shorten the exposure"):
        check_stack(bright, sequence.patterns)
    dark = np.array([plate.expose(image, 0.0, k, exposure_factor=0.01) for k, image in enumerate(sequence)])
    with pytest.raises(StepError, match="is dark, grey level"):
        check_stack(dark, sequence.patterns)


@pytest.mark.parametrize("strength", [0.0, 0.06, 0.3])
def test_flicker_is_measured(plate: VirtualRig, strength: float, measured: tuple[PatternSequence, np.ndarray]) -> None:
    sequence, _ = measured
    brightness = 1 + strength * np.random.default_rng(3).uniform(-0.5, 0.5, len(sequence))
    frames = np.array([plate.expose(image, 0.0, k, exposure_factor=brightness[k]) for k, image in enumerate(sequence)])
    true = 100 * float(np.ptp(brightness[-len(frames) // 3 :]))
    if strength < 0.1:
        message = "; ".join(map(describe, check_stack(frames, sequence.patterns)))
        assert message.startswith("the light changes by") if strength else not message
    else:
        with pytest.raises(StepError, match="the light changes by") as caught:
            check_stack(frames, sequence.patterns)
        message = str(caught.value)
    if strength and len(sequence) > 12:  # four frames give the size of the change only roughly
        assert float(message.split("changes by ")[1].split()[0]) == pytest.approx(true, rel=0.15)


def test_a_single_flash_is_found_although_four_frames_hide_where(plate: VirtualRig) -> None:
    sequence = sequence_of(plate, 4)
    frames = np.array(
        [plate.expose(image, 0.0, k, exposure_factor=1.08 if k == 9 else 1.0) for k, image in enumerate(sequence)]
    )
    with pytest.raises(StepError, match="flicker"):
        check_stack(frames, sequence.patterns)


@pytest.mark.parametrize(
    ("specimen", "travel_px", "words"),
    [
        ({"translation": (1.0, 0.0, 0.0)}, 1.0, "across the image"),
        ({"translation": (0.0, 1.0, 0.0)}, 1.0, "across the image"),
        ({"translation": (0.0, 0.0, 1.0)}, 5.0, "along the projector's light"),
        ({"rotation_degree_per_mm": (0.0, 1.0, 0.0)}, 10.0, "along the projector's light"),
    ],
)
def test_a_surface_that_moves_during_its_stack_is_named(specimen: dict[str, Any], travel_px: float, words: str) -> None:
    """Across the image, towards the camera (0.09 fringe in all), or turning, while the frames are taken."""
    still = {"kind": "rigid", "translation": (0.0, 0.0, 0.0)}
    twin = rig_of(preset="rigid", specimen={**still, **specimen})
    sequence = sequence_of(twin, 8)
    travel = travel_px * 1e-6 * twin.configuration.camera.pixel_size_um
    finest = len(sequence) - 8  # each position costs a second; the coarse pitches stand still
    frames = stack_of(twin, sequence, lambda index: travel * max(index - finest, 0) / (len(sequence) - 1))
    with pytest.raises(StepError, match=words) as caught:
        check_stack(frames, sequence.patterns)
    if "moved by" in str(caught.value):
        seen = float(str(caught.value).split("moved by ")[1].split()[0])
        assert seen == pytest.approx(7 / 23, rel=0.2), "the part of the motion during the finest fringes"


def test_a_jolt_in_the_middle_is_named() -> None:
    twin = rig_of(preset="rigid")
    sequence = sequence_of(twin, 8)
    step = 0.4e-6 * twin.configuration.camera.pixel_size_um
    with pytest.raises(StepError, match="the surface moved by"):
        check_stack(stack_of(twin, sequence, lambda index: step * (index > 19)), sequence.patterns)


def test_too_small_images_are_left_alone(plate: VirtualRig) -> None:
    sequence = sequence_of(plate, 4)
    frames = stack_of(plate, sequence)[:, 100:106, 100:106]
    assert check_stack(np.ascontiguousarray(frames), sequence.patterns) == []
