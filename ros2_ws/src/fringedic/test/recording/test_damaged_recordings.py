"""Damage of a recording is reported, costs no more than the chunk that it is in, and is never a traceback."""

import random
import struct

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader

from fringedic.errors import RecordingError
from fringedic.recording import BagReader, BagWriter, Topic, recover
from fringedic.recording.mcap_file import check_chunks, read_index

IMAGE, FORCE, STEP = "/rig/camera/image_raw", "/rig/load_frame/state", "/rig/experiment/step"
FLIPS = 100  # the long form is benchmarks/damaged_recordings.py


def write_bag(path, compression="none"):
    """Sixty samples of force, ten images and three steps in four chunks of equal time."""
    rng = np.random.default_rng(0)
    with BagWriter(path, compression=compression, flush_interval_s=1e9) as writer:
        for name in (IMAGE, FORCE, STEP):
            writer.add_recorded_topic(Topic(name, "bench_msgs/msg/Data", "uint8[] data", "ros2msg", "hash", "[]"))
        for number in range(60):
            when = 10**18 + number * 10**7
            if number % 6 == 0:
                writer.write(IMAGE, rng.integers(0, 9, 300, np.uint8).tobytes(), when, when, number // 6)
            writer.write(FORCE, bytes([number, 0, 0, 7]), when, when, number)
            if number % 20 == 0:
                writer.write(STEP, b"begin", when, when)
            if number % 15 == 14:
                writer.flush()
    return path


class Recording:
    """A recording whose bytes are changed, and what it held before."""

    def __init__(self, bag):
        self.bag, self.file = bag, bag / "bag_0.mcap"
        self.data = bytearray(self.file.read_bytes())
        with self.file.open("rb") as stream:
            self.chunks = [each.chunk_start_offset for each in make_reader(stream).get_summary().chunk_indexes]
        self.index = struct.unpack("<Q", self.data[-28:-20])[0]
        reader = BagReader(bag)
        self.messages, self.topics = list(reader.raw()), reader.topics

    def put(self, place, new):
        self.data[place : place + len(new)] = new
        self.file.write_bytes(self.data)

    def without_index(self):
        """Leave the file as a recorder leaves it that is killed."""
        del self.data[self.index :]
        self.file.write_bytes(self.data)

    def read(self, *, check=False):
        """Return whether damage is reported, and whether everything is there."""
        try:
            reader = BagReader(self.bag, check=check)
            messages = list(reader.raw())
        except RecordingError:
            return True, False
        return bool(reader.lost), messages == self.messages and reader.topics == self.topics


@pytest.fixture(params=["none", "zstd"])
def recording(request, tmp_path):
    return Recording(write_bag(tmp_path / "bag", request.param))


@pytest.mark.parametrize(
    ("before", "new"),
    [(0, b"/rig/camera/imagd_raw"), (-8, b"\x03"), (-4, b"\x00")],
    ids=["topic name", "channel number", "number of the definition"],
)
def test_damaged_index_is_rebuilt_and_nothing_is_lost(recording, before, new):
    place = recording.data.index(IMAGE.encode(), recording.index)
    recording.put(place + before, new)
    reader = BagReader(recording.bag)
    assert reader.lost == "bag_0.mcap: its index is damaged and was rebuilt from the chunks"
    assert recording.read() == (True, True)


def test_damaged_definition_in_the_index_is_replaced_by_that_in_the_chunks(recording):
    recording.put(recording.data.index(b"uint8[] data", recording.index), b"uint9")
    assert recording.read() == (True, True)


@pytest.mark.parametrize("offset", [0, 1, 5], ids=["opcode", "length", "huge length"])
@pytest.mark.parametrize("number", [0, 1, 3])
def test_damaged_header_of_a_chunk_is_reported_and_costs_nothing(recording, offset, number):
    recording.without_index()
    recording.put(recording.chunks[number] + offset, b"\x87")
    reader = BagReader(recording.bag)
    assert "9 bytes outside of chunks are damaged" in reader.lost
    assert list(reader.raw()) == recording.messages


def test_scan_continues_at_the_next_chunk(recording):
    """Erased bytes in the middle of a file without an index cost the chunks that they are in."""
    recording.without_index()
    begin, end = recording.chunks[1] - 5, recording.chunks[2] + 20
    recording.put(begin, bytes(end - begin))
    reader = BagReader(recording.bag)
    assert "bytes outside of chunks are damaged" in reader.lost
    assert [message.sequence for message in reader.raw([FORCE])] == [*range(15), *range(45, 60)]


def test_damaged_chunk_is_named_when_it_is_reached(recording):
    recording.put(recording.chunks[2] + 80, b"\xff\xff")
    reader = BagReader(recording.bag)
    with pytest.raises(RecordingError, match=r"bag_0\.mcap: damaged at byte \d+ .*use 'fringedic recover'") as caught:
        list(reader.raw())
    assert len(str(caught.value)) <= 500


def test_erased_header_of_a_chunk_is_not_an_empty_chunk(recording):
    """Zeros are the header of a chunk without content and without checksum."""
    begin = recording.chunks[2]
    recording.put(begin, bytes(49))
    with pytest.raises(RecordingError, match="its messages are not those of its header"):
        list(BagReader(recording.bag).raw())
    assert BagReader(recording.bag, check=True).missing[FORCE] == 15


def test_erased_checksum_costs_nothing(recording):
    recording.put(recording.chunks[2] + 33, bytes(4))
    assert recording.read() == (False, True)


def test_erased_end_does_not_rename_topics(recording):
    """The definitions in the index have no checksum of their own."""
    begin = recording.data.index(IMAGE.encode(), recording.index)
    recording.put(begin, bytes(len(recording.data) - begin))
    reader = BagReader(recording.bag)
    assert "bag_0.mcap: not closed" in reader.lost
    assert recording.read() == (True, True)


def test_topic_whose_definition_is_lost_costs_no_other_topic(tmp_path):
    """The definition of a topic is in the chunk before its first message."""
    with BagWriter(tmp_path / "bag", compression="none", flush_interval_s=1e9) as writer:
        for name in (FORCE, IMAGE):
            writer.add_recorded_topic(Topic(name, "bench_msgs/msg/Data", "uint8[] data", "ros2msg", "hash", "[]"))
            for number in range(10):
                for known in (FORCE, name):
                    writer.write(known, b"data", number, number)
                if number % 4 == 0:
                    writer.flush()
    recording = Recording(tmp_path / "bag")
    recording.without_index()
    (tmp_path / "bag" / "metadata.yaml").unlink()
    begin = recording.data.index(IMAGE.encode())
    recording.put(begin, b"?")
    reader = BagReader(tmp_path / "bag")
    assert "messages left out because the definition of their topic is lost" in reader.lost
    assert {message.topic for message in reader.raw()} == {FORCE}
    assert len(list(reader.raw())) == sum(reader.counts.values()) > 20


def test_recover_lists_the_messages_that_it_could_not_write(recording):
    recording.put(recording.chunks[2] + 80, b"\xff\xff")
    done = recover(recording.bag)
    assert "1 chunk left out because of a wrong checksum" in done.damage
    saved = BagReader(done.path)
    assert done.messages == sum(saved.counts.values()) < len(recording.messages)
    assert sum(done.missing.values()) == len(recording.messages) - done.messages
    assert done.missing == {name: BagReader(recording.bag).counts[name] - saved.counts[name] for name in done.missing}
    assert [message.sequence for message in saved.raw([FORCE])][:3] == [0, 1, 2]


def test_missing_messages_are_known_from_the_metadata_if_the_index_is_damaged(recording):
    recording.put(recording.index + 20, b"\xff")
    recording.put(recording.chunks[2] + 80, b"\xff\xff")
    reader = BagReader(recording.bag)
    assert sum(reader.missing.values()) == len(recording.messages) - len(list(reader.raw())) > 0
    assert f"missing messages: {reader.missing[IMAGE]} of {IMAGE}" in reader.lost


def test_missing_file_is_reported(recording):
    path = recording.bag / "metadata.yaml"
    content = yaml.safe_load(path.read_text())
    content["rosbag2_bagfile_information"]["relative_file_paths"].append("bag_1.mcap")
    path.write_text(yaml.safe_dump(content))
    assert BagReader(recording.bag).lost == "bag_1.mcap is missing"
    assert recording.read() == (True, True)


INFINITE = b"""rosbag2_bagfile_information:
  relative_file_paths: [bag_0.mcap]
  topics_with_message_count: [{topic_metadata: {name: /force}, message_count: .inf}]
"""


@pytest.mark.parametrize(
    "content",
    [b"rosbag2_bagfile_information: [", b"\xff\xfe", b"a: 2026-02-30", b"42", INFINITE, b"[" * 40_000, b"- " * 40_000],
    ids=["open", "no text", "no date", "number", "infinite", "nested", "nested in blocks"],
)
def test_damaged_metadata_is_reported_and_costs_nothing(recording, content):
    (recording.bag / "metadata.yaml").write_bytes(content)
    assert BagReader(recording.bag).lost == "metadata.yaml is damaged"
    assert recording.read() == (True, True)


def test_file_that_a_power_failure_left_empty_is_reported(recording):
    (recording.bag / "bag_1.mcap").write_bytes(b"")
    assert "bag_1.mcap: not closed" in BagReader(recording.bag).lost
    assert recording.read() == (True, True)


@pytest.mark.parametrize("erased", [1, 8, 40])
def test_damaged_beginning_of_an_unclosed_file_costs_no_other_file(recording, erased):
    """A power cut leaves a sector of zeros."""
    (recording.bag / "bag_1.mcap").write_bytes(recording.data)
    recording.without_index()
    recording.put(0, bytes(erased))
    reader = BagReader(recording.bag, check=True)
    assert "bag_0.mcap: its first bytes are damaged" in reader.damage
    assert reader.counts[FORCE] == 120


def test_file_of_another_format_costs_nothing_and_is_named(recording):
    (recording.bag / "bag_1.mcap").write_bytes(bytes(range(256)) * 9)
    (recording.bag / "._bag_0.mcap").write_bytes(b"attributes that macOS stores beside a file")
    reader = BagReader(recording.bag)
    assert reader.damage == "bag_1.mcap: is not an MCAP file"
    assert list(reader.raw()) == recording.messages
    with pytest.raises(RecordingError, match=r"bag_1\.mcap: is not an MCAP file"):
        BagReader(recording.bag / "bag_1.mcap")


def test_file_that_gets_shorter_while_its_chunks_are_checked(recording):
    indexed = read_index(recording.file)
    recording.file.write_bytes(recording.data[: recording.chunks[2] + 9])
    checked = check_chunks(indexed)
    assert checked.damage == ["2 chunks left out because of a wrong checksum"]
    assert len(checked.chunks) == 2


@pytest.mark.parametrize("check", [False, True])
def test_every_flipped_bit_is_reported_or_harmless(recording, check):
    rng = random.Random(1)
    whole = bytes(recording.data)
    outcomes = []
    for _ in range(FLIPS):
        recording.data[:] = whole
        place = rng.randrange(len(whole))
        recording.put(place, bytes([whole[place] ^ 1 << rng.randrange(8)]))
        outcomes.append(recording.read(check=check))
    assert (False, False) not in outcomes
    assert {(True, False), (True, True), (False, True)} == set(outcomes)


@pytest.mark.parametrize("check", [False, True])
def test_larger_damage_gives_no_wrong_message(recording, check):
    rng = random.Random(3)
    whole = bytes(recording.data)
    for number in range(FLIPS):
        size = rng.choice((1, 8, 100, 3000))
        begin, other = (rng.randrange(len(whole) - size) for _ in range(2))
        new = (bytes(size), rng.randbytes(size), rng.randbytes(2 * size), b"", whole[other : other + size])[number % 5]
        recording.data[:] = whole[:begin] + new + whole[begin + size :]
        recording.file.write_bytes(recording.data)
        reported, complete = recording.read(check=check)
        assert reported or complete
        if check and recording.data[:8] == whole[:8]:
            assert set(BagReader(recording.bag, check=True).raw()) <= set(recording.messages)


def test_flipped_bit_in_a_file_without_index_costs_one_chunk(recording):
    recording.without_index()
    rng = random.Random(2)
    whole = bytes(recording.data)
    largest = 15 + 3 + 1  # messages of a chunk: force, images, a step
    for _ in range(FLIPS):
        place = rng.randrange(recording.chunks[1], len(whole))
        recording.data[:] = whole
        recording.put(place, bytes([whole[place] ^ 1 << rng.randrange(8)]))
        reader = BagReader(recording.bag)
        assert "not closed" in reader.lost
        assert len(recording.messages) - len(list(reader.raw())) <= largest
