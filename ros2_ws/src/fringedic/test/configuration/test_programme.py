"""Programmes: which step follows which, what ends a block, how long it takes and how much room it needs."""

from __future__ import annotations

from math import nan
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import ValidationError

from fringedic.configuration.conditions import MetCondition, Reading, Until
from fringedic.configuration.forecast import forecast
from fringedic.configuration.programme import BlockEnd, Programme
from fringedic.configuration.programme_check import check_programme, parse_programme
from fringedic.configuration.rig_file import RigFile, load_programme
from fringedic.errors import ConfigurationError, RecordingError

NESTED = """
experiment: fatigue
steps:
  - {position_mm: 0.0}
  - cycle:
      times: 3
      until: {valid_fraction_below: 0.6}
      steps:
        - {position_mm: 0.1, mode: none}
        - ramp: {from_mm: 0.2, to_mm: 0.4, steps: 3, until: {force_above_n: 500}}
  - {position_mm: 0.0, mode: white}
"""


def programme(text: str) -> Programme:
    return Programme.model_validate(yaml.safe_load(text))


def positions(
    test: Programme, force_per_mm: float, valid: dict[int, float] | None = None
) -> tuple[list[float], list[BlockEnd]]:
    """Positions [mm] that a walk visits on a machine of this stiffness, and the blocks that conditions end."""
    ended: list[BlockEnd] = []
    walk = test.walk(ended.append)
    visited: list[float] = []
    try:
        step = next(walk)
        while True:
            assert step.position_mm is not None
            visited.append(step.position_mm)
            fraction = (valid or {}).get(len(visited), 1.0)
            step = walk.send(Reading({"force": force_per_mm * step.position_mm}, nan, fraction))
    except StopIteration:
        return visited, ended


def test_without_a_condition_every_step_is_done() -> None:
    test = programme(NESTED)
    ramp = [0.1, 0.2, 0.3, 0.4]
    visited, ended = positions(test, force_per_mm=100)
    assert visited == pytest.approx([0.0, *ramp, *ramp, *ramp, 0.0])
    assert ended == []
    assert [step.position_mm for step in test.load_steps()] == pytest.approx(visited)
    assert test.count() == len(visited) == 14


def test_an_inner_condition_ends_its_block_only() -> None:
    visited, ended = positions(programme(NESTED), force_per_mm=2000)
    assert visited == pytest.approx([0.0, *[0.1, 0.2, 0.3] * 3, 0.0])
    assert ended == [BlockEnd("ramp", MetCondition("force", pytest.approx(600.0), 500.0, rising=True, unit="N"))] * 3


def test_an_outer_condition_ends_the_blocks_within() -> None:
    visited, ended = positions(programme(NESTED), force_per_mm=100, valid={3: 0.5})
    assert visited == pytest.approx([0.0, 0.1, 0.2, 0.0])
    assert ended == [BlockEnd("cycle", MetCondition("valid fraction", 0.5, 0.6, rising=False))]


def test_a_step_without_result_ends_nothing() -> None:
    walk = programme(NESTED).walk()
    assert sum(1 for _ in walk) == 14


@pytest.mark.parametrize(
    ("condition", "reading", "quantity"),
    [
        ({"force_above_n": 10}, Reading({"force": 9.9}), None),
        ({"force_above_n": 10}, Reading({"force": 10.0}), "force"),
        ({"force_below_n": -10}, Reading({"force": -9.0}), None),
        ({"force_below_n": -10}, Reading({"force": -11.0}), "force"),
        ({"strain_above_percent": 2}, Reading(strain=0.0201), "strain"),
        ({"strain_below_percent": 2}, Reading(strain=0.0201), None),
        ({"strain_above_percent": 2}, Reading({"force": 3.0}), "strain"),
        ({"valid_fraction_below": 0.5}, Reading(valid_fraction=0.7), None),
        ({"above": {"temperature_grip": 320}}, Reading({"temperature_grip": 319.0}), None),
        ({"above": {"temperature_grip": 320}}, Reading({"temperature_grip": 320.0}), "temperature_grip"),
        ({"below": {"force_upper": -5}}, Reading({"force": -9.0}), "force_upper"),
        ({"force_above_n": 10, "strain_above_percent": 2}, Reading({"force": 11.0}, 0.0), "force"),
        ({"time_above_s": 60}, Reading(duration=59.0), None),
        ({"time_above_s": 60}, Reading(duration=60.0), "time"),
    ],
)
def test_conditions(condition: dict[str, Any], reading: Reading, quantity: str | None) -> None:
    met = Until.model_validate(condition).met(reading)
    assert (None if met is None else met.quantity) == quantity


