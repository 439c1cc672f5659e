"""What the page shows of a rig file, of a programme, and of the tests beside it."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from fringedic.configuration.known_rigs import remember_rig
from fringedic.configuration.test_series import Series
from fringedic.errors import ConfigurationError
from operator_node import rig_file
from operator_node.rig_file import ShownRigFile

RIG = """
camera: {source: virtual}
virtual_rig: {preset: plate, size: tiny}
load_frame: {source: simulated}
programme: {ramp: {to_mm: 0.5, steps: 2}}
"""


@pytest.fixture
def file(tmp_path: Path) -> ShownRigFile:
    path = tmp_path / "rig.yaml"
    path.write_text(RIG)
    return ShownRigFile(path)


def test_a_programme_is_shown_and_forecast(file: ShownRigFile) -> None:
    found = file.check("{ramp: {to_mm: 1.0, steps: 3, speed_mm_per_s: 2.0}}")
    assert [row["position_mm"] for row in found["rows"]] == [0.0, 0.5, 1.0]
    assert {row["speed_mm_per_s"] for row in found["rows"]} == {2.0}
    assert (found["count"], found["problem"]) == (3, "")
    assert found["words"].startswith("3 steps, ")


def test_without_a_text_it_is_that_of_the_rig_file(file: ShownRigFile) -> None:
    assert [row["position_mm"] for row in file.check("  ")["rows"]] == [0.0, 0.5]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("ramp: [", "programme: is not YAML: line 1"),
        ("ramp: 3", "programme: ramp: "),
        ("# only a comment", "programme: has no 'key: value'"),
        ("{ramp: {to_mm: '4,98', steps: 2}}", "programme: ramp.to_mm: write 4.98 with a decimal point"),
        (
            "{steps: [{}, {position_mm: 50}]}",
            "step 2 of 2 of experiment moves the crosshead to 50 mm, outside 0 to 1 mm",
        ),
        ("{ramp: {to_mm: 1, steps: 2, speed_mm_per_s: 80}}", "step 1 of 2 of experiment moves at 80 mm/s, faster than"),
        ("{steps: [{cycle: {times: 90000, steps: [{}]}}]}", "the 90000 steps need"),
    ],
)
def test_what_is_wrong_is_told_before_the_start(file: ShownRigFile, text: str, problem: str) -> None:
    found = file.check(text)["problem"]
    assert found.startswith(problem)
    assert "pydantic" not in found


def test_tests_are_those_beside_the_rig_file(
    file: ShownRigFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rig_file, "LOOK_S", 0.0)
    file.shown()
    assert file.tests() == {}
    for name in ("five-1", "five-2", "notes"):
        (tmp_path / "recordings" / name / ("bag" if name != "notes" else "text")).mkdir(parents=True)
    (tmp_path / "recordings" / "five-2" / "report.html").write_text("report")
    found = {name: each.has_report for name, each in file.tests().items()}
    assert found == {"five-1": False, "five-2": True}


def test_a_series_has_the_specimens_in_the_field_of_their_name(file: ShownRigFile, tmp_path: Path) -> None:
    """A form whose field of the specimen's name has another name refused every series."""
    assert file.shown()["specimen_field"] == "specimen"
    form = "test_form: [{name: Probe, entry: name, required: true}, {name: Breite, kind: number}]"
    (tmp_path / "rig.yaml").write_text(RIG + form)
    own = ShownRigFile(tmp_path / "rig.yaml")
    assert own.shown()["specimen_field"] == "Probe"
    own.plan_series(Series(specimens=["A1", "A2"], answers={"Breite": 20.5}))
    assert own.series()["specimens"] == ["A1", "A2"]


def test_rigs_are_those_beside_the_rig_file_and_those_that_were_opened(
    file: ShownRigFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rig_file, "LOOK_S", 0.0)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    for name in ("other.yaml", "rig.before-2026.yaml", "elsewhere/far.yaml", "elsewhere/gone.yaml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(RIG)
        remember_rig(tmp_path / name)
    (tmp_path / "elsewhere" / "gone.yaml").unlink()
    (tmp_path / "no_rig.yaml").write_text("{steps: []}")
    file.shown()
    file.tests()
    found = [each["file"] for each in file.rigs()]
    assert found == ["other.yaml", "rig.yaml", str(tmp_path / "elsewhere" / "far.yaml")]
    assert [each["own"] for each in file.rigs()] == [False, True, False]


def test_a_series_is_kept_until_it_is_replaced(file: ShownRigFile) -> None:
    series = Series(specimens=["a", "b"], answers={"width [mm]": 25.0})
    file.plan_series(series)
    kept = file.series()
    assert 0 <= time.time() - kept["planned"] < 60, "earlier tests of the specimens are none of the series"
    assert kept == series.model_dump() | {"planned": kept["planned"], "problem": ""}
    with pytest.raises(ConfigurationError, match="the form of a test has no field 'colour'"):
        file.plan_series(Series(specimens=["c"], answers={"colour": "red"}))
    assert file.series()["specimens"] == ["a", "b"]


def test_the_content_of_a_text_is_that_of_the_form(file: ShownRigFile) -> None:
    assert file.check("")["programme"] == {"ramp": {"to_mm": 0.5, "steps": 2}}
    assert file.check("{ramp: {to_mm: far}}")["programme"] == {"ramp": {"to_mm": "far"}}, "also of a wrong programme"
    assert file.check("ramp: [")["programme"] is None
