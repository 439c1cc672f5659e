"""The files of a split recording are measured as one; two measurements in one recording are not."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from fringedic.datasets import open_experiment, process_bag
from fringedic.datasets.attributes import recorded_metadata
from fringedic.datasets.timeline import Timeline
from fringedic.errors import ConfigurationError, DatasetError
from fringedic.recording import BagReader, BagWriter, Split, verify
from fringedic.recording.frames import frames
from fringedic.recording.latched import LatchedMessages
from fringedic.report.data import ReportData
from fringedic.report.warnings import warnings
from fringedic.steps.recorded_rig import require_reference

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


def test_every_file_begins_with_settings_and_calibration(split, tmp_path):
    """The messages of the whole are those of one file; without the first file nothing but its frames is missing."""
    whole = BagReader(RECORDED)
    assert [*BagReader(split).raw()] == [*whole.raw()]
    repeated = [topic for topic in whole.topics if topic.endswith(("parameters", "calibration", "reference"))]
    for file in sorted(split.glob("*.mcap")):
        assert {raw.data for raw in BagReader(file).raw(repeated)} == {raw.data for raw in whole.raw(repeated)}
    assert verify(split).complete
    (split / "bag_0.mcap").unlink()
    with open_experiment(process_bag(split, output=tmp_path / "new.nc", reference=2)) as found:
        assert "missing_settings" not in found.attrs
        process_bag(RECORDED, output=tmp_path / "whole.nc", reference=2)
        with open_experiment(tmp_path / "whole.nc") as one:
            last, expected = found.isel(step=[-1]), one.sel(step=[2])
            assert last.attrs["parameters"] == expected.attrs["parameters"]
            assert last.force.values.tolist() == expected.force.values.tolist()
            assert np.array_equal(last.shape_z, expected.shape_z, equal_nan=True)


def test_parameters_of_a_node_are_repeated_as_last_set():
    """A node that changes its parameters often displaces those of no other node."""
    reader = BagReader(RECORDED)
    topic = reader.topics["/rig/node_parameters"]
    latched = LatchedMessages()
    latched.add_topic(topic)
    messages = [*reader.raw([topic.name])]
    for message in messages:
        latched.keep(message)
    changed = next(each for each in messages if reader.decode(topic.name, each.data).node == "dic")
    for number in range(200):
        latched.keep(changed._replace(data=changed.data[:4] + number.to_bytes(4, "little") + changed.data[8:]))
    kept = [reader.decode(topic.name, each.data) for each in latched.messages()]
    assert len(kept) == len(messages)
    assert next(each for each in kept if each.node == "dic").header.stamp.sec == 199


def filtered(target, *, without=(), begins=None, without_node=None):
    """Write the recording without some topics, and only from a step on."""
    reader = BagReader(RECORDED)
    kept = begins is None
    with BagWriter(target) as writer:
        for topic in reader.topics.values():
            if not topic.name.endswith(tuple(without)):
                writer.add_recorded_topic(topic)
        for message in reader.stored():
            decoded = reader.decode(message.topic, message.data)
            latched = message.topic.endswith(("reference", "calibration", "node_parameters"))
            kept = kept or (message.topic.endswith("experiment/step") and decoded.step >= begins)
            wanted = not message.topic.endswith("node_parameters") or decoded.node != without_node
            if (kept or latched) and wanted and not message.topic.endswith(tuple(without)):
                writer.write(*message)
    return target


def test_sign_and_tare_are_refused_where_they_are_unknown(tmp_path):
    bag = filtered(tmp_path / "bag", without=["node_parameters"])
    options = "--set specimen.force_sign=... --set specimen.force_tare_newton=..."
    with pytest.raises(DatasetError, match=re.escape(options)):
        process_bag(bag, output=tmp_path / "new.nc")
    with pytest.raises(DatasetError, match=r"give them: --set specimen.force_tare_newton=\.\.\.$"):
        process_bag(bag, output=tmp_path / "new.nc", overrides={"specimen.force_sign": -1})
    given = {"specimen.force_sign": -1, "specimen.force_tare_newton": 10.0}
    process_bag(bag, output=tmp_path / "new.nc", overrides=given)
    process_bag(RECORDED, output=tmp_path / "whole.nc")
    with open_experiment(tmp_path / "new.nc") as found, open_experiment(tmp_path / "whole.nc") as whole:
        assert found.force.values == pytest.approx(10.0 - whole.force.values)
        assert recorded_metadata(found).specimen.force_sign == -1
        assert json.loads(found.attrs["missing_settings"]) == ["phase", "dic", "coupling", "experiment"]
        assert "missing_settings" not in whole.attrs
        assert any("the settings of phase, dic" in each for each in warnings(ReportData(found, None, None), [], []))


@pytest.mark.parametrize("entry", ["specimen.force_sign", "specimen.colour"])
def test_entry_of_the_specimen_that_is_not_allowed_is_named(tmp_path, entry):
    with pytest.raises(ConfigurationError, match=entry):
        process_bag(RECORDED, output=tmp_path / "new.nc", overrides={entry: 5})


def test_settings_of_one_node_that_are_missing_are_named(tmp_path):
    bag = filtered(tmp_path / "bag", without_node="dic")
    with open_experiment(process_bag(bag, output=tmp_path / "new.nc")) as found:
        assert json.loads(found.attrs["missing_settings"]) == ["dic"]


def test_tare_of_a_first_step_that_is_missing_is_refused(tmp_path):
    bag = filtered(tmp_path / "bag", begins=1)
    tare = {"specimen.force_tare_newton": "first_step"}
    with pytest.raises(DatasetError, match=r"the first step, whose force is the tare, is missing"):
        process_bag(bag, output=tmp_path / "new.nc", reference=1, overrides=tare)


def test_reference_is_refused_where_it_is_unknown_or_missing(tmp_path):
    unknown = filtered(tmp_path / "unknown", without=["experiment/reference"])
    with pytest.raises(DatasetError, match=r"is not recorded .*give one of the steps 0, 1, 2: --reference STEP"):
        process_bag(unknown, output=tmp_path / "new.nc")
    missing = filtered(tmp_path / "missing", begins=1)
    with pytest.raises(DatasetError, match=r"the reference step 0 is missing; .*give one of the steps 1, 2"):
        process_bag(missing, output=tmp_path / "new.nc")
    with open_experiment(process_bag(missing, output=tmp_path / "new.nc", reference=1)) as found:
        assert found.reference_step.values.tolist() == [1, 1]


def test_reference_that_the_recorder_received_after_the_first_frames_is_known(tmp_path):
    """It was published before them; on a busy computer topics overtake each other on their way into the recording."""
    reader = BagReader(RECORDED)
    with BagWriter(tmp_path / "bag") as writer:
        for topic in reader.topics.values():
            writer.add_recorded_topic(topic)
        last = max(message.log_time for message in reader.stored())
        for message in reader.stored():
            late = message.topic.endswith("experiment/reference")
            writer.write(*message._replace(log_time=last if late else message.log_time))
    require_reference(BagReader(tmp_path / "bag"))
    with open_experiment(process_bag(tmp_path / "bag", output=tmp_path / "new.nc")) as found:
        assert found.reference_step.values.tolist() == [0, 0, 0]


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
