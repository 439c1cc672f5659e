"""Steps whose patterns are taken at several exposure times: from single frames to the phase, and what may go wrong."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from fringedic.errors import StepError
from fringedic.frames.collector import FrameCollector, Stack
from fringedic.frames.records import FrameRecord
from fringedic.patterns.sequences import PatternSequence, fringe_sequence, one_image_sequence
from fringedic.phase.findings import FindingKind
from fringedic.steps.parameters import PhaseParameters
from fringedic.steps.phase import phase_step
from fringedic.steps.step_results import PhaseResult
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

TIMES = (0.002, 0.008, 0.032)
Frames = list[tuple[FrameRecord, np.ndarray]]


@pytest.fixture(scope="module")
def twin() -> VirtualRig:
    """Glare where the light falls straight on bright paint, and paint that is 50 times darker."""
    entries = {"preset": "sphere", "size": "small", "texture": {"floor": 0.02}, "sensor": {"ambient_light": 0.005}}
    return VirtualRig(VirtualRigConfiguration.from_dict(entries))


def sequence_of(twin: VirtualRig) -> PatternSequence:
    rows, columns = twin.projector_shape
    return fringe_sequence(columns, rows, [columns, 40, 10], 4)


def taken(
    twin: VirtualRig, sequence: PatternSequence, times: tuple[float, ...] = TIMES, reference: float = TIMES[0]
) -> Frames:
    """Every pattern at every exposure time; the twin's white level is that of the time `reference`."""
    shown = [(pattern, time) for pattern in sequence.patterns for time in times]
    return [
        (
            FrameRecord("e", 7, index, len(shown), pattern, 1000 + index, time),
            twin.expose(sequence.image(pattern), 0.0, index, exposure_factor=time / reference),
        )
        for index, (pattern, time) in enumerate(shown)
    ]


@pytest.fixture(scope="module")
def frames(twin: VirtualRig) -> Frames:
    return taken(twin, sequence_of(twin))


def joined(frames: Frames) -> Stack:
    collector = FrameCollector()
    stack = [collector.add(record, image) for record, image in frames][-1]
    assert stack is not None
    return stack


def measured(frames: Frames, **parameters: object) -> PhaseResult:
    return phase_step(joined(frames), PhaseParameters.model_validate(parameters))


def error_of(twin: VirtualRig, phase: np.ndarray, pitch: float = 10.0) -> np.ndarray:
    """Error of a phase against the twin's truth [rad]."""
    middle = (twin.projector_shape[1] - 1) / 2
    return phase - 2 * np.pi * (twin.view(0.0).projector_column - middle) / pitch


def test_merged_exposures_measure_more_of_the_surface_with_true_sigmas(twin: VirtualRig, frames: Frames) -> None:
    alone = {
        time: measured([(replace(record, index=k, count=12), image) for k, (record, image) in enumerate(frames[n::3])])
        for n, time in enumerate(TIMES[:2])
    }
    merged = measured(frames)
    error = error_of(twin, merged.phase)
    score = float(np.nanstd(error / merged.sigma))
    said = f"valid {merged.valid_fraction:.1%}, alone {[f'{each.valid_fraction:.1%}' for each in alone.values()]}"
    assert merged.valid_fraction > 0.99 > max(each.valid_fraction for each in alone.values()) + 0.05, said
    assert 0.95 < score < 1.05, f"z-score {score:.3f}; {said}"
    assert not (np.abs(error) > np.pi).any()
    for each in alone.values():
        both = np.isfinite(each.phase) & np.isfinite(merged.phase)
        rms = [float(np.sqrt(np.mean(error_of(twin, phase)[both] ** 2))) for phase in (each.phase, merged.phase)]
        assert rms[1] < 0.8 * rms[0], f"error {rms[0]:.4f} rad alone, {rms[1]:.4f} rad merged"
    known = np.isfinite(merged.texture)
    assert not np.isinf(merged.texture).any()
    assert known.mean() > 0.9


