"""Scenes as laboratories have them; benchmarks/stack_checks.py measures thousands of them."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from fringedic.frames.region import Region
from fringedic.patterns.sequences import PatternSequence, fringe_sequence, gray_code_sequence
from fringedic.phase.checks.stack import inspect_stack
from fringedic.phase.findings import Finding, FindingKind
from fringedic.phase.settings import PhaseSettings
from fringedic.virtual_rig import FringeScene

SMALL = FringeScene(seed=5, specimen=0.15, grey=55.0, read_noise=1.5, last_column=1900.0)
BENT = FringeScene(
    seed=6, gamma=2.3, grey=75.0, contrast=0.7, texture=0.3, texture_size=3.4, read_noise=1.8, bits=0, last_column=790.0
)
CODE = gray_code_sequence(800, 4, 16, 4)
PITCHES = fringe_sequence(1920, 4, [1920, 480, 120], 8)


def expose(scene: FringeScene, sequence: PatternSequence, order: Sequence[int] | None = None) -> np.ndarray:
    images = list(sequence)
    shown = range(len(images)) if order is None else order
    return np.array([scene.expose(images[each], index) for index, each in enumerate(shown)])


def inspect(scene: FringeScene, sequence: PatternSequence, order: Sequence[int] | None = None) -> list[Finding]:
    frames = expose(scene, sequence, order)
    return inspect_stack(frames, sequence.patterns, PhaseSettings(saturation=scene.saturation))


@pytest.mark.parametrize("specimen", [0.1, 0.2])
@pytest.mark.parametrize("bits", [8, 12])
def test_a_small_specimen_before_a_dark_background_is_accepted(specimen: float, bits: int) -> None:
    scene = FringeScene(
        seed=3, specimen=specimen, grey=55.0, texture=0.45, read_noise=1.5, last_column=1900.0, bits=bits
    )
    assert inspect(scene, PITCHES) == []


def test_three_shifts_of_a_small_specimen_with_noise_of_many_grey_levels_are_accepted() -> None:
    """The noise follows from the means of the pitches; that of rounding alone would count the background as lit."""
    scene = FringeScene(seed=7, specimen=0.25, grey=50.0, contrast=0.65, read_noise=2.2, bits=12, last_column=1100.0)
    assert inspect(scene, fringe_sequence(1280, 4, [1280, 520, 211, 86, 35], 3)) == []


@pytest.mark.parametrize("gamma", [1.6, 2.2])
def test_a_nonlinear_projector_is_accepted_at_any_pitch_in_the_image(gamma: float) -> None:
    """22 px of the camera were twice the step between the sampled columns."""
    scene = FringeScene(rows=600, columns=900, gamma=gamma, grey=80.0, last_column=800.0, texture=0.05, relief=0.0)
    pitch = 22.0 * 800 / 900
    assert inspect(scene, fringe_sequence(800, 4, [800, 120, pitch], 12)) == []


@pytest.mark.parametrize("seed", range(4))
def test_random_good_stacks_are_accepted(seed: int) -> None:
    scene = FringeScene.random(seed, 800)
    found = inspect(
        scene, gray_code_sequence(800, 4, 40, 4) if seed % 2 else fringe_sequence(800, 4, [800, 160, 40], 6)
    )
    assert [each.kind for each in found if each.kind is not FindingKind.SATURATED] == []


@pytest.mark.parametrize("frame", [3, 10, 18])
def test_a_missing_frame_is_named(frame: int) -> None:
    order = [*range(frame), *range(frame + 1, 24), 23]
    (fault,) = inspect(SMALL, PITCHES, order)
    assert (fault.kind, fault.frames, fault.fault) == (FindingKind.MISSING, (frame,), True)


@pytest.mark.parametrize("frame", [3, 10, 18])
def test_a_frame_delivered_twice_is_named(frame: int) -> None:
    order = [*range(frame), *range(frame - 1, 23)]
    (fault,) = inspect(SMALL, PITCHES, order)
    assert (fault.kind, fault.frames) == (FindingKind.DOUBLED, (frame,))


def test_interchanged_bits_of_a_gray_code_are_named() -> None:
    """The parity of the bits does not show it; the numbers of the half periods jump."""
    sequence = gray_code_sequence(800, 4, 40, 4)
    scene = FringeScene(seed=2, grey=60.0, last_column=790.0, relief=3.0)
    order = list(range(len(sequence)))
    order[2], order[4] = 4, 2
    (fault,) = inspect(scene, sequence, order)
    assert (fault.kind, fault.frames) == (FindingKind.INTERCHANGED, (2, 4))


def test_a_wrong_frame_of_four_is_named_with_a_bent_response() -> None:
    """Three of four shifts fit any grey levels, and the second harmonic displaces their phases."""
    for frame in range(len(CODE) - 4, len(CODE)):
        order = list(range(len(CODE)))
        order[frame] -= 1
        (fault,) = inspect(BENT, CODE, order)
        assert (fault.kind, fault.frames) == (FindingKind.OTHER_PATTERN, (frame,))


def test_a_gray_code_between_two_patterns_is_named() -> None:
    """Its bits are neither dark nor bright where they follow another one."""
    light = [BENT.light(image) for image in CODE]
    frames = np.array([BENT.record(0.65 * each + 0.35 * light[k - 1], k) for k, each in enumerate(light)])
    (fault,) = inspect_stack(frames, CODE.patterns)
    assert fault.kind is FindingKind.PARTLY_LATE
    assert fault.value == pytest.approx(0.35, abs=0.02)


@pytest.mark.parametrize("gamma", [1.0, 2.3])
def test_a_motion_between_the_second_and_third_of_four_shifts_is_named(gamma: float) -> None:
    """Beside the harmonics such a jump leaves no residual: it displaces the sinusoids."""
    scene = replace(BENT, gamma=gamma)
    middle = len(CODE) - 2
    frames = np.array(
        [
            scene.record(scene.light(image, motion=(0.3, -0.3) if k >= middle else (0.0, 0.0)), k)
            for k, image in enumerate(CODE)
        ]
    )
    faults = [each for each in inspect_stack(frames, CODE.patterns) if each.fault]
    assert [each.kind for each in faults] == [FindingKind.MOTION_ACROSS]
    assert faults[0].value == pytest.approx(0.3 * math.sqrt(2), rel=0.5)  # four shifts determine a part of the course


def test_a_region_limits_the_checks_to_the_specimen() -> None:
    """Beside the specimen another surface moves."""
    scene = FringeScene(seed=4, grey=60.0, last_column=1900.0)
    moving = np.array(
        [scene.record(scene.light(image, lift=3.0 * k), k) for k, image in enumerate(PITCHES)], dtype=np.uint8
    )
    frames = expose(scene, PITCHES)
    frames[:, :, 200:] = moving[:, :, 200:]
    assert [each.kind for each in inspect_stack(frames, PITCHES.patterns) if each.fault]
    region = Region.rectangle((0, 0), (180, 449))
    assert inspect_stack(frames, PITCHES.patterns, PhaseSettings(region=region)) == []


def test_a_specimen_that_has_left_its_region_is_checked_where_it_is() -> None:
    frames = expose(FringeScene(seed=4, grey=60.0, last_column=1900.0), PITCHES)
    frames[:, :, :200] = 3
    assert inspect_stack(frames, PITCHES.patterns, PhaseSettings(region=Region.rectangle((0, 0), (180, 449)))) == []
    frames[[9, 10]] = frames[[10, 9]]
    (fault,) = inspect_stack(frames, PITCHES.patterns, PhaseSettings(region=Region.rectangle((0, 0), (180, 449))))
    assert fault.kind is FindingKind.INTERCHANGED
