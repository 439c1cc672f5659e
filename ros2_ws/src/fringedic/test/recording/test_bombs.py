"""Small files that state much more than they contain, and files that get shorter, cost a sentence."""

import os
import struct
import tracemalloc
from contextlib import contextmanager

import lz4.frame
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, ChunkIndex, Footer, Schema, Statistics
from mcap.writer import CompressionType, Writer

from fringedic.errors import RecordingError
from fringedic.recording import BagReader, BagWriter, Topic
from fringedic.recording.bag_files import open_file
from fringedic.recording.decoding import decode
from fringedic.recording.mcap_file import MAGIC, opened
from fringedic.recording.mcap_scan import scan_file

SCHEMA = Schema(id=1, name="x/msg/Y", encoding="ros2msg", data=b"uint8 a")
CHANNEL = Channel(id=1, topic="/t", message_encoding="cdr", metadata={}, schema_id=1)
LIMIT = 100_000_000  # [byte] of memory


@contextmanager
def little_memory():
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < LIMIT
    finally:
        tracemalloc.stop()


def records(*contents):
    builder = RecordBuilder()
    for record in contents:
        record.write(builder)
    return builder.end()


def compressed_zeros(compression, size):
    if compression == "zstd":
        compressor = zstandard.ZstdCompressor().compressobj(size=size)
        parts = [compressor.compress(bytes(1 << 20)) for _ in range(size >> 20)]
        return b"".join([*parts, compressor.flush()])
    frame = lz4.frame.LZ4FrameCompressor()
    parts = [frame.begin(), *(frame.compress(bytes(1 << 20)) for _ in range(size >> 20))]
    return b"".join([*parts, frame.flush()])


def bomb(compression, stated, size=1 << 30):
    return Chunk(
        compression=compression,
        data=compressed_zeros(compression, size),
        message_start_time=0,
        message_end_time=0,
        uncompressed_crc=1,
        uncompressed_size=stated,
    )


@pytest.mark.parametrize(("compression", "stated"), [("zstd", 1 << 30), ("lz4", 1 << 30), ("lz4", 1000)])
@pytest.mark.parametrize("indexed", [True, False])
def test_chunk_that_states_a_gigabyte(tmp_path, compression, stated, indexed):
    definitions = records(SCHEMA, CHANNEL)
    chunk = records(bomb(compression, stated))
    place = len(MAGIC) + len(definitions)
    index = ChunkIndex(len(chunk), place, compression, len(chunk), 0, 0, {1: 0}, 0, stated)
    counts = Statistics(0, 1, {1: 9}, 1, 9, 0, 0, 0, 1)
    summary = records(SCHEMA, CHANNEL, index, counts)
    end = records(Footer(summary_start=place + len(chunk), summary_offset_start=0, summary_crc=0))
    file = tmp_path / "bomb.mcap"
    file.write_bytes(MAGIC + definitions + chunk + (summary + end + MAGIC if indexed else b""))
    assert file.stat().st_size < 5_000_000
    with little_memory():
        assert "1 chunk left out because of a " in BagReader(file, check=True).damage
        if indexed:
            with pytest.raises(RecordingError, match=r"damaged at byte \d+"):
                list(BagReader(file).raw())


def test_chunk_instead_of_the_index(tmp_path):
    chunk = records(bomb("zstd", 1 << 30))
    end = records(Footer(summary_start=len(MAGIC), summary_offset_start=0, summary_crc=0))
    file = tmp_path / "bomb.mcap"
    file.write_bytes(MAGIC + chunk + end + MAGIC)
    with little_memory():
        assert "1 chunk left out because of a size above 512 MB" in open_file(file, check=False).damage


def write_small(path, messages, **options):
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD, chunk_size=1 << 30, **options)
        writer.start()
        channel = writer.register_channel("/t", "cdr", writer.register_schema("x/msg/Y", "ros2msg", b"uint8[] data"))
        for _ in range(messages):
            writer.add_message(channel, 0, b"", 0, 0)
        writer.finish()
    return path


def test_chunk_of_millions_of_empty_messages(tmp_path, monkeypatch):
    monkeypatch.setattr("fringedic.recording.mcap_file._MOST_RECORDS", 1000)
    assert sum(BagReader(write_small(tmp_path / "few.mcap", 900), check=True).counts.values()) == 900
    reader = BagReader(write_small(tmp_path / "many.mcap", 1100), check=True)
    assert "1 chunk left out because of more than 1000 records" in reader.damage


def test_index_that_lists_a_chunk_many_times_is_not_believed(tmp_path):
    file = write_small(tmp_path / "a.mcap", 10)
    data = file.read_bytes()
    start = struct.unpack("<Q", data[-28:-20])[0]
    at = data.index(b"\x08", start)
    while struct.unpack("<Q", data[at + 1 : at + 9])[0] > 200:
        at = data.index(b"\x08", at + 1)
    entry = data[at : at + 9 + struct.unpack("<Q", data[at + 1 : at + 9])[0]]
    changed = bytearray(data[:at] + 1000 * entry + data[at + len(entry) :])
    changed[-12:-8] = bytes(4)  # no checksum of the index
    file.write_bytes(changed)
    reader = BagReader(file)
    assert "its index is damaged" in reader.damage
    assert len(list(reader.raw())) == 10


def test_messages_of_the_same_time_in_many_chunks(tmp_path, monkeypatch):
    with BagWriter(tmp_path / "bag", flush_interval_s=1e9) as writer:
        writer.add_recorded_topic(Topic("/t", "x/msg/Y", "uint8[] data", "ros2msg", "", ""))
        for _ in range(20):
            for time in (0, 10**9):
                writer.write("/t", bytes(100_000), time, time)
            writer.flush()
    reader = BagReader(tmp_path / "bag")
    assert len(list(reader.raw())) == 40
    monkeypatch.setattr("fringedic.recording.reader._LARGEST_OVERLAP", 1 << 20)
    with pytest.raises(RecordingError, match="more than 1 MB would be in memory; write it in the order of time"):
        list(reader.raw())


@pytest.mark.parametrize(
    "definition",
    [
        "string[1000000000] a",
        "\n".join(["Sub[1000] a", "=" * 80, "MSG: x/Sub", "Two[1000] a", "=" * 80, "MSG: x/Two", "uint8 b"]),
        "Y a",
    ],
)
def test_definition_of_a_message_of_many_parts(tmp_path, definition):
    topic = Topic("/t", "x/msg/Y", definition, "ros2msg", "", "")
    with little_memory(), pytest.raises(RecordingError, match="more than 10000 texts and messages within a x/msg/"):
        decode(topic, b"\0\1\0\0", tmp_path)


def test_file_that_gets_shorter_while_it_is_scanned(tmp_path):
    """A mapped file would end the process by SIGBUS."""
    with BagWriter(tmp_path / "bag", compression="none") as writer:
        writer.add_recorded_topic(Topic("/t", "x/msg/Y", "uint8[] data", "ros2msg", "", ""))
        for time in range(5):
            writer.write("/t", bytes(100_000), time, time)
            writer.flush()
    file = tmp_path / "bag" / "bag_0.mcap"
    with opened(file) as data:
        os.truncate(file, 200_000)
        with pytest.raises(RecordingError, match="was shortened to 200000 bytes while it was read; wait until"):
            scan_file(file, data)