def test_a_met_condition_has_the_unit_of_its_limit() -> None:
    met = Until(strain_above_percent=2).met(Reading(strain=0.0201))
    assert met == MetCondition("strain", pytest.approx(2.01), 2.0, rising=True, unit="%")


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        ([{"cycle": {"steps": [{"hold_s": 1.0}]}}], r"steps\.0\.cycle\.times: is missing"),
        ([{"cycle": {"times": 2, "steps": [{"hold": 1.0}]}}], r"steps\.0\.hold: unknown key; known are position_mm"),
        ([{"ramp": {"to_mm": 1.0, "steps": 3, "untill": {}}}], r"ramp\.untill: unknown key; known are from_mm"),
        ([{"position_mm": 1.0, "until": {}}], r"until: give one of force_above_n, force_below_n"),
        ([{"until": {"force_above_n": 3.0}}], r"until ends a move; give position_mm"),
        ([{"position_mm": 1.0, "until": {"valid_fraction_below": 0.5}}], r"put it into the until of a ramp or cycle"),
        ([{"ramp": {"to_mm": 1, "steps": 3, "until": {"time_above_s": 9}}}], r"time_above_s ends a move; put it into"),
        ([{"cycle": {"times": 2, "steps": [{}], "until": {"time_above_s": 9}}}], r"time_above_s ends a move"),
        ([{"mode": "none", "set_reference": True}], r"cannot be the reference"),
        (
            [{"cycle": {"times": 60000, "steps": [{}, {}]}}],
            r"the programme has 120000 steps, at most 100000 are allowed",
        ),
        ([], r"steps: List should have at least 1 item"),
    ],
)
def test_a_wrong_key_is_named(steps: list[dict[str, Any]], words: str, tmp_path: Path) -> None:
    file = tmp_path / "programme.yaml"
    file.write_text(yaml.safe_dump({"steps": steps}))
    with pytest.raises(ConfigurationError, match=words):
        load_programme(file)


def rig(**changes: Any) -> RigFile:
    camera = {"source": "aravis", "width": 1000, "height": 800, "exposure_ms": 20.0, "settle_ms": 30.0}
    content = {
        "camera": {**camera, **changes.pop("camera", {})},
        "projector": {"source": "display", "width": 800, "height": 600},
        "sequence": {"pitches_px": [800.0, 80.0, 8.0], "shifts": 4},
        "load_frame": {"source": "machine", "file": "m.yaml", "rate_hz": 1000.0},
        **changes,
    }
    return RigFile.model_validate(content)


