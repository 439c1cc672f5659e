"""Recordings are read as they were written, also after a crash of the process that writes them."""

import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap.records import Statistics
from mcap.writer import IndexType, Writer
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from zstandard import ZstdCompressor

from fringedic.errors import RecordingError
from fringedic.frames.records import stamp_of
from fringedic.recording.bag_files import beside
from fringedic.recording.definitions import interface_definition, type_hash
from fringedic.recording.reader import BagReader
from fringedic.recording.repair import info, join, recover
from fringedic.recording.topics import Qos, Topic
from fringedic.recording.verification import verify
from fringedic.recording.writer import BagWriter, Split

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"

PICTURE = "bench_msgs/msg/Picture"
FORCE = "bench_msgs/msg/Force"
DEFINITIONS = {
    "bench_msgs/msg/Stamp": "int32 sec\nuint32 nanosec\n",
    "bench_msgs/msg/Header": "Stamp stamp   # of the same package\nstring frame_id\n",
    PICTURE: "uint8 DARK=0\nbench_msgs/Header header\nuint32 height\nuint32 width\nstring<=8 kind\nuint8[] data\n",
    FORCE: "bench_msgs/Header header\nfloat64 newton 0.0\nfloat64[] history\n",
}


@pytest.fixture
def definitions(tmp_path, monkeypatch):
    """Install four message types under a prefix; return the names of the two that are recorded."""
    for name, text in DEFINITIONS.items():
        file = tmp_path / "prefix" / "share" / f"{name}.msg"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'nothing'}{os.pathsep}{tmp_path / 'prefix'}")
    for name in (PICTURE, FORCE):
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(interface_definition(name), name))
        hashes = [
            {"type_name": each, "hash_string": store.hash_rihs01(each)} for each in ("bench_msgs/msg/Header", name)
        ]
        file = tmp_path / "prefix" / "share" / f"{name}.json"
        file.write_text(json.dumps({"type_hashes": hashes}))
    return PICTURE, FORCE


@pytest.fixture
def typestore(definitions):
    store = get_typestore(Stores.EMPTY)
    for name in definitions:
        parsed = get_types_from_msg(interface_definition(name), name)
        store.register({each: fields for each, fields in parsed.items() if each not in store.fielddefs})
    return store


def header(store, stamp):
    types = store.types
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    return types["bench_msgs/msg/Header"](types["bench_msgs/msg/Stamp"](seconds, nanoseconds), "camera")


def picture(store, number, size=(6, 8)):
    data = np.random.default_rng(number).integers(0, 256, size[0] * size[1], np.uint8)
    message = store.types[PICTURE](header(store, number * 10**8), *size, "mono8", data)
    return bytes(store.serialize_cdr(message, PICTURE))


def force(store, number):
    message = store.types[FORCE](header(store, number * 10**7), 2.5 * number, np.arange(number % 3, dtype=float))
    return bytes(store.serialize_cdr(message, FORCE))


