"""A verification finds every lost frame, every lost message and every changed file, and nothing else."""

import re
import shutil
from hashlib import sha256
from pathlib import Path
from random import Random

import pytest
import yaml
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fringedic.errors import RecordingError
from fringedic.frames.records import stamp_of
from fringedic.recording import BagReader, BagWriter, Split, Topic, recover, verify
from fringedic.recording.frames import records
from fringedic.recording.manifest import write_manifest
from fringedic.recording.repair import info
from fringedic.recording.sentences import content_sentences, verification_sentences

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"
IMAGE, EXPOSURE, STEP = "/rig/camera/image_raw", "/rig/camera/exposure", "/rig/experiment/step"
LOAD, PARAMETERS = "/rig/load_frame/state", "/rig/node_parameters"
FRAMES = 36


def copy(target, *, without=(), sequence=None, split=None):
    """Copy the recording without the messages of some (topic, number in the topic)."""
    reader = BagReader(RECORDED)
    options = {} if split is None else {"split": split}
    numbers = dict.fromkeys(reader.topics, -1)
    with BagWriter(target, **options) as writer:
        for topic in reader.topics.values():
            writer.add_recorded_topic(topic)
        for message in reader.stored():
            numbers[message.topic] += 1
            if (message.topic, numbers[message.topic]) not in without:
                number = message.sequence if sequence is None else sequence(message, numbers[message.topic])
                writer.write(*message[:4], number)
            if message.topic == IMAGE:
                writer.flush()
    return target


def repeat(target, *, seconds=60, renamed=b"tiny"):
    """Write the recording and its frames once more, this much later, and optionally as frames of another experiment."""
    reader = BagReader(RECORDED)
    with BagWriter(target) as writer:
        for topic in reader.topics.values():
            writer.add_recorded_topic(topic)
        for message in reader.stored():
            writer.write(*message[:4])
        for topic, data, log_time, publish_time, _ in reader.stored():
            if topic in (IMAGE, EXPOSURE):
                second = int.from_bytes(data[4:8], "little") + seconds  # of the stamp, after the CDR header
                data = data[:4] + second.to_bytes(4, "little") + data[8:].replace(b"tiny", renamed)
                writer.write(topic, data, log_time + seconds * 10**9, publish_time + seconds * 10**9)
    return target


def set_back(target, *, after, seconds, **options):
    """Write the recording as if its clock had been set back after a share of the messages."""
    reader = BagReader(RECORDED)
    messages = list(reader.stored())
    with BagWriter(target, **options) as writer:
        for topic in reader.topics.values():
            writer.add_recorded_topic(topic)
        for number, message in enumerate(messages):
            shift = int(seconds * 1e9) if number > after * len(messages) else 0
            writer.write(message.topic, message.data, message.log_time - shift, message.publish_time - shift)
            if number % 20 == 0:
                writer.flush()
    return target


def number_of(topic, wanted):
    """Return the number of the first message of a topic that fulfils a condition."""
    messages = BagReader(RECORDED).messages([topic])
    return next(number for number, (_, message, _) in enumerate(messages) if wanted(message))


def last_line(bag):
    return list(verification_sentences(verify(bag)))[-1]


def test_complete_recording(tmp_path):
    for bag in (RECORDED, copy(tmp_path / "bag"), copy(tmp_path / "split", split=Split(size=200_000))):
        found = verify(bag)
        assert found.complete
        assert (found.frames, found.lost_frames, found.gaps, found.unfinished_steps) == (FRAMES, 0, {}, {})
        assert last_line(bag) == "36 of 36 frames, 0 lost"
    assert verify(RECORDED).manifest.present is False
    assert len(verify(tmp_path / "split").manifest.equal) == verify(tmp_path / "split").files + 1 >= 4


@pytest.mark.parametrize("topic", [IMAGE, EXPOSURE])
def test_lost_image_or_record_is_a_lost_frame(tmp_path, topic):
    bag = copy(tmp_path / "bag", without={(topic, 5), (topic, 20)})
    found = verify(bag)
    assert not found.complete
    assert (found.frames, found.lost_frames, found.gaps) == (FRAMES - 2, 2, {topic: 2})
    assert last_line(bag) == "34 of 36 frames, 2 lost"
    assert f"missing are 2 of {topic}" in " ".join(verification_sentences(found))