def test_forecast_follows_steps_images_holds_and_moves() -> None:
    short = programme("steps: [{position_mm: 0.0}, {position_mm: 1.0, speed_mm_per_s: 0.5}]")
    held = programme("steps: [{position_mm: 0.0, hold_s: 60}, {position_mm: 1.0, speed_mm_per_s: 0.5}]")
    slow = programme("steps: [{position_mm: 0.0}, {position_mm: 1.0, speed_mm_per_s: 0.01}]")
    base = forecast(rig(), short)
    assert (base.steps, base.frames, base.early) == (2, 24, False)
    assert forecast(rig(), held).duration == pytest.approx(base.duration + 60)
    assert forecast(rig(), slow).duration == pytest.approx(base.duration + 98)
    deep = forecast(rig(camera={"pixel_format": "Mono12"}), short)
    assert deep.size == pytest.approx(base.size + 24 * 800_000)
    raw = forecast(rig(recording={"derived": False}), short)
    assert base.size - raw.size == pytest.approx(2 * 800_000 * 143)  # of maps, preview and clouds at every pixel
    later = forecast(rig(recording={"process": False}), short)
    assert later.duration < base.duration  # what is measured at the end is measured in the time for writing
    assert later.duration + later.writing == pytest.approx(base.duration + base.writing)
    assert forecast(rig(), programme("steps: [{mode: white}]")).frames == 1
    rest = forecast(rig(), slow, done=1)
    assert (rest.steps, rest.frames) == (1, 12)
    assert base.duration + 90 < rest.duration < base.duration + 98, "the slow move is left, one step is done"
    assert rest.writing > base.writing, "all steps are measured again at the end"
    assert rest.size > base.size, "the parts of the recording are copied into one"
    nested = forecast(rig(), programme(NESTED))
    assert (nested.steps, nested.frames, nested.early) == (14, 121, True)


def test_forecast_counts_the_free_run_of_the_extensometer() -> None:
    held = programme("steps: [{position_mm: 0.0, hold_s: 600}]")
    pads = {"first_px": [200, 400], "second_px": [800, 400], "rate_hz": 25.0}
    without, free = forecast(rig(), held), forecast(rig(extensometer=pads), held)
    assert without.free_frames == 0
    assert free.duration == without.duration
    assert free.frames == without.frames
    assert 600 * 25 <= free.free_frames < 620 * 25
    assert free.size - without.size == pytest.approx(free.free_frames * 800_000, rel=1e-3)


def test_a_run_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    """100 000 steps of twelve frames of 48 megapixels: some hundred terabytes."""
    endless = programme("steps: [{cycle: {times: 100000, steps: [{hold_s: 1.0}]}}]")
    needed = forecast(rig(camera={"width": 8000, "height": 6000}), endless)
    with pytest.raises(
        RecordingError, match=r"100000 steps need .* GB of disk space, but the disk of .* left, of which 0\.1 GB"
    ):
        needed.check_disk(tmp_path / "not" / "yet" / "there")
    forecast(rig(), programme("steps: [{mode: white}]")).check_disk(tmp_path)


def test_a_continuous_programme_is_a_step_at_rest_and_a_measured_move() -> None:
    test = programme("{continuous: {to_mm: 0.6, speed_mm_per_s: 0.02, every_s: 2, until: {force_above_n: 500}}}")
    rest, pull = test.load_steps()
    assert (rest.position_mm, rest.mode) == (0.0, "fringes")
    assert (pull.position_mm, pull.speed_mm_per_s, pull.mode, pull.every_s) == (0.6, 0.02, "moving", 2.0)
    assert [until.force_above_n for until in test.conditions()] == [500]
    cycled = programme("{steps: [{cycle: {times: 2, steps: [{continuous: {to_mm: 0.1, speed_mm_per_s: 0.02}}]}}]}")
    assert [step.mode for step in cycled.load_steps()] == ["fringes", "moving"] * 2


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("{continuous: {to_mm: 0.0, speed_mm_per_s: 0.02}}", "nothing moves; give another to_mm"),
        ("{continuous: {to_mm: 1.0}}", "speed_mm_per_s"),
        ("{steps: [{mode: moving}]}", "give position_mm"),
        ("{steps: [{position_mm: 1, every_s: 2}]}", "every_s is the time from stack to stack"),
        ("{ramp: {to_mm: 1, steps: 3}, continuous: {to_mm: 1, speed_mm_per_s: 1}}", "steps, ramp or continuous"),
    ],
)
def test_continuous_programmes_that_cannot_be_done(text: str, reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason):
        parse_programme(text)


