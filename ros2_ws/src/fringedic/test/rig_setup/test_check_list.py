"""Check list of the set-up: order, results, and what makes them out of date."""

from __future__ import annotations

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from fringedic.errors import RigSetupError
from fringedic.rig_setup.check_list import CheckList, ItemState, SetupItem, SetupRecord
from fringedic.rig_setup.live_sentences import TITLES, next_sentence

START = datetime(2026, 5, 4, 8, 0, tzinfo=UTC)


def done(*items: SetupItem) -> CheckList:
    """Return a list on which items were done one minute after the other."""
    found = CheckList()
    for minute, item in enumerate(items):
        found = found.with_record(item, SetupRecord(when=START + timedelta(minutes=minute), words=(item.value,)))
    return found


def states(found: CheckList) -> dict[SetupItem, ItemState]:
    return {each.item: each.state for each in found.items()}


def test_items_are_in_the_order_of_the_page() -> None:
    assert [each.item for each in CheckList().items()] == list(SetupItem) == list(TITLES)
    assert set(states(CheckList()).values()) == {ItemState.NOT_DONE}
    assert len({next_sentence(each) for each in CheckList().items()}) == len(SetupItem)


def test_in_order_everything_stays_done() -> None:
    assert set(states(done(*SetupItem)).values()) == {ItemState.DONE}


def test_a_lens_that_is_turned_makes_what_depends_on_it_out_of_date() -> None:
    found = done(*SetupItem, SetupItem.CAMERA_FOCUS)
    outdated = {item for item, state in states(found).items() if state is ItemState.OUT_OF_DATE}
    assert outdated == {
        SetupItem.RESPONSE,
        SetupItem.CALIBRATE,
        SetupItem.REGION,
        SetupItem.NOISE,
        SetupItem.ADVISE,
    }
    [calibrate] = [each for each in found.items() if each.item is SetupItem.CALIBRATE]
    assert next_sentence(calibrate) == "Repeat it, because focus and exposure of the camera was done later."


def test_a_check_that_was_not_passed_is_not_done() -> None:
    failed = SetupRecord(when=START + timedelta(hours=1), words=("The rig does not hold its calibration.",), good=False)
    found = done(SetupItem.CALIBRATE, SetupItem.CHECK).with_record(SetupItem.CHECK, failed)
    [check] = [each for each in found.items() if each.item is SetupItem.CHECK]
    assert check.state is ItemState.FAILED
    assert "repeat it" in next_sentence(check)


def test_saved_list_is_read_again(tmp_path: Path) -> None:
    found = done(SetupItem.TIMING, SetupItem.NOISE)
    found.save(tmp_path / "setup.yaml")
    assert CheckList.load(tmp_path / "setup.yaml") == found
    assert [path.name for path in tmp_path.iterdir()] == ["setup.yaml"]
    assert CheckList.load(tmp_path / "none.yaml") == CheckList()


@pytest.mark.parametrize("text", ["[1, 2]", "nonsense: {when: 2026-01-01}", "timing: {when: soon}", "a: [", "\xff"])
def test_a_file_that_is_no_list_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "setup.yaml").write_text(text, "latin-1")
    with pytest.raises(RigSetupError, match=r"setup.yaml: is no check list of the set-up: correct or remove it"):
        CheckList.load(tmp_path / "setup.yaml")


def test_a_result_is_done_when_the_rig_file_uses_it() -> None:
    settings = "calibration: calibration-2/rig_calibration.yaml"
    found = CheckList().with_record(SetupItem.CALIBRATE, SetupRecord(when=START, settings=settings))
    old, new = ({"calibration": f"calibration{name}/rig_calibration.yaml"} for name in ("", "-2"))
    for rig_file, state, words in (
        (old, ItemState.NOT_IN_USE, "still has calibration: calibration/rig_calibration.yaml"),
        ({}, ItemState.NOT_IN_USE, "still has calibration: nothing"),
        (new, ItemState.DONE, "In the rig file: calibration: calibration-2/rig_calibration.yaml"),
    ):
        item = {each.item: each for each in found.items(rig_file)}[SetupItem.CALIBRATE]
        assert item.state is state
        assert words in next_sentence(item)


def test_settings_in_sections_are_compared_one_by_one() -> None:
    record = SetupRecord(when=START, settings="nodes: {dic: {window: 24, spacing: 8}}")
    found = CheckList().with_record(SetupItem.ADVISE, record)

    def state(**dic: int) -> ItemState:
        items = found.items({"camera": {"source": "virtual"}, "nodes": {"dic": dic}})
        return {each.item: each.state for each in items}[SetupItem.ADVISE]

    assert state(window=24, spacing=8, threads=2) is ItemState.DONE
    assert state(window=24, spacing=4) is ItemState.NOT_IN_USE


def test_a_check_is_about_the_calibration_that_it_checked() -> None:
    """A new calibration that is not used leaves it valid; one that is used, also an older one, does not."""
    found = CheckList().with_record(SetupItem.CHECK, SetupRecord(when=START, measured_with="calibration: a.yaml"))
    later = SetupRecord(when=START + timedelta(hours=1), settings="calibration: b.yaml")
    found = found.with_record(SetupItem.CALIBRATE, later)
    for file, state in (("a.yaml", ItemState.DONE), ("b.yaml", ItemState.OUT_OF_DATE)):
        item = {each.item: each for each in found.items({"calibration": file})}[SetupItem.CHECK]
        assert item.state is state
    assert next_sentence(item) == "Repeat it, because the rig file now has calibration: b.yaml."


def test_a_file_in_use_is_shown_with_its_date(tmp_path: Path) -> None:
    (tmp_path / "old.yaml").write_text("")
    os.utime(tmp_path / "old.yaml", (START.timestamp(),) * 2)
    found = CheckList().with_record(SetupItem.NOISE, SetupRecord(when=START, settings="noise_floor_file: new.yaml"))
    item = {each.item: each for each in found.items({"noise_floor_file": "old.yaml"}, tmp_path)}[SetupItem.NOISE]
    local = f"{START.astimezone():%Y-%m-%d %H:%M}"
    assert item.present == (f"noise_floor_file: old.yaml of {local}",)