def test_frame_that_was_lost_with_its_record_is_found_by_the_count(tmp_path):
    found = verify(copy(tmp_path / "bag", without={(IMAGE, 7), (EXPOSURE, 7)}))
    assert (found.frames, found.lost_frames, found.gaps) == (FRAMES - 1, 1, {IMAGE: 1, EXPOSURE: 1})


def test_frame_that_was_lost_with_its_record_is_found_by_its_step(tmp_path):
    """Recorders without sequence numbers write 0."""
    bag = copy(tmp_path / "bag", without={(IMAGE, 7), (EXPOSURE, 7)}, sequence=lambda *_: 0)
    found = verify(bag)
    assert (found.frames, found.lost_frames, found.gaps) == (FRAMES - 1, 1, {})
    assert not found.complete


@pytest.mark.parametrize("step", [1, 2])
def test_step_of_which_no_frame_is_left_is_found_by_its_end(tmp_path, step):
    stamps = {stamp_of(record) for _, record, _ in BagReader(RECORDED).messages([EXPOSURE]) if record.step == step}
    messages = {topic: enumerate(BagReader(RECORDED).messages([topic])) for topic in (IMAGE, EXPOSURE)}
    lost = {(topic, i) for topic, each in messages.items() for i, (_, m, _) in each if stamp_of(m) in stamps}
    found = verify(copy(tmp_path / "bag", without=lost, sequence=lambda *_: 0))
    assert not found.complete
    assert (found.frames, found.lost_frames) == (FRAMES - 12, 12)


def test_topic_of_another_program_is_no_exposure_record(tmp_path):
    reader = BagReader(RECORDED)
    other = Topic("/driver/camera/exposure", "std_msgs/msg/Float64", "float64 data", "ros2msg", "", "")
    with BagWriter(tmp_path / "bag") as writer:
        for topic in (*reader.topics.values(), other):
            writer.add_recorded_topic(topic)
        for message in reader.stored():
            writer.write(*message)
            if message.topic == IMAGE:
                writer.write(other.name, bytes(12), message.log_time, message.publish_time)
    assert verify(tmp_path / "bag").complete
    assert len([*records(BagReader(tmp_path / "bag"))]) == FRAMES
    with BagWriter(tmp_path / "other") as writer:
        writer.add_recorded_topic(other)
        writer.write(other.name, bytes(12), 1, 1)
    words = r"has no camera/exposure; /driver/camera/exposure is a std_msgs/msg/Float64; it holds /driver"
    with pytest.raises(RecordingError, match=words):
        BagReader(tmp_path / "other").find("camera/exposure")


def test_lost_samples_are_counted_and_cost_no_frame(tmp_path):
    found = verify(copy(tmp_path / "bag", without={(LOAD, 100), (LOAD, 101), (LOAD, 300)}))
    assert (found.frames, found.lost_frames, found.gaps) == (FRAMES, 0, {LOAD: 3})
    assert not found.complete


def test_restarted_publisher_loses_nothing(tmp_path):
    found = verify(copy(tmp_path / "bag", sequence=lambda _, number: number % 17 + 1))
    assert found.complete


def test_latched_topics_have_several_publishers(tmp_path):
    found = verify(
        copy(tmp_path / "bag", sequence=lambda each, number: 7 * number if each.topic == PARAMETERS else number)
    )
    assert found.complete


def test_interrupted_step_is_listed_and_loses_nothing(tmp_path):
    end = number_of(STEP, lambda message: (message.step, message.stage) == (2, 3))
    stamps = {stamp_of(m): m.index for _, m, _ in BagReader(RECORDED).messages([EXPOSURE]) if m.step == 2}
    late = {stamp for stamp, index in stamps.items() if index >= 5}
    without = {(STEP, end)}
    for topic in (IMAGE, EXPOSURE):
        messages = BagReader(RECORDED).messages([topic])
        without |= {(topic, number) for number, (_, each, _) in enumerate(messages) if stamp_of(each) in late}
    found = verify(copy(tmp_path / "bag", without=without))
    assert (found.frames, found.lost_frames) == (FRAMES - 7, 0)
    assert [*found.unfinished_steps.values()] == [(5, 12)]
    assert "step 2 of tiny: no successful end recorded, 5 of 12 frames" in list(verification_sentences(found))


