"""The files of a split recording are measured as one; two measurements in one recording are not."""

from pathlib import Path

import pytest

from fringedic.datasets import open_experiment, process_bag
from fringedic.datasets.timeline import Timeline
from fringedic.errors import DatasetError
from fringedic.recording import BagReader, BagWriter, Split
from fringedic.recording.frames import frames

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
        assert found.attrs.pop("source_bytes") != whole.attrs.pop("source_bytes")
        assert found.load().identical(whole.load())


@pytest.mark.parametrize("seconds", [0, 60])
def test_two_measurements_under_one_number_are_refused(tmp_path, seconds):
    """A copy of a record has the same stamp and is no second measurement."""
    reader = BagReader(RECORDED)
    with BagWriter(tmp_path / "bag") as writer:
        for topic in reader.topics.values():
            writer.add_recorded_topic(topic)
        for message in reader.stored():
            writer.write(*message)
        for topic, data, log_time, publish_time, _ in reader.stored():
            if topic.endswith(("image_raw", "exposure")):
                second = int.from_bytes(data[4:8], "little") + seconds  # of the stamp, after the CDR header
                data = data[:4] + second.to_bytes(4, "little") + data[8:]
                writer.write(topic, data, log_time + seconds * 10**9, publish_time + seconds * 10**9)
    reader = BagReader(tmp_path / "bag")
    if not seconds:
        assert Timeline(reader, reader.find("camera/exposure"), None).steps == [0, 1, 2]
        return
    with pytest.raises(DatasetError, match="step 0 of experiment 'tiny' was measured more than once under this number"):
        process_bag(tmp_path / "bag", output=tmp_path / "new.nc")
    with pytest.raises(DatasetError, match="step 0 of experiment 'tiny' was measured more than once"):
        process_bag(tmp_path / "bag", output=tmp_path / "new.nc", steps={1})  # whose reference is step 0
    assert not (tmp_path / "new.nc").exists()
