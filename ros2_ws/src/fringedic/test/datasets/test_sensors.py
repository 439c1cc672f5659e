"""A recording of several sensors is read by the name of one; one sensor needs no name."""

from __future__ import annotations

from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fringedic.command import evaluations as _evaluations  # noqa: F401 (has the subcommand)
from fringedic.command import recordings  # noqa: F401 (has the subcommands)
from fringedic.command.app import app
from fringedic.datasets import open_experiment, process_bag
from fringedic.datasets.opening import find_dataset
from fringedic.errors import CalibrationError, ConfigurationError, DatasetError, RecordingError
from fringedic.evaluation.named import evaluations, preview
from fringedic.recording import BagReader, BagWriter, Topic
from fringedic.recording.verification import verify
from fringedic.report.page_server.evaluations import Evaluations
from fringedic.report.processing_entries import changes_text
from fringedic.rig.model import RigModel

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"
EXPOSURE = "fringedic_msgs/msg/Exposure"
SHARED = "/rig/load_frame/state"
RIGHT_STEPS = {0, 1}


def merge(target: Path, *names: str) -> Path:
    """Merge recordings of the same rig under the names of sensors; the one on the right has the first two steps."""
    reader = BagReader(RECORDED)
    recorded = reader.topics["/rig/camera/exposure"].definition
    definition = recorded.replace("string experiment\n", "string sensor\nstring experiment\n", 1)
    assert definition != recorded
    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_msg(definition, EXPOSURE))

    def named(message: object, sensor: str) -> bytes:
        fields = {
            name: getattr(message, name) for name in types.types[EXPOSURE].__dataclass_fields__ if name != "sensor"
        }
        return bytes(types.serialize_cdr(types.types[EXPOSURE](sensor=sensor, **fields), EXPOSURE))

    with BagWriter(target) as writer:
        for sensor in names:
            for name, topic in reader.topics.items():
                if name != SHARED:
                    text = definition if topic.type_name == EXPOSURE else topic.definition
                    own = Topic(_own(name, sensor), topic.type_name, text, topic.encoding, "", topic.qos)
                    writer.add_recorded_topic(own)
        if SHARED in reader.topics:
            writer.add_recorded_topic(reader.topics[SHARED])
        for raw in reader.stored():
            if raw.topic == SHARED:
                writer.write(*raw)
                continue
            message = reader.decode(raw.topic, raw.data)
            for sensor in names:
                of_a_step = hasattr(message, "experiment")
                if sensor == "right" and of_a_step and message.step not in RIGHT_STEPS:
                    continue
                data = named(message, sensor) if reader.topics[raw.topic].type_name == EXPOSURE else raw.data
                writer.write(_own(raw.topic, sensor), data, raw.log_time, raw.publish_time, raw.sequence)
    return target


def _own(topic: str, sensor: str) -> str:
    return topic.replace("/rig/", f"/rig/{sensor}/", 1)


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return merge(tmp_path_factory.mktemp("both") / "bag", "left", "right")


def test_each_sensor_is_measured_from_its_own_frames_into_a_dataset_of_its_own(both: Path, tmp_path: Path) -> None:
    left, right = (process_bag(both, sensor=sensor, overwrite=True) for sensor in ("left", "right"))
    assert (left.name, right.name) == ("bag.left.nc", "bag.right.nc")
    windows = process_bag(both, sensor="left", steps=[100], every_frame=True, overwrite=True)
    assert windows.name == "bag.left.every-frame.nc"
    alone = process_bag(RECORDED, output=tmp_path / "alone.nc")
    with open_experiment(both, sensor="left") as found, open_experiment(alone) as expected:
        assert (found.attrs.pop("sensor"), expected.attrs.pop("sensor")) == ("left", "sensor")
        assert found.attrs.pop("source_bytes") != expected.attrs.pop("source_bytes")
        rigs = [dataset.attrs.pop("calibration") for dataset in (found, expected)]
        assert rigs[0] == rigs[1]
        assert found.load().identical(expected.load())
    with open_experiment(both, sensor="right") as found:
        assert (found.attrs["sensor"], found.step.values.tolist()) == ("right", sorted(RIGHT_STEPS))
    words = r"^\S+/bag contains the sensors left, right: choose one, for example with --sensor left$"
    with pytest.raises(DatasetError, match=words):
        open_experiment(both)
    with pytest.raises(DatasetError, match=r"bag.left.nc is the dataset of the sensor 'left'; give that of 'right'"):
        open_experiment(left, sensor="right")