def test_two_measurements_of_a_step_number_are_not_complete(tmp_path):
    found = verify(repeat(tmp_path / "twice"))
    assert found.repeated_steps == [("tiny", 0), ("tiny", 1), ("tiny", 2)]
    assert not found.complete
    assert "step 1 of tiny: measured more than once under this number" in list(verification_sentences(found))
    assert verify(repeat(tmp_path / "copied", seconds=0)).repeated_steps == []
    assert verify(repeat(tmp_path / "other", renamed=b"next")).complete


@pytest.mark.parametrize("split", [Split(), Split(size=150_000)])
@pytest.mark.parametrize("after", [0.3, 0.7])
def test_clock_that_was_set_back_is_damage(tmp_path, after, split):
    bag = set_back(tmp_path / "bag", after=after, seconds=6, split=split)
    found = verify(bag)
    assert re.fullmatch(r"the clock was set back by (5\.\d|6\.0) s at [\d :-]+ UTC; order .* are wrong", found.damage)
    assert not found.complete
    assert found.damage in content_sentences(info(bag))[-1]
    (bag / "metadata.yaml").unlink()
    assert found.damage == BagReader(bag).damage


def test_clock_that_was_set_back_within_a_chunk_is_found_by_the_messages(tmp_path):
    set_back(tmp_path / "bag", after=0.5, seconds=6)
    recover(tmp_path / "bag", tmp_path / "recovered")  # writes few chunks
    found = verify(tmp_path / "recovered")
    assert "the clock was set back by" in found.damage
    assert not found.complete


def test_chunks_may_overlap_by_less_than_a_second(tmp_path):
    assert verify(set_back(tmp_path / "bag", after=0.5, seconds=0.9)).damage == ""


def reordered(target, order, **options):
    """Write a file of the recording in another order, as other programs do."""
    reader = BagReader(RECORDED)
    with target.open("wb") as stream:
        writer = Writer(stream, **{"chunk_size": 100_000, **options})
        writer.start("ros2")
        channels = {}
        for topic in reader.topics.values():
            schema = writer.register_schema(topic.type_name, topic.encoding, topic.definition.encode())
            about = {"offered_qos_profiles": topic.qos}
            channels[topic.name] = writer.register_channel(topic.name, "cdr", schema, about)
        for topic, data, log_time, publish_time, number in order([*reader.stored()]):
            writer.add_message(channels[topic], log_time, data, publish_time, number)
        writer.finish()
    return target


