"""The parts that several recorders wrote become one recording, whatever their state."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from fringedic.recording.reader import BagReader
from fringedic.recording.repair import recover
from fringedic.recording.topics import RawMessage
from fringedic.recording.writer import Split
from fringedic_bringup.procedures import run
from fringedic_bringup.procedures.run import join_parts

RECORDED = Path(__file__).parents[2] / "fringedic" / "test" / "recordings" / "version_0_1" / "bag"


class Progress:
    """Keeps what a procedure reports."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def stage(self, text: str) -> None:
        self.lines.append(text)

    def step(self, *_: object, **__: object) -> None:
        raise AssertionError("no step is measured")

    def part(self, *_: object, **__: object) -> None:
        raise AssertionError("nothing is measured")

    def note(self, text: str) -> None:
        self.lines.append(text)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Three parts, of which the first was not closed and the third is empty, beside a folder of another name."""
    first = recover(RECORDED, tmp_path / "bag").path / "bag_0.mcap"
    os.truncate(first, first.stat().st_size - 100)
    recover(RECORDED, tmp_path / "bag-2")
    (tmp_path / "bag-3").mkdir()
    (tmp_path / "bag-old").mkdir()
    return tmp_path / "bag"


def messages(bag: Path) -> list[RawMessage]:
    return list(BagReader(bag).stored())


def test_all_messages_of_all_parts_are_in_the_recording(bag: Path) -> None:
    progress = Progress()
    join_parts(bag, progress, Split(size=300_000))
    assert messages(bag) == 2 * messages(RECORDED)
    assert len(BagReader(bag).files) >= 3
    [joining, note] = progress.lines
    assert joining == "joining 3 parts of the recording"
    assert "bag-1: bag_0.mcap: not closed" in note
    assert "bag-3: holds no .mcap file" in note


def test_one_part_stays_as_it_is(tmp_path: Path) -> None:
    recover(RECORDED, tmp_path / "bag")
    before = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "bag").iterdir()}
    progress = Progress()
    join_parts(tmp_path / "bag", progress, Split())
    assert {path.name: path.stat().st_mtime_ns for path in (tmp_path / "bag").iterdir()} == before
    assert not progress.lines


def test_an_interrupted_join_leaves_the_parts_as_they_were(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_: object, target: Path, **__: object) -> None:
        recover(RECORDED, target)
        raise KeyboardInterrupt

    def files() -> dict[Path, int]:
        return {path: path.stat().st_size for path in bag.parent.rglob("*")}

    before = files()
    monkeypatch.setattr(run, "join", interrupted)
    with pytest.raises(KeyboardInterrupt):
        join_parts(bag, Progress(), Split())
    assert files() == before