def test_without_a_choice_a_recording_of_two_sensors_is_refused_in_one_sentence(
    both: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = "bag contains the sensors left, right: choose one, for example with --sensor left"
    with pytest.raises(RecordingError, match=words):
        process_bag(both, output=tmp_path / "new.nc")
    with pytest.raises(RecordingError, match="bag contains no sensor 'top', it contains left, right: choose one"):
        BagReader(both, sensor="top")
    with pytest.raises(RecordingError, match=words):
        app(["process", str(both)], standalone_mode=False)
    with pytest.raises(ConfigurationError, match="--every-frame are of one sensor: choose it with --sensor"):
        app(["process", str(both), "--registration", "poses.yaml", "--every-frame"], standalone_mode=False)
    app(["info", str(both)], standalone_mode=False)
    assert words in " ".join(capsys.readouterr().out.split())


def test_topics_are_those_of_the_chosen_sensor_or_of_no_other(both: Path) -> None:
    names = BagReader(both, sensor="right").find_optional("camera/exposure", "load_frame/state", "calibration")
    assert names["camera/exposure"] == "/rig/right/camera/exposure"
    assert names.get("load_frame/state", SHARED) == SHARED


def test_the_same_step_of_two_sensors_was_not_measured_twice(both: Path) -> None:
    assert verify(both).repeated_steps == []


def test_the_only_sensor_needs_no_choice(tmp_path: Path) -> None:
    bag = merge(tmp_path / "run" / "bag", "left")
    file = process_bag(bag, output=tmp_path / "run" / "results.left.nc")
    for place in (bag, bag.parent):
        with open_experiment(place) as dataset:
            assert Path(dataset.encoding["source"]) == file
    with pytest.raises(CalibrationError, match="is that of the sensor 'sensor', this is the sensor 'left'"):
        process_bag(bag, output=tmp_path / "other.nc", calibration=_calibration())
    (tmp_path / "run" / "bag.old.nc").symlink_to(file)  # of a person: the name is not that of its sensor
    assert find_dataset(bag) == file


def _calibration() -> RigModel:
    reader = BagReader(RECORDED)
    [topic] = reader.find("calibration").values()
    return RigModel.from_message(next(reader.messages([topic]))[1])


def test_an_evaluation_of_one_of_two_sensors_is_listed_and_made(both: Path) -> None:
    run = both.parent
    for sensor in ("left", "right"):
        process_bag(both, output=run / f"results.{sensor}.nc", sensor=sensor)
    page = Evaluations(lambda: "")
    assert page.listed(run)["sensors"] == ["left", "right"]
    assert page.listed(run)["sensor"] == "left"
    assert page.listed(run, "right")["steps"] == sorted(RIGHT_STEPS)
    app(["evaluate", str(run), "--name", "fine", "--sensor", "right", "--set", "dic.window=40"], standalone_mode=False)
    [made] = evaluations(run)
    assert changes_text(made.settings) == "sensor right; dic.window = 40"
    with open_experiment(made.dataset) as found:
        assert (found.attrs["sensor"], found.step.values.tolist()) == ("right", sorted(RIGHT_STEPS))
    before, _ = preview(run, made.settings, max(RIGHT_STEPS))
    assert before.attrs["sensor"] == "right"
    page.close()
