"""The parts that several recorders wrote become one recording, whatever their state."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from fringedic.datasets import open_experiment, process_bag
from fringedic.recording.order import is_latched
from fringedic.recording.reader import BagReader
from fringedic.recording.repair import info, recover
from fringedic.recording.sentences import content_sentences, next_command
from fringedic.recording.topics import RawMessage
from fringedic.recording.verification import verify
from fringedic.recording.writer import Split
from fringedic_bringup.procedures import recording_parts
from fringedic_bringup.procedures.recording_parts import join_parts, next_part

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


def messages(bag: Path, *, latched: bool = False) -> list[RawMessage]:
    """Messages in the order of the files; each file begins with copies of those that are latched."""
    reader = BagReader(bag)
    return [message for message in reader.stored() if is_latched(reader.topics[message.topic]) == latched]


def test_all_messages_of_all_parts_are_in_the_recording(bag: Path) -> None:
    progress = Progress()
    join_parts(bag, progress, Split(size=300_000))
    assert messages(bag) == 2 * messages(RECORDED)
    assert {each.data for each in messages(bag, latched=True)} == {
        each.data for each in messages(RECORDED, latched=True)
    }
    files = BagReader(bag).files
    assert len(files) >= 3
    assert files[0].name == "bag_0.mcap"
    [joining, note] = progress.lines
    assert joining == "joining 3 parts of the recording"
    assert "bag: bag_0.mcap: not closed" in note
    assert "bag-3: holds no .mcap file" in note
    assert sorted(path.name for path in bag.parent.iterdir()) == ["bag", "bag-old", "parts"]
    assert sorted(path.name for path in (bag.parent / "parts").iterdir()) == ["bag-1", "bag-2", "bag-3"]


def test_a_later_run_joins_only_what_is_not_in_the_recording(bag: Path) -> None:
    join_parts(bag, Progress(), Split())
    assert next_part(bag).name == "bag-2"
    recover(RECORDED, next_part(bag))
    recover(RECORDED, bag.with_name("joining") / "bag")  # a command was killed while it joined
    join_parts(bag, Progress(), Split())
    assert messages(bag) == 3 * messages(RECORDED)
    kept = bag.with_name("parts")
    assert messages(kept / "bag-4") == 2 * messages(RECORDED)
    assert messages(kept / "bag-5") == messages(RECORDED)
    assert sorted(path.name for path in bag.parent.iterdir()) == ["bag", "bag-old", "parts"]


def test_parts_that_were_not_joined_are_stated_and_recovered(bag: Path) -> None:
    """The recording of a run whose command was killed: its later steps were missing without a word."""
    [_, lost] = content_sentences(content := info(bag))
    assert lost.endswith("bag-2 beside it, later parts of the same run, are not read")
    assert next_command(content) == f"next: `fringedic recover {bag}` writes one recording of all parts"
    assert "bag-2 beside it" in verify(bag).damage
    with open_experiment(process_bag(bag)) as dataset:
        assert "bag-2 beside it" in dataset.damage
        assert json.loads(dataset.missing_parts) == ["bag-2"]
    with open_experiment(bag) as dataset:
        assert "bag-2" in dataset.missing_parts, "the dataset says itself what it lacks"
    recovered = recover(bag)
    assert messages(Path(recovered.path)) == 2 * messages(RECORDED)
    assert "not closed" in recovered.damage
    assert not info(recovered.path).parts


def test_the_next_part_is_the_last_one_although_one_was_deleted(tmp_path: Path) -> None:
    for name in ("bag", "bag-3"):
        (tmp_path / name).mkdir()
    assert next_part(tmp_path / "bag").name == "bag-4"


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
    monkeypatch.setattr(recording_parts, "join", interrupted)
    with pytest.raises(KeyboardInterrupt):
        join_parts(bag, Progress(), Split())
    assert files() == before
