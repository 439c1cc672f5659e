"""Recordings in other storage than MCAP in chunks are read, or the command that converts them is named."""

import subprocess
from pathlib import Path

import pytest
import yaml
import zstandard
from mcap.writer import CompressionType, Writer

from fringedic.errors import RecordingError
from fringedic.recording import BagReader, recover, verify
from fringedic.recording.repair import info

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"
SQLITE, FILE, MESSAGE = "--dst-storage sqlite3", "--compress zstd --compress-mode file", "--compress zstd"


def converted(target, options):
    """Write the recording by the command of the library `rosbags`."""
    words = ["rosbags-convert", "--src", str(RECORDED), "--dst", str(target), *options.split()]
    subprocess.run(words, check=True, capture_output=True)
    return target


def without_chunks(target):
    reader = BagReader(RECORDED)
    with target.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start("ros2")
        channels = {}
        for topic in reader.topics.values():
            schema = writer.register_schema(topic.type_name, topic.encoding, topic.definition.encode())
            about = {"offered_qos_profiles": topic.qos}
            channels[topic.name] = writer.register_channel(topic.name, "cdr", schema, about)
        for topic, data, log_time, publish_time, number in reader.stored():
            writer.add_message(channels[topic], log_time, data, publish_time, number)
        writer.finish()
    return target


def compressed(target):
    target.write_bytes(zstandard.ZstdCompressor().compress((RECORDED / "bag_0.mcap").read_bytes()))
    return target


def split(target, mode, chunks=CompressionType.ZSTD, parts=12):
    """Write the recording in files that are named as by rosbag2 of Lyrical: 0_plate_2026_05_31-10_00_00.mcap, ..."""
    target.mkdir()
    reader = BagReader(RECORDED)
    stored = list(reader.stored())
    names, packer = [], zstandard.ZstdCompressor()
    for part in range(parts):
        file = target / f"{part}_plate_2026_05_31-10_00_{part:02d}.mcap"
        with file.open("wb") as stream:
            writer = Writer(stream, chunk_size=20_000, compression=chunks)
            writer.start("ros2")
            channels = {}
            for topic in reader.topics.values():
                schema = writer.register_schema(topic.type_name, topic.encoding, topic.definition.encode())
                channels[topic.name] = writer.register_channel(topic.name, "cdr", schema)
            begin, end = (each * len(stored) // parts for each in (part, part + 1))
            for topic, data, log_time, publish_time, number in stored[begin:end]:
                packed = packer.compress(data) if mode == "MESSAGE" else data
                writer.add_message(channels[topic], log_time, packed, publish_time, number)
            writer.finish()
        if mode == "FILE":
            packed = file.with_name(f"{file.name}.zstd")
            packed.write_bytes(packer.compress(file.read_bytes()))
            file.unlink()
            file = packed
        names.append(file.name)
    about = {"version": 9, "storage_identifier": "mcap", "relative_file_paths": names, "message_count": len(stored)}
    about |= {"compression_mode": mode, "compression_format": "zstd" if mode else "", "topics_with_message_count": []}
    (target / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": about}))
    return target


def content(bag):
    reader = BagReader(bag)
    return {topic: [(raw.data, raw.log_time) for raw in reader.raw([topic])] for topic in reader.topics}


@pytest.mark.parametrize(
    "options",
    [
        SQLITE,
        f"{SQLITE} {FILE}",
        f"{SQLITE} {MESSAGE} --compress-mode message",
        f"--dst-storage mcap {FILE}",
        f"--dst-storage mcap {MESSAGE} --compress-mode message",
        "--dst-storage mcap",
    ],
)
def test_other_storage_of_rosbag2_is_read(tmp_path, options):
    bag = converted(tmp_path / "other", options)
    assert content(bag) == content(RECORDED)
    reader = BagReader(bag)
    assert next(message.node for _, message, _ in reader.messages(["/rig/node_parameters"])) == "recorder"
    assert (reader.damage, info(bag).counts) == ("", BagReader(RECORDED).counts)
    assert reader.chunks_without_checksum or not reader.is_converted
    assert recover(bag, tmp_path / "recovered").messages == info(RECORDED).messages
    assert [each.name for each in tmp_path.iterdir()] == ["other", "recovered"]


@pytest.mark.parametrize(
    ("mode", "chunks"),
    [
        ("", CompressionType.ZSTD),
        ("", CompressionType.LZ4),
        ("FILE", CompressionType.NONE),
        ("MESSAGE", CompressionType.ZSTD),
    ],
)
def test_many_files_with_the_names_of_lyrical_are_one_recording(tmp_path, mode, chunks):
    """Their numbers stand in front and have no zeros: the tenth file comes before the second in the alphabet."""
    bag = split(tmp_path / "plate", mode, chunks)
    reader = BagReader(bag)
    assert content(bag) == content(RECORDED)
    assert (reader.damage, reader.missing, reader.unlisted) == ("", {}, ())
    assert (info(bag).counts, info(bag).damage) == (BagReader(RECORDED).counts, "")
    assert (verify(bag).frames, verify(bag).lost_frames, verify(bag).damage) == (36, 0, "")
    (bag / "metadata.yaml").unlink()
    if mode != "MESSAGE":  # only metadata.yaml states that each message is compressed
        assert content(bag) == content(RECORDED)


@pytest.mark.parametrize("write", [without_chunks, compressed])
def test_single_file_in_other_storage_is_read(tmp_path, write):
    file = write(tmp_path / ("bag_0.mcap" if write is without_chunks else "bag_0.mcap.zstd"))
    for bag in (file, tmp_path):
        assert content(bag) == content(RECORDED)
        found = verify(bag)
        assert (found.frames, found.lost_frames, found.gaps, found.damage) == (36, 0, {}, "")
        assert not found.complete, "nothing proves that no byte has changed"


@pytest.mark.parametrize("write", [without_chunks, compressed])
def test_cut_off_file_in_other_storage_says_what_is_lost(tmp_path, write):
    file = write(tmp_path / ("bag_0.mcap" if write is without_chunks else "bag_0.mcap.zstd"))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    reader = BagReader(file)
    assert 0 < sum(reader.counts.values()) < info(RECORDED).messages
    assert f"{file.name}: is damaged or was not closed" in reader.damage


def test_file_that_is_written_further_is_read_again(tmp_path):
    file = without_chunks(tmp_path / "bag_0.mcap")
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    before = sum(BagReader(file).counts.values())
    file.write_bytes(whole)
    assert sum(BagReader(file).counts.values()) == info(RECORDED).messages > before


def test_recording_of_ros_1_names_the_whole_command(tmp_path):
    """The command is installed with the library."""
    bag = tmp_path / "plate-7.bag"
    bag.write_bytes(b"#ROSBAG V2.0\n")
    command = f"rosbags-convert --src {bag} --dst {tmp_path / 'plate-7_mcap'} --dst-storage mcap"
    with pytest.raises(RecordingError, match=f"{command}$"):
        BagReader(bag)
