"""The files of a split recording are measured as one."""

from pathlib import Path

import pytest

from fringedic.recording import BagReader, BagWriter, Split
from fringedic.recording.frames import frames
from fringedic.results import open_experiment, process_bag

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"


@pytest.fixture
def split(tmp_path):
    reader = BagReader(RECORDED)
    with BagWriter(tmp_path / "bag", split=Split(size=150_000)) as writer:
        for topic in reader.topics.values():
            writer.add_recorded_topic(topic)
        for message in reader.stored():
            writer.write(*message)
    assert len(BagReader(tmp_path / "bag").files) >= 4
    return tmp_path / "bag"


def test_frames_are_paired_across_files(split):
    found, whole = list(frames(BagReader(split))), list(frames(BagReader(RECORDED)))
    assert [frame.record for frame in found] == [frame.record for frame in whole]
    assert [frame.image.tobytes() for frame in found] == [frame.image.tobytes() for frame in whole]


def test_datasets_are_identical(split, tmp_path):
    one = process_bag(split, output=tmp_path / "split.nc")
    other = process_bag(RECORDED, output=tmp_path / "whole.nc")
    with open_experiment(one) as found, open_experiment(other) as whole:
        assert found.load().identical(whole.load())