def write_bag(path, store, pictures=8, **options):
    """Ten force samples between two pictures, the log time in steps of 10 ms."""
    with BagWriter(path, **options) as writer:
        writer.add_topic("/rig/bench/image", PICTURE)
        writer.add_topic("/rig/bench/load", FORCE, [Qos(depth=1000, durability="transient_local", history="keep_last")])
        for number in range(10 * pictures):
            when = 10**18 + number * 10**7
            if number % 10 == 0:
                writer.write("/rig/bench/image", picture(store, number // 10), when, when - 5)
            writer.write("/rig/bench/load", force(store, number), when, when - 3)
            if number % 30 == 0:
                writer.flush()
    return path


@pytest.mark.usefixtures("definitions")
def test_definitions_contain_all_nested_types():
    text = interface_definition(FORCE)
    assert text.startswith("bench_msgs/Header header")
    assert text.count("=" * 80) == 2
    assert text.index("MSG: bench_msgs/Header\n") < text.index("MSG: bench_msgs/Stamp\n")
    assert type_hash(FORCE) != type_hash(PICTURE)


@pytest.mark.usefixtures("definitions")
def test_unknown_types_are_refused_by_name(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        with pytest.raises(RecordingError, match="'bench_msgs/msg/Torque'"):
            writer.add_topic("/torque", "bench_msgs/msg/Torque")
        with pytest.raises(RecordingError, match="/torque was not announced"):
            writer.write("/torque", b"", 0, 0)
        with pytest.raises(RecordingError, match="another definition of bench_msgs/msg/Force"):
            writer.add_topic("/force", FORCE, publisher_hash=type_hash(PICTURE))
        writer.add_topic("/force", FORCE, publisher_hash=type_hash(FORCE))
        writer.add_topic("/force", FORCE)
        with pytest.raises(RecordingError, match=f"recorded as {FORCE}, not as {PICTURE}"):
            writer.add_topic("/force", PICTURE)


@pytest.mark.parametrize("compression", ["zstd", "none"])
def test_everything_written_is_read_again_in_order(typestore, tmp_path, compression):
    reader = BagReader(write_bag(tmp_path / "bag", typestore, compression=compression))
    assert reader.lost == ""
    assert reader.counts == {"/rig/bench/image": 8, "/rig/bench/load": 80}
    raw = list(reader.raw())
    assert [each.log_time for each in raw] == sorted(each.log_time for each in raw)
    pictures = [each for each in raw if each.topic == "/rig/bench/image"]
    assert [each.data for each in pictures] == [picture(typestore, number) for number in range(8)]
    assert [each.log_time - each.publish_time for each in pictures] == [5] * 8
    assert (reader.start_time, reader.end_time) == (10**18, 10**18 + 79 * 10**7)
    _, message, _ = list(reader.messages(["/rig/bench/load"]))[79]
    assert message.newton == 2.5 * 79
    assert stamp_of(message) == 79 * 10**7
    assert message.history.tolist() == [0.0]


def test_other_readers_read_it(typestore, tmp_path):
    path = write_bag(tmp_path / "bag", typestore)
    with AnyReader([path]) as reader:
        assert reader.message_count == 88
        connection = next(each for each in reader.connections if each.topic == "/rig/bench/load")
        assert connection.digest == type_hash(FORCE)
        assert connection.ext.offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"
        assert (
            reader.deserialize(*[(raw, each.msgtype) for each, _, raw in reader.messages([connection])][3]).newton
            == 7.5
        )
    with (path / "bag_0.mcap").open("rb") as stream:
        mcap = make_reader(stream, validate_crcs=True)
        assert mcap.get_header().profile == "ros2"
        channels = {channel.topic: channel for channel in mcap.get_summary().channels.values()}
        assert channels["/rig/bench/image"].metadata["topic_type_hash"] == type_hash(PICTURE)
        assert yaml.safe_load(channels["/rig/bench/image"].metadata["offered_qos_profiles"])[0]["depth"] == 10
        assert [each.name for each in mcap.iter_metadata()] == ["rosbag2"]
        assert sum(1 for _ in mcap.iter_messages()) == 88
    metadata = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert metadata["version"] == 9
    assert metadata["message_count"] == 88


def test_the_size_is_that_of_the_files_also_when_they_are_complete(typestore, tmp_path):
    writer = BagWriter(tmp_path / "bag", split=Split(size=4000))
    writer.add_topic("/rig/bench/load", FORCE, [Qos(depth=1000)])
    for number in range(200):
        writer.write("/rig/bench/load", force(typestore, number), number, number)
    writer.sync()
    for close in (lambda: None, writer.close):
        close()
        sizes = [file.stat().st_size for file in (tmp_path / "bag").glob("*.mcap")]
        assert len(sizes) > 2
        assert writer.size == sum(sizes)


@pytest.mark.usefixtures("typestore")
def test_metadata_is_complete_while_recording(tmp_path):
    writer = BagWriter(tmp_path / "bag")
    assert yaml.safe_load((tmp_path / "bag/metadata.yaml").read_text())["rosbag2_bagfile_information"]["version"] == 9
    writer.close()
    writer.close()


def test_an_existing_folder_is_refused_and_left_alone(typestore, tmp_path):
    path = write_bag(tmp_path / "bag", typestore)
    before = {file.name: file.read_bytes() for file in path.iterdir()}
    with pytest.raises(RecordingError, match="exists already; choose another name"):
        BagWriter(path)
    assert {file.name: file.read_bytes() for file in path.iterdir()} == before


@pytest.mark.usefixtures("definitions")
def test_an_unwritable_place_is_named(tmp_path):
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(RecordingError, match=r"file/bag: cannot be written: Not a directory"):
        BagWriter(tmp_path / "file" / "bag")


def test_missing_topics_are_named_with_what_is_there(typestore, tmp_path):
    reader = BagReader(write_bag(tmp_path / "bag", typestore))
    assert reader.find("bench/image") == {"bench/image": "/rig/bench/image"}
    with pytest.raises(RecordingError, match=r"has no camera/exposure, calibration; it holds /rig/bench/image"):
        reader.find("bench/image", "camera/exposure", "calibration")
    assert reader.find_optional("camera/exposure", "bench/load") == {"bench/load": "/rig/bench/load"}


def test_two_rigs_in_one_recording_are_not_mixed(typestore, tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        for rig in ("left", "right"):
            writer.add_topic(f"/{rig}/bench/image", PICTURE)
            writer.write(f"/{rig}/bench/image", picture(typestore, 1), 1, 1)
    with pytest.raises(RecordingError, match="several rigs: /left/bench/image, /right/bench/image"):
        BagReader(tmp_path / "bag").find("bench/image")


def test_no_recording_and_no_mcap_are_distinguished(tmp_path):
    with pytest.raises(RecordingError, match="no such recording"):
        BagReader(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    with pytest.raises(RecordingError, match=r"holds no \.mcap file"):
        BagReader(tmp_path / "empty")
    (tmp_path / "text.mcap").write_text("something else altogether")
    with pytest.raises(RecordingError, match="is not an MCAP file"):
        BagReader(tmp_path / "text.mcap")


@pytest.mark.parametrize("part", [0.35, 0.8, 0.999])
def test_a_truncated_recording_gives_all_that_is_whole(typestore, tmp_path, part):
    path = write_bag(tmp_path / "bag", typestore)
    whole = list(BagReader(path).raw())
    file = path / "bag_0.mcap"
    data = file.read_bytes()
    file.write_bytes(data[: int(part * len(data))])
    reader = BagReader(path)
    assert "not closed" in reader.lost
    read = list(reader.raw())
    assert 0 < len(read) <= len(whole)
    assert read == whole[: len(read)]
    assert sum(reader.counts.values()) == len(read)
    if part > 0.9:
        assert read == whole


def test_recover_writes_a_whole_recording_beside_the_damaged_one(typestore, tmp_path):
    path = write_bag(tmp_path / "bag", typestore)
    file = path / "bag_0.mcap"
    damaged = file.read_bytes()[: -len(file.read_bytes()) // 3]
    file.write_bytes(damaged)
    found = list(BagReader(path).raw())
    recovered = recover(path).path
    assert recovered == tmp_path / "bag_recovered"
    assert file.read_bytes() == damaged
    again = BagReader(recovered)
    assert again.lost == ""
    assert list(again.raw()) == found
    assert again.topics == BagReader(path).topics
    with AnyReader([recovered]) as reader:
        assert reader.message_count == len(found)
    summary = info(recovered)
    assert summary.types["/rig/bench/image"] == PICTURE
    assert summary.counts == again.counts


def test_recovered_recording_has_the_whole_name_of_the_folder(typestore, tmp_path, monkeypatch):
    for name in ("plate.6", "plate.7"):
        write_bag(tmp_path / name, typestore)
    monkeypatch.chdir(tmp_path / "plate.6")
    assert recover(".").path == tmp_path / "plate.6_recovered"
    assert recover("../plate.7").path == tmp_path / "plate.7_recovered"
    assert recover(tmp_path / "plate.7" / "plate.7_0.mcap").path == tmp_path / "plate.7" / "plate.7_0_recovered"


def test_an_interrupted_recovery_leaves_nothing(tmp_path, monkeypatch):
    """The half that was written passed for a complete recording."""
    stored = BagReader.stored

    def interrupted(reader):
        yield from islice(stored(reader), 500)
        raise KeyboardInterrupt

    monkeypatch.setattr(BagReader, "stored", interrupted)
    for parts in (1, 2):
        bag = tmp_path / str(parts) / "bag"
        for number in range(parts):
            shutil.copytree(RECORDED, bag if number == 0 else bag.with_name(f"bag-{number + 1}"))
        with pytest.raises(KeyboardInterrupt):
            recover(bag)
        assert not bag.with_name("bag_recovered").exists()
    (tmp_path / "mine").mkdir()
    with pytest.raises(RecordingError, match="mine exists already"):
        recover(bag, tmp_path / "mine")
    assert (tmp_path / "mine").exists()


def test_names_beside_a_path(tmp_path):
    (tmp_path / "plate.nc").touch()
    assert beside(tmp_path / "plate.nc", "_exported") == tmp_path / "plate_exported"
    assert beside(tmp_path / "plate.zarr", "_exported") == tmp_path / "plate_exported"
    assert beside(tmp_path / "run" / "..", "_exported") == tmp_path.with_name(f"{tmp_path.name}_exported")
    assert beside(Path("/"), "_exported") == Path("/_exported")


def compressed_by_rosbag2(bag, mode):
    content = yaml.safe_load((bag / "metadata.yaml").read_text())
    content["rosbag2_bagfile_information"]["compression_mode"] = mode
    (bag / "metadata.yaml").write_text(yaml.safe_dump(content))
    return bag


@pytest.mark.usefixtures("typestore")
def test_compressed_messages_are_refused_without_their_metadata(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/force", FORCE)
        writer.write("/force", ZstdCompressor().compress(bytes(20)), 1, 1)
    (tmp_path / "bag" / "metadata.yaml").unlink()
    file = tmp_path / "bag" / "bag_0.mcap"
    for read in (recover, verify, lambda path: list(BagReader(path).raw())):
        with pytest.raises(RecordingError, match=r"bag_0\.mcap: its messages are compressed by rosbag2; put it beside"):
            read(file)
    assert [each.name for each in tmp_path.rglob("*_recovered")] == []


@pytest.mark.parametrize("mode", ["", "NONE", "none", None])
def test_recording_without_compression_by_rosbag2_is_read(typestore, tmp_path, mode):
    assert verify(compressed_by_rosbag2(write_bag(tmp_path / "bag", typestore), mode)).messages


def test_file_that_the_compressed_recording_does_not_list_is_read(typestore, tmp_path):
    bag = compressed_by_rosbag2(write_bag(tmp_path / "bag", typestore), "MESSAGE")
    (bag / "bag_0.mcap").rename(bag / "other.mcap")
    assert BagReader(bag / "other.mcap").counts


def test_a_flipped_byte_is_detected_and_costs_one_chunk(typestore, tmp_path):
    path = write_bag(tmp_path / "bag", typestore, compression="none")
    file = path / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    place = data.index(picture(typestore, 4)) + 60
    data[place] ^= 0xFF
    file.write_bytes(data)
    with pytest.raises(RecordingError, match=r"bag_0\.mcap: damaged at byte \d+ .*fringedic recover"):
        list(BagReader(path).raw())
    assert "1 chunk left out" in BagReader(path, check=True).lost
    numbers = {each.data for each in BagReader(recover(path).path).raw(["/rig/bench/image"])}
    assert not numbers & {picture(typestore, number) for number in (4, 5, 6)}
    assert numbers == {picture(typestore, number) for number in (0, 1, 2, 3, 7)}


def test_chunks_that_overlap_in_time_are_read_in_log_order(typestore, tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/force", FORCE)
        for times in ((10, 30, 50), (20, 30, 60), (5, 70)):
            for when in times:
                writer.write("/force", force(typestore, when), when, when)
            writer.flush()
    assert [each.log_time for each in BagReader(tmp_path / "bag").raw()] == [5, 10, 20, 30, 30, 50, 60, 70]


def test_messages_that_overtook_each_other_come_in_the_order_of_publishing(typestore, tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/force", FORCE)
        for logged, published in enumerate((3, 1, 2, 7, 5, 4, 6)):
            writer.write("/force", force(typestore, published), logged, published)
    reader = BagReader(tmp_path / "bag")
    assert [each.publish_time for each in reader.raw()] == [3, 1, 2, 7, 5, 4, 6]
    assert [each.publish_time for each in reader.published()] == [1, 2, 3, 4, 5, 6, 7]


WRITER = """
    import sys, time
    import numpy as np
    from fringedic.recording import BagWriter
    image, sample = (open(name, "rb").read() for name in sys.argv[2:4])
    writer = BagWriter(sys.argv[1])
    writer.add_topic("/rig/bench/image", "bench_msgs/msg/Picture")
    writer.add_topic("/rig/bench/load", "bench_msgs/msg/Force")
    start = time.monotonic()
    for number in range(10**6):
        if number % 7 == 0:
            writer.write("/rig/bench/image", image, time.time_ns(), number)
            print("image", number, time.monotonic(), flush=True)
        writer.write("/rig/bench/load", sample, time.time_ns(), number)
        print("force", number, time.monotonic(), flush=True)
        time.sleep(max(0.0, start + (number + 1) / 100 - time.monotonic()))
"""


@pytest.mark.parametrize("size", [(960, 1280), (48, 64)])
def test_a_killed_recorder_loses_no_image_and_half_a_second_of_force(typestore, tmp_path, size):
    """SIGKILL while 15 images/s and 100 Hz force are being recorded."""
    (tmp_path / "image").write_bytes(picture(typestore, 1, size))
    (tmp_path / "sample").write_bytes(force(typestore, 1))
    arguments = [str(tmp_path / name) for name in ("bag", "image", "sample")]
    child = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(WRITER), *arguments],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    written = []
    while not written or float(written[-1][2]) - float(written[0][2]) < 2.0:
        written.append(child.stdout.readline().split())
    child.send_signal(signal.SIGKILL)
    killed_at = time.monotonic()
    written += [line.split() for line in child.stdout.read().splitlines() if len(line.split()) == 3]
    child.wait()
    child.stdout.close()

    reader = BagReader(tmp_path / "bag")
    assert "not closed" in reader.lost
    read = {topic: {each.publish_time for each in reader.raw([topic])} for topic in reader.topics}
    safe = killed_at - 0.5 - 0.1
    for kind, topic in (("image", "/rig/bench/image"), ("force", "/rig/bench/load")):
        kept = {int(number) for what, number, when in written if what == kind and float(when) < safe}
        total = sum(what == kind for what, _, _ in written)
        assert kept
        assert kept <= read[topic]
        if kind == "image" and size == (960, 1280):
            assert total - len(read[topic]) <= 1
    with AnyReader([recover(tmp_path / "bag").path]) as again:
        assert again.message_count == sum(reader.counts.values())


def test_a_full_disk_is_named_and_what_was_written_stays(typestore, tmp_path):
    """A limit on the size of files replaces the full disk: the operating system refuses the write in the same way."""
    script = """
        import resource, sys
        from fringedic.errors import RecordingError
        from fringedic.recording import BagWriter
        image = open(sys.argv[2], "rb").read()
        resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))
        writer = BagWriter(sys.argv[1], compression="none")
        writer.add_topic("/rig/bench/image", "bench_msgs/msg/Picture")
        errors = []
        for number in range(40):
            try:
                writer.write("/rig/bench/image", image, number, number)
                writer.flush()
            except RecordingError as error:
                errors.append(str(error))
        writer.close()
        print(len(errors), errors[0])
    """
    (tmp_path / "image").write_bytes(picture(typestore, 1, (200, 250)))
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script), str(tmp_path / "bag"), str(tmp_path / "image")],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    assert done.returncode == 0, done.stderr
    number, message = done.stdout.split(maxsplit=1)
    assert int(number) == 40 - 19
    assert "the disk is full" in message
    reader = BagReader(tmp_path / "bag")
    assert reader.counts == {"/rig/bench/image": 19}
    assert {each.data for each in reader.raw()} == {picture(typestore, 1, (200, 250))}


def test_a_whole_recording_is_opened_by_its_index(typestore, tmp_path):
    """Opening reads the end of the file only: it works with all messages erased, and reading them then fails."""
    path = write_bag(tmp_path / "bag", typestore)
    file = path / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    with file.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    for chunk in chunks:
        first = chunk.chunk_start_offset + 60
        data[first : chunk.chunk_start_offset + chunk.chunk_length] = bytes(chunk.chunk_length - 60)
    file.write_bytes(data)
    reader = BagReader(path)
    assert reader.lost == ""
    assert sum(reader.counts.values()) == 88
    with pytest.raises(RecordingError, match="damaged at byte"):
        list(reader.raw())


def test_gaps_in_the_publishers_count_are_kept(typestore, tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/force", FORCE)
        for number, sequence in enumerate((7, 8, 11, None)):
            writer.write("/force", force(typestore, number), 10**18 + number, 10**18 + number, sequence)
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
        found = [message.sequence for _, _, message in make_reader(stream).iter_messages()]
    assert found == [7, 8, 11, 3]


def file_sizes(path):
    return {file.name: file.stat().st_size for file in path.glob("*.mcap")}


@pytest.mark.parametrize("split", [Split(size=2500), Split(duration=0.2)], ids=["size", "duration"])
def test_a_split_recording_is_one_for_every_reader(typestore, tmp_path, split):
    whole = list(BagReader(write_bag(tmp_path / "whole", typestore)).raw())
    path = write_bag(tmp_path / "bag", typestore, split=split, compression="none")
    names = [f"bag_{number}.mcap" for number in range(len(file_sizes(path)))]
    assert len(names) >= 3
    assert sorted(file_sizes(path)) == names
    reader = BagReader(path)
    assert reader.lost == ""
    assert [message[:4] for message in reader.raw()] == [message[:4] for message in whole]
    copies = [message for message in reader.stored() if message not in whole]  # of latched messages, for each file
    assert {message._replace(log_time=0) for message in copies} <= {message._replace(log_time=0) for message in whole}
    assert [message for message in reader.stored() if message in whole] == whole
    metadata = yaml.safe_load((path / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert metadata["relative_file_paths"] == [each["path"] for each in metadata["files"]] == names
    stored = len(whole) + len(copies)
    assert metadata["message_count"] == sum(each["message_count"] for each in metadata["files"]) == stored
    with AnyReader([path]) as other:
        assert other.message_count == stored
        assert {raw for _, _, raw in other.messages()} == {message.data for message in whole}
    for name in names:  # each file can be read alone
        with (path / name).open("rb") as stream:
            assert len(make_reader(stream, validate_crcs=True).get_summary().channels) == 2


def test_files_of_a_split_recording_have_the_wanted_size(typestore, tmp_path):
    data = picture(typestore, 1, (40, 50))
    with BagWriter(tmp_path / "bag", compression="none", split=Split(size=100_000)) as writer:
        writer.add_topic("/image", PICTURE)
        for number in range(200):
            writer.write("/image", data, number, number)
    ends = []
    for name in sorted(file_sizes(tmp_path / "bag")):
        with (tmp_path / "bag" / name).open("rb") as stream:
            chunks = make_reader(stream).get_summary().chunk_indexes
        ends.append(max(each.chunk_start_offset + each.chunk_length for each in chunks))
    assert len(ends) == 5
    assert all(95_000 < end < 103_000 for end in ends[:-1])  # two kilobytes of metadata and definitions on top


def test_a_split_recording_of_a_killed_recorder_is_read_to_its_end(typestore, tmp_path):
    writer = BagWriter(tmp_path / "bag", split=Split(duration=10e-9))
    writer.add_topic("/force", FORCE)
    for number in range(25):
        writer.write("/force", force(typestore, number), number, number)
    writer.flush()
    reader = BagReader(tmp_path / "bag")
    assert reader.lost.startswith("bag_2.mcap: not closed")
    assert [message.log_time for message in reader.raw()] == [*range(25)]
    writer.close()
    assert BagReader(tmp_path / "bag").lost == ""


def test_a_full_disk_at_a_split_is_named(typestore, tmp_path):
    writer = BagWriter(tmp_path / "bag", split=Split(duration=10e-9))
    writer.add_topic("/force", FORCE)
    writer.write("/force", force(typestore, 0), 0, 0)
    (tmp_path / "bag" / "bag_1.mcap").mkdir()
    with pytest.raises(RecordingError, match="cannot be written: File exists"):
        writer.write("/force", force(typestore, 1), 20, 20)
    writer.close()
    (tmp_path / "bag" / "bag_1.mcap").rmdir()
    assert [message.log_time for message in BagReader(tmp_path / "bag").raw()] == [0]


def test_the_manifest_is_read_by_sha256sum(typestore, tmp_path):
    path = write_bag(tmp_path / "bag", typestore, split=Split(duration=0.4))
    done = subprocess.run(["sha256sum", "--check", "manifest.sha256"], cwd=path, capture_output=True, text=True)
    assert done.stdout.splitlines() == ["bag_0.mcap: OK", "bag_1.mcap: OK", "metadata.yaml: OK"]


def test_joined_parts_have_one_channel_per_topic(typestore, tmp_path):
    first, second = (write_bag(tmp_path / name, typestore, pictures=3) for name in ("bag-1", "bag-2"))
    (tmp_path / "bag-3").mkdir()
    joined = join([first, second, tmp_path / "bag-3"], tmp_path / "bag")
    assert joined.damage.startswith(
        f"{tmp_path / 'bag-3'}: holds no .mcap file; convert other storage: rosbags-convert"
    )
    assert joined.messages == 66
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
        assert sorted(each.topic for each in make_reader(stream).get_summary().channels.values()) == [
            "/rig/bench/image",
            "/rig/bench/load",
        ]
    with AnyReader([tmp_path / "bag"]) as reader:
        for connection in reader.connections:
            assert len(list(reader.messages([connection]))) == connection.msgcount
        assert sum(connection.msgcount for connection in reader.connections) == 66
    assert [message.sequence for message in BagReader(tmp_path / "bag").stored()] == [
        message.sequence for part in (first, second) for message in BagReader(part).stored()
    ]


def test_parts_with_different_definitions_are_not_joined(tmp_path):
    for name, definition in (("bag-1", "uint8 newton"), ("bag-2", "uint16 newton")):
        with BagWriter(tmp_path / name) as writer:
            writer.add_recorded_topic(Topic("/force", FORCE, definition, "ros2msg", "", ""))
    with pytest.raises(RecordingError, match=f"/force has two definitions of its type {FORCE}"):
        join([tmp_path / "bag-1", tmp_path / "bag-2"], tmp_path / "bag")
    (tmp_path / "bag-2" / "bag-2_0.mcap").rename(tmp_path / "bag-1" / "bag-2_0.mcap")
    with pytest.raises(RecordingError, match=r"bag-2_0\.mcap: defines the messages of /force differently"):
        recover(tmp_path / "bag-1")


def test_parts_whose_definitions_differ_in_comments_are_joined(tmp_path):
    definitions = (
        "uint8 newton # what's pulled",
        'uint8  newton\n# of "it"\n',
        "uint16 other # same hash",
        "uint8 newton",
    )
    for number, (definition, hash_) in enumerate(zip(definitions, ("RIHS01", "", "RIHS01", "other"), strict=True)):
        with BagWriter(tmp_path / f"bag-{number}") as writer:
            writer.add_recorded_topic(Topic("/force", FORCE, definition, "ros2msg", hash_, ""))
            writer.write("/force", bytes([0, 1, 0, 0, number]), number, number)
    join([tmp_path / f"bag-{number}" for number in range(4)], tmp_path / "bag")
    assert [message.newton for _, message, _ in BagReader(tmp_path / "bag").messages()] == [0, 1, 2, 3]


def test_an_unknown_depth_is_not_recorded_as_zero(typestore, tmp_path):
    path = write_bag(tmp_path / "bag", typestore)
    assert "depth: 0" not in (path / "metadata.yaml").read_text()
    with AnyReader([path]) as reader:
        image, force_ = sorted(reader.connections, key=lambda each: each.topic)
    assert [(each.history.name, each.depth) for each in image.ext.offered_qos_profiles] == [("UNKNOWN", 10)]
    assert [(each.history.name, each.depth) for each in force_.ext.offered_qos_profiles] == [("KEEP_LAST", 1000)]


@pytest.mark.parametrize(
    "options",
    [
        {"index_types": IndexType.CHUNK},
        {"index_types": IndexType.NONE},
        {"enable_crcs": False},
        {"repeat_channels": False},
        {"repeat_schemas": False},
        {"use_statistics": False},
    ],
    ids=lambda options: next(iter(options)),
)
def test_files_of_other_writers_are_read(tmp_path, options):
    """Most of the index and all checksums are optional in MCAP."""
    with (tmp_path / "other.mcap").open("wb") as stream:
        writer = Writer(stream, chunk_size=200, **options)
        writer.start("ros2")
        schema = writer.register_schema("bench_msgs/msg/Force", "ros2msg", b"uint8 newton")
        channels = [writer.register_channel(name, "cdr", schema) for name in ("/a", "/b")]
        for number in range(40):
            writer.add_message(channels[number % 2], number, bytes([0, 1, 0, 0, number]), number)
        writer.finish()
    for check in (False, True):
        reader = BagReader(tmp_path / "other.mcap", check=check)
        assert reader.lost == ""
        assert [message.newton for _, message, _ in reader.messages(["/b"])] == [*range(1, 40, 2)]
        assert len(list(reader.stored())) == 40
    recovered = recover(tmp_path / "other.mcap")
    assert recovered.whole
    assert recovered.messages == 40


def test_index_without_counts_of_the_channels_is_not_used(typestore, tmp_path, monkeypatch):
    write_statistics = Statistics.write

    def write_total(statistics, stream):
        statistics.channel_message_counts = {}
        write_statistics(statistics, stream)

    monkeypatch.setattr(Statistics, "write", write_total)
    bag = write_bag(tmp_path / "bag", typestore)
    summary = info(bag / "bag_0.mcap")
    assert summary.messages == len(list(BagReader(bag).raw())) > 0
    assert summary.whole


def test_sequence_of_another_middleware_does_not_end_the_recording(typestore, tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/force", FORCE)
        writer.write("/force", force(typestore, 1), 1, 1, 2**64 - 1)
    assert [message.sequence for message in BagReader(tmp_path / "bag").raw()] == [2**32 - 1]