def test_the_order_of_the_exposure_times_decides_the_unit_alone(frames: Frames) -> None:
    turned = [frames[3 * (index // 3) + 2 - index % 3] for index in range(len(frames))]
    turned = [(replace(record, index=k), image) for k, (record, image) in enumerate(turned)]
    first, last = measured(frames), measured(turned)
    np.testing.assert_allclose(last.phase, first.phase, atol=1e-4)
    np.testing.assert_allclose(last.modulation, first.modulation * (TIMES[2] / TIMES[0]), rtol=1e-3)


def test_one_image_of_several_exposures(twin: VirtualRig) -> None:
    rows, columns = twin.projector_shape
    result = measured(taken(twin, one_image_sequence(columns, rows, 10, grey=True)), relative_phase="accept")
    error = error_of(twin, result.phase) / (2 * np.pi)
    error -= np.round(np.nanmedian(error))
    rms = float(np.sqrt(np.nanmean(error[30:-30, 30:-30] ** 2)))
    assert result.relative
    assert result.valid_fraction > 0.9
    assert rms < 0.005, f"{rms:.5f} fringe"


def swap_patterns(frames: Frames) -> Frames:
    images = [image for _, image in frames]
    images[12], images[15] = images[15], images[12]  # of the shortest exposure only
    return [(record, image) for (record, _), image in zip(frames, images, strict=True)]


def lose_pattern(frames: Frames) -> Frames:
    return [
        (record, image if record.index != 13 else frames[10][1]) for record, image in frames
    ]  # the pattern before, at the middle exposure


@pytest.mark.parametrize(
    ("fault", "kind", "index", "words"),
    [
        (swap_patterns, StepError, 12, "exposed for 2 ms: frames 12 and 15 are interchanged"),
        (lose_pattern, StepError, 13, "exposed for 8 ms: frame 13 does not show its pattern"),
    ],
)
def test_every_exposure_is_proven_to_show_its_pattern(
    frames: Frames, fault: Callable[[Frames], Frames], kind: type[StepError], index: int, words: str
) -> None:
    with pytest.raises(kind, match=words) as caught:
        measured(fault(frames))
    assert (caught.value.index, caught.value.step) == (index, 7)


def test_a_missing_exposure_is_named(frames: Frames) -> None:
    with pytest.raises(StepError, match="frame 13 of 36 never arrived"):
        joined([each for each in frames if each[0].index != 13])
    wrong = [(replace(record, exposure_time=TIMES[0]) if record.index == 13 else record, i) for record, i in frames]
    with pytest.raises(StepError, match=r"shift 1 of 4 was not exposed for 8 ms, other patterns were"):
        joined(wrong)


def test_exposures_that_show_nothing_are_told_and_do_no_harm(twin: VirtualRig) -> None:
    sequence = sequence_of(twin)
    bright = measured(taken(twin, sequence, (0.002, 0.5)))
    assert [
        each
        for each in bright.remarks
        if (each.kind, each.exposure_time, each.value) == (FindingKind.SATURATED, 0.5, 1.0)
    ]
    np.testing.assert_allclose(error_of(twin, bright.phase)[np.isfinite(bright.phase)], 0, atol=0.6)
    with pytest.raises(StepError, match="of the image saturates"):
        measured(taken(twin, sequence, (0.4, 0.5)))
    with pytest.raises(StepError, match="is dark"):
        measured(taken(twin, sequence, (0.00001, 0.00002)))


def test_times_that_a_camera_makes_of_one_are_one(twin: VirtualRig) -> None:
    single = taken(twin, sequence_of(twin), TIMES[:1])
    varied = [
        (replace(record, exposure_time=TIMES[0] * (1 + 1e-3 * (-1) ** k)), i) for k, (record, i) in enumerate(single)
    ]
    assert measured(varied).phase.tobytes() == measured(single).phase.tobytes()
