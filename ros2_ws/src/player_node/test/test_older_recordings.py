"""Recordings of older versions: their messages are played in the present definitions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rclpy.serialization import deserialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fringedic.recording.decoding import decode
from fringedic.recording.definitions import interface_definition
from fringedic.recording.reader import BagReader
from fringedic.recording.topics import Topic
from fringedic.recording.writer import BagWriter
from fringedic.rig.model import RigModel
from fringedic.virtual_rig import VirtualRig
from fringedic_msgs.msg import RigCalibration
from fringedic_ros.topics import RAW_TOPICS
from player_node.recorded_steps import recorded_messages

RECORDED = Path(__file__).parents[2] / "fringedic" / "test" / "recordings" / "version_0_1" / "bag"
KIND = "fringedic_msgs/msg/RigCalibration"


def test_a_calibration_without_distortion_fields(tmp_path: Path) -> None:
    model = RigModel(**VirtualRig.from_preset("plate", size="tiny").optics(), identifier="of old")
    definition = "\n".join(line for line in interface_definition(KIND).splitlines() if " distortion_" not in line)
    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_msg(definition, KIND))
    stamp = types.types["builtin_interfaces/msg/Time"](sec=7, nanosec=8)
    header = types.types["std_msgs/msg/Header"](stamp=stamp, frame_id="reference_plane")
    fields = model.message_fields()
    arrays = ("projector_position", "projector_rotation", "covariance")
    fields |= {name: np.asarray(fields[name], float) for name in arrays}
    data = bytes(types.serialize_cdr(types.types[KIND](header=header, **fields), KIND))
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_recorded_topic(Topic("/rig/calibration", KIND, definition, "ros2msg", "RIHS01_old", ""))
        bag.write("/rig/calibration", data, 1, 1)

    [message] = recorded_messages(BagReader(tmp_path / "bag"), {"/rig/calibration": "calibration"})
    played = deserialize_message(message.data, RigCalibration)
    assert message.topic == "calibration"
    assert (played.header.stamp.sec, played.header.stamp.nanosec) == (7, 8)
    assert RigModel.from_message(played) == model


def test_messages_of_the_first_version_have_the_present_definitions() -> None:
    bag = BagReader(RECORDED)
    names = {full: name for name, full in bag.find_optional(*RAW_TOPICS).items()}
    types = {name: bag.topics[full].type_name for full, name in names.items()}
    for message in recorded_messages(bag, names):
        kind = types[message.topic]
        if kind.startswith("fringedic_msgs/"):
            decode(Topic("", kind, interface_definition(kind), "ros2msg", "", ""), message.data, RECORDED)