TINY = {
    "camera": {"source": "virtual"},
    "projector": {"source": "virtual"},
    "virtual_rig": {"preset": "plate", "size": "tiny"},
    "load_frame": {"source": "simulated"},
}


def test_a_move_is_forecast_with_the_stacks_during_it() -> None:
    rig = RigFile.model_validate(TINY)
    slow, fast = (
        forecast(rig, programme(f"{{continuous: {{to_mm: 0.6, speed_mm_per_s: {speed}, every_s: 5}}}}"))
        for speed in (0.01, 0.1)
    )
    assert (slow.measured, fast.measured) == (1 + 13, 1 + 2), "60 s and 6 s, a stack every 5 s"
    assert slow.duration - fast.duration == pytest.approx(54, abs=0.1)
    endless = programme("{continuous: {to_mm: 0.6, speed_mm_per_s: 1.0e-12, every_s: 5}}")
    with pytest.raises(ConfigurationError, match=r"the move to 0.6 mm at 1e-12 mm/s has more than 100000 stacks"):
        forecast(rig, endless)


def test_a_sequence_that_cannot_follow_a_motion_is_refused_before_the_test() -> None:
    rig = RigFile.model_validate({**TINY, "sequence": {"exposures_ms": [5, 20]}})
    pull = programme("{continuous: {to_mm: 0.6, speed_mm_per_s: 0.02}}")
    with pytest.raises(ConfigurationError, match="one exposure time; remove fringe_order and exposures_ms"):
        check_programme(rig, pull)
    with pytest.raises(ConfigurationError, match="add a projector"):
        check_programme(RigFile.model_validate({**TINY, "projector": None}), pull)
    check_programme(RigFile.model_validate(TINY), pull)


CALIBRATED: dict[str, Any] = {
    **TINY,
    "calibration": "virtual_rig",
    "virtual_rig": {"preset": "plate", "size": "tiny", "load_frame": {"maximum_speed_mm_per_s": 50.0}},
}
ACROSS = {"pitches_px": [75.0, 20.0, 5.0], "orientation": "horizontal"}


def test_a_speed_that_the_stacks_cannot_follow_is_refused_before_the_test() -> None:
    def check(speed: float, **sequence: Any) -> None:
        text = f"{{continuous: {{to_mm: 0.6, speed_mm_per_s: {speed}}}}}"
        check_programme(RigFile.model_validate({**CALIBRATED, "sequence": sequence}), programme(text))

    check(18.0)
    with pytest.raises(
        ConfigurationError, match=r"5\.18 px from frame to frame, 60 % of the image during a stack; reduce"
    ):
        check(25.0)
    check(5.0, **ACROSS)
    with pytest.raises(
        ConfigurationError,
        match=r"2\.07 px, 0\.17 fringes, from frame to frame, and the shifts follow 0\.10; reduce speed_mm_per_s to "
        r"5\.5, set sequence\.motion_fringes to \[0, 0\.28\]",
    ):
        check(10.0, **ACROSS)
    check(10.0, **ACROSS, motion_fringes=[-0.28, 0])
    with pytest.raises(ConfigurationError, match=r"no shifts follow a motion of -0\.3 to 0\.3 fringes"):
        check(1.0, motion_fringes=[-0.3, 0.3])


def test_the_shifts_of_a_stack_run_against_the_motion() -> None:
    def shifts(*motion: float) -> list[tuple[int, int]]:
        rig = RigFile.model_validate({**TINY, "sequence": {"motion_fringes": list(motion)}})
        return [(each.shift, each.shifts) for each in rig.moving_patterns()[-9:-1]]

    assert shifts()[:4] == [(3, 4), (2, 4), (1, 4), (4, 4)]
    assert shifts(0, 0.28)[:3] == [(7, 8), (6, 8), (5, 8)]
    assert shifts(-0.28, 0)[:3] == [(1, 8), (2, 8), (3, 8)]
    with pytest.raises(ValidationError, match="a range that contains 0"):
        shifts(0.1, 0.2)