def in_halves(messages):
    return messages[len(messages) // 2 :] + messages[: len(messages) // 2]


def shuffled(messages):
    random = Random(1)
    return sorted(messages, key=lambda each: each.log_time + random.uniform(0, 0.3e9))


ORDERS = {
    "topic after topic": lambda messages: sorted(messages, key=lambda each: each.topic),
    "second half first": in_halves,
    "shuffled": shuffled,
    "merged with a copy": lambda messages: [each for one in messages for each in (one, one)],
}


@pytest.mark.parametrize("order", ORDERS.values(), ids=ORDERS)
def test_order_of_the_file_says_nothing_about_time(tmp_path, order):
    found = verify(reordered(tmp_path / "other.mcap", order))
    assert (found.complete, found.frames, found.gaps, found.damage) == (True, FRAMES, {}, "")
    assert BagReader(tmp_path / "other.mcap").damage == ""


@pytest.mark.parametrize("order", ORDERS.values(), ids=ORDERS)
def test_losses_are_counted_in_every_order(tmp_path, order):
    samples = [each for each in BagReader(RECORDED).stored() if each.topic == LOAD]
    lost = {*samples[100:130], samples[700]}
    found = verify(
        reordered(tmp_path / "other.mcap", lambda messages: order([each for each in messages if each not in lost]))
    )
    assert (found.gaps, found.frames, found.damage) == ({LOAD: 31}, FRAMES, "")


def test_without_numbers_missing_messages_cannot_be_known(tmp_path):
    def thinned(messages):
        kept = [each for each in messages if each.topic != LOAD or each.log_time % 3]
        return [each._replace(sequence=0) for each in kept]

    found = verify(reordered(tmp_path / "other.mcap", thinned))
    assert not found.complete
    assert found.uncounted == sorted({IMAGE, EXPOSURE, STEP, LOAD, "/rig/camera/camera_info"})
    [line] = [line for line in verification_sentences(found) if line.startswith("publishers' counts")]
    assert "cannot be known" in line
    assert "no message is missing" not in line
    assert (found.frames, found.lost_frames) == (FRAMES, 0)


def test_frames_of_a_free_run_belong_to_no_step(tmp_path):
    """Their records state no experiment and no number of frames."""
    reader = BagReader(RECORDED)
    topic = reader.topics[EXPOSURE]
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(topic.definition, topic.type_name))
    with BagWriter(tmp_path / "bag") as writer:
        for each in (EXPOSURE, IMAGE):
            writer.add_recorded_topic(reader.topics[each])
        for message in reader.stored():
            if message.topic == EXPOSURE:
                record = reader.decode(EXPOSURE, message.data)
                record.experiment, record.step, record.count = "", 0, 0
                message = message._replace(data=bytes(store.serialize_cdr(record, topic.type_name)))
            if message.topic in (EXPOSURE, IMAGE):
                writer.write(*message)
    found = verify(tmp_path / "bag")
    assert (found.frames, found.lost_frames, found.unfinished_steps) == (FRAMES, 0, {})


def test_changed_file_is_named_although_its_messages_are_intact(tmp_path):
    bag = copy(tmp_path / "bag")
    file = bag / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    data[10] ^= 1  # in the header of the file, which no checksum covers
    file.write_bytes(data)
    found = verify(bag)
    assert (found.manifest.changed, found.damage, found.lost_frames) == (("bag_0.mcap",), "", 0)
    assert not found.complete
    assert "files: bag_0.mcap has changed since the recording was closed" in list(verification_sentences(found))


def test_missing_file_of_a_split_recording(tmp_path):
    bag = copy(tmp_path / "bag", split=Split(size=200_000))
    (bag / "bag_1.mcap").unlink()
    found = verify(bag)
    assert found.manifest.missing == ("bag_1.mcap",)
    assert "bag_1.mcap is missing" in found.damage
    assert found.lost_frames > 0
    assert found.frames + found.lost_frames == FRAMES


@pytest.mark.parametrize("place", [0, 66, -30])
def test_damaged_manifest_is_reported(tmp_path, place):
    bag = copy(tmp_path / "bag")
    data = bytearray((bag / "manifest.sha256").read_bytes())
    data[place] = 0xFF
    (bag / "manifest.sha256").write_bytes(data)
    found = verify(bag)
    assert not found.manifest.fits
    assert not found.complete


@pytest.mark.parametrize("kept", ["", "bag_0.mcap", "metadata.yaml"])
def test_file_that_the_manifest_does_not_list_is_named(tmp_path, kept):
    bag = copy(tmp_path / "bag")
    lines = (bag / "manifest.sha256").read_text().splitlines(keepends=True)
    (bag / "manifest.sha256").write_text("".join(line for line in lines if kept and kept in line))
    unlisted = tuple(name for name in ("bag_0.mcap", "metadata.yaml") if name != kept)
    found = verify(bag)
    assert found.manifest.unlisted == unlisted
    assert not found.complete
    assert f"{unlisted[-1]} is not listed in manifest.sha256" in " ".join(verification_sentences(found))


