"""Reading of recordings that are being made."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from fringedic.datasets.processing import PROCESSED_TOPICS
from fringedic.errors import RecordingError
from fringedic.recording import BagReader, BagWriter, Split
from fringedic.recording.growing import FollowError, GrowingRecording

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"


TOPICS = [name for name in PROCESSED_TOPICS if name != "load_frame/state"]


def test_messages_and_their_order_are_those_of_the_complete_recording() -> None:
    reader = BagReader(RECORDED)
    relative = {full: name for name, full in reader.find_optional(*TOPICS).items()}
    expected = [(relative[raw.topic], reader.decode(raw.topic, raw.data)) for raw in reader.published(relative)]
    found = list(GrowingRecording(RECORDED).published(TOPICS))
    assert [name for name, _ in found] == [name for name, _ in expected]
    images = [
        (one.data, other.data) for (name, one), (_, other) in zip(found, expected, strict=True) if "image" in name
    ]
    assert len(images) == 36
    assert all(np.array_equal(*pair) for pair in images)


def test_an_order_that_is_not_the_final_one_is_noticed() -> None:
    """Samples of the load frame are recorded after the end of a step before which they were published."""
    with pytest.raises(FollowError, match="not in the order of their times"):
        list(GrowingRecording(RECORDED).published(PROCESSED_TOPICS))


def test_a_recording_is_complete_when_all_messages_are_counted(tmp_path: Path) -> None:
    reader, between = BagReader(RECORDED), tmp_path / "between"
    with BagWriter(tmp_path / "bag", split=Split(size=200_000)) as writer:
        growing = GrowingRecording(writer.path)
        for topic in reader.topics.values():
            writer.add_recorded_topic(topic)
        for message in reader.stored():
            before = (writer.path / "metadata.yaml").read_bytes()
            writer.write(*message)
            if (writer.path / "bag_2.mcap").exists() and not between.exists():
                shutil.copytree(writer.path, between)  # the second file is closed, the third one not begun
                (between / "bag_2.mcap").unlink()
                (between / "metadata.yaml").write_bytes(before)
        assert not growing.is_complete()
    assert growing.is_complete()
    growing.wait()
    assert BagReader(between).lost == ""
    assert not GrowingRecording(between).is_complete()


def test_files_of_another_kind_are_refused(tmp_path: Path) -> None:
    (tmp_path / "other.mcap").write_bytes(b"something else")
    with pytest.raises(RecordingError, match=r"other.mcap: is not an MCAP file"):
        GrowingRecording(tmp_path).first("camera/exposure")


def test_a_damaged_chunk_is_not_passed_over(tmp_path: Path) -> None:
    shutil.copytree(RECORDED, tmp_path / "bag")
    file = tmp_path / "bag" / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 8] = bytes(8)
    file.write_bytes(data)
    with pytest.raises(FollowError, match=r"bag_0.mcap: damaged at byte \d+"):
        list(GrowingRecording(tmp_path / "bag").published(TOPICS))


def test_a_recorder_that_ended_is_named_by_everything_that_waits(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        growing = GrowingRecording(writer.path, patience_s=0.0)
        for wait in (growing.wait, growing.wait_for_writer):
            with pytest.raises(RecordingError, match=r"its recorder has ended without closing it .*fringedic recover"):
                wait()