@pytest.mark.parametrize("list_of_files", ["manifest.sha256", "metadata.yaml"])
def test_file_of_another_recording_is_named(tmp_path, list_of_files):
    bag = copy(tmp_path / "bag")
    shutil.copy(bag / "bag_0.mcap", bag / "bag_0 (copy).mcap")
    if list_of_files == "metadata.yaml":
        (bag / "manifest.sha256").unlink()
    found = verify(bag)
    assert not found.complete
    assert f"bag_0 (copy).mcap is not listed in {list_of_files}" in " ".join(verification_sentences(found))
    line = "not listed in metadata.yaml, but read: bag_0 (copy).mcap; remove other recordings"
    assert line in content_sentences(info(bag))
    assert line in content_sentences(recover(bag))
    assert not any("not listed" in each for each in content_sentences(info(RECORDED)))


def test_file_is_named_if_the_metadata_list_none(tmp_path):
    bag = copy(tmp_path / "bag")
    (bag / "manifest.sha256").unlink()
    content = yaml.safe_load((bag / "metadata.yaml").read_text())
    content["rosbag2_bagfile_information"]["relative_file_paths"] = []
    (bag / "metadata.yaml").write_text(yaml.safe_dump(content))
    assert verify(bag).manifest.unlisted == ("bag_0.mcap",)


@pytest.mark.parametrize("size", [0, 3, 8])
def test_frames_of_a_file_that_was_cut_off_at_its_begin_are_lost(tmp_path, size):
    bag = copy(tmp_path / "bag")
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:size])
    assert last_line(bag) == "0 of 36 frames, 36 lost"


def test_file_with_nothing_but_its_first_bytes_is_not_closed(tmp_path):
    file = copy(tmp_path / "bag") / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:8])
    assert "not closed" in verify(file).damage


def write_other(file, qos="", **options):
    """Write a file of another recorder: ten messages of one topic in one chunk."""
    with file.open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start("ros2")
        schema = writer.register_schema("bench_msgs/msg/Force", "ros2msg", b"uint8 newton")
        channel = writer.register_channel("/force", "cdr", schema, {"offered_qos_profiles": qos})
        for number in range(10):
            writer.add_message(channel, number, bytes([0, 1, 0, 0, number]), number, number)
        writer.finish()
    return file


def test_chunks_without_checksum_are_counted(tmp_path):
    found = verify(write_other(tmp_path / "other.mcap", enable_crcs=False))
    assert (found.unchecked, found.damage, found.complete) == (1, "", False)
    assert "chunks: 1 chunk has no checksum and no manifest.sha256: " in " ".join(verification_sentences(found))
    found = verify(write_other(tmp_path / "other.mcap"))
    assert "chunks: all fit their checksums" in list(verification_sentences(found))


def test_chunks_without_checksum_are_confirmed_by_the_manifest(tmp_path):
    file = write_other(tmp_path / "other.mcap", enable_crcs=False)
    write_manifest(tmp_path, {file.name: sha256(file.read_bytes()).hexdigest()})
    found = verify(tmp_path)
    assert (found.unchecked, found.complete) == (1, True)
    assert "chunks: 1 chunk has no checksum" in list(verification_sentences(found))
    write_manifest(tmp_path, {})
    assert not verify(tmp_path).complete


@pytest.mark.parametrize(
    "qos",
    [
        "{",
        "abc",
        "5",
        "- 5",
        "*a",
        "- !!int ''",
        "- durability: 2026-02-30",
        "[" * 40_000,
        "- " + "{a: " * 400 + "}" * 400,
    ],
    ids=lambda qos: qos[:20],
)
def test_unreadable_qos_of_another_recorder_is_ignored(tmp_path, qos):
    file = write_other(tmp_path / "other.mcap", qos)
    assert verify(file).complete
    assert recover(file).messages == 10


def test_damaged_chunk_costs_the_frames_in_it(tmp_path):
    bag = copy(tmp_path / "bag")
    file = bag / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0xFF
    file.write_bytes(data)
    found = verify(bag)
    assert "1 chunk left out" in found.damage
    assert found.frames + found.lost_frames == FRAMES
    missing = BagReader(bag, check=True).missing
    assert 1 <= missing[IMAGE] <= found.lost_frames <= missing[IMAGE] + missing[EXPOSURE]


def test_recording_without_camera(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_recorded_topic(BagReader(RECORDED).topics[LOAD])
    assert last_line(tmp_path / "bag") == "0 of 0 frames, 0 lost"
