"""Messages whose bytes are wrong in every way; a node may ignore them or say so, but lives on and answers.

Long form: ``python tests/fuzzed_messages.py 100000 RECORDING [SEED]``, messages for every node.
"""

from __future__ import annotations

import itertools
import os
import random
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import rclpy
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Image

from fringedic.datasets.processing import process_bag
from fringedic.errors import FringedicError, RecordingError
from fringedic.recording import BagReader, BagWriter
from fringedic_bringup.launch.environment import node_environment, private_domain
from fringedic_msgs.msg import Exposure, StepStatus
from fringedic_ros.qos import EVENTS, IMAGES
from fringedic_ros.serialized import message_type
from fringedic_ros.testing import NodeProcess, Peer

VIRTUAL = '"{preset: plate, size: tiny}"'
# module and parameters of every node that subscribes to something
NODES: dict[str, tuple[str, dict[str, Any]]] = {
    "camera": ("camera_node.camera_node", {"virtual_rig": VIRTUAL}),
    "live_view": ("camera_node.live_view_node", {"maximum_rate_hz": 1000.0}),
    "phase": ("phase_node.phase_node", {}),
    "dic": ("dic_node.dic_node", {}),
    "extensometer": ("dic_node.extensometer_node", {}),
    "coupling": ("coupling_node.coupling_node", {}),
    "experiment": ("experiment_node.experiment_node", {}),
    "recorder": ("recorder_node.recorder_node", {}),
}
# the recorder reads what is published; of these it looks into the messages
RECORDED = [
    ("/camera/image_raw", Image, IMAGES),
    ("/camera/exposure", Exposure, IMAGES),
    ("/experiment/step", StepStatus, EVENTS),
]
OWN_TOPICS = ("/parameter_events", "/rosout")
LONGEST_MESSAGE = 500
BATCH = 50  # messages between two questions whether the node still answers
EXTREMES = (b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\x00\x00\x00\x80", b"\x00\x00\xc0\x7f", b"\x00\x00\x80\x7f")


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Return a serialised message with wrong bits, fewer bytes, other bytes, or a number at its extreme."""
    changed, kind = bytearray(data), rng.random()
    # the first fields are more likely to matter than one of many pixels
    end = min(len(data), 200) if rng.random() < 0.7 else len(data)
    if kind < 0.4:
        for _ in range(rng.randint(1, 4)):
            changed[rng.randrange(end)] ^= 1 << rng.randrange(8)
    elif kind < 0.6:
        del changed[rng.randrange(end) :]
    elif kind < 0.7:
        changed[4:] = rng.randbytes(rng.randrange(200))
    else:
        position = 4 * rng.randrange(max(1, end // 4))
        changed[position : position + 4] = rng.choice(EXTREMES)
    return bytes(changed)


def recorded_messages(path: Path, most: int = 40) -> dict[str, list[bytes]]:
    """Return the first serialised messages of each topic of a recording, by its name without the rig's namespace."""
    found: dict[str, list[bytes]] = {}
    for message in BagReader(path).raw():
        samples = found.setdefault(message.topic.removeprefix("/rig"), [])
        if len(samples) < most:
            samples.append(message.data)
    return found


def fuzz(name: str, count: int, samples: Mapping[str, list[bytes]], folder: Path, seed: int = 1) -> str:
    """Send damaged messages to every topic that a node reads; return its log.

    Raises
    ------
    AssertionError
        The node ended, no longer answers, or a callback of it failed.
    """
    module, parameters = NODES[name]
    if name == "recorder":
        parameters = {"bag_path": str(folder / "bag")}
    rng = random.Random(seed)
    peer = Peer()
    try:
        with NodeProcess(module, folder, parameters) as node:
            peer.meet(name)
            peer.wait(lambda: name in peer.get_node_names(), name)
            topics = RECORDED if name == "recorder" else _topics_of(peer, name)
            targets = [(topic, kind, peer.create_publisher(kind, topic, qos)) for topic, kind, qos in topics]
            for topic, _, publisher in targets:
                peer.wait(publisher.get_subscription_count, topic)
            for sent in range(count):
                topic, kind, publisher = rng.choice(targets)
                valid = rng.choice(samples.get(topic) or [serialize_message(kind())])
                publisher.publish(valid if rng.random() < 0.1 else damaged(valid, rng))
                if sent % BATCH == BATCH - 1:
                    assert node.process.poll() is None, f"{name} ended:\n{node.log}"
                    peer.meet(name)
        assert "Traceback" not in node.log, node.log
        return node.log
    finally:
        peer.destroy_node()


def _topics_of(peer: Peer, name: str) -> list[tuple[str, type, QoSProfile]]:
    """Return the topics that a node reads, with their types and a compatible quality of service."""
    topics = []
    for topic, (type_name, *_) in peer.get_subscriber_names_and_types_by_node(name, "/"):
        if topic not in OWN_TOPICS:
            (read,) = [each for each in peer.get_subscriptions_info_by_topic(topic) if each.node_name == name]
            asked = read.qos_profile
            qos = QoSProfile(depth=BATCH, reliability=asked.reliability, durability=asked.durability)
            topics.append((topic, message_type(type_name), qos))
    return topics


def fuzz_decoding(path: Path, count: int, seed: int = 1) -> Counter[str]:
    """Decode damaged messages as the library does; return how many were read and refused.

    Raises
    ------
    Exception
        Another error than `RecordingError`.
    """
    bag, rng = BagReader(path), random.Random(seed)
    messages = list(itertools.islice(bag.raw(), 400))
    outcomes: Counter[str] = Counter()
    for _ in range(count):
        message = rng.choice(messages)
        try:
            bag.decode(message.topic, damaged(message.data, rng))
            outcomes["read"] += 1
        except RecordingError as error:
            outcomes["refused" if len(str(error)) <= LONGEST_MESSAGE else "refused at length"] += 1
    return outcomes


def with_a_damaged_message(path: Path, copy: Path, seed: int) -> Path:
    """Copy a recording; one message of one topic is damaged, the files themselves are whole."""
    bag, rng = BagReader(path), random.Random(seed)
    chosen = rng.choice([topic for topic, count in bag.counts.items() if count])
    index = rng.randrange(bag.counts[chosen])
    with BagWriter(copy) as writer:
        for topic in bag.topics.values():
            writer.add_recorded_topic(topic)
        for each in bag.stored():
            data = each.data
            if each.topic == chosen:
                data = damaged(data, rng) if index == 0 else data
                index -= 1
            writer.write(each.topic, data, log_time=each.log_time, publish_time=each.publish_time)
    return copy


def fuzz_processing(path: Path, copies: int, folder: Path) -> Counter[str]:
    """Process copies of a recording with a damaged message each; return how many were processed and refused.

    Raises
    ------
    Exception
        Another error than a named one.
    """
    outcomes: Counter[str] = Counter()
    for seed in range(copies):
        copy = with_a_damaged_message(path, folder / f"copy_{seed}", seed)
        try:
            process_bag(copy, output=folder / "results.nc", overwrite=True)
            outcomes["processed"] += 1
        except FringedicError as error:
            outcomes["refused" if len(str(error)) <= LONGEST_MESSAGE else "refused at length"] += 1
        shutil.rmtree(copy)
    return outcomes


def main() -> None:
    """Fuzz all nodes, the reader and the processing."""
    count, recording, seed = int(sys.argv[1]), Path(sys.argv[2]), int((*sys.argv, 1)[3])
    samples = recorded_messages(recording)
    with tempfile.TemporaryDirectory() as folder:
        sys.stdout.write(f"reader: {dict(fuzz_decoding(recording, count, seed))}\n")
        sys.stdout.write(f"processing: {dict(fuzz_processing(recording, count // 1000, Path(folder)))}\n")
    with private_domain() as domain, tempfile.TemporaryDirectory() as folder:
        os.environ.update(node_environment(domain))
        rclpy.init()
        for name in NODES:
            log = fuzz(name, count, samples, Path(folder), seed)
            own = [line for line in log.splitlines() if f"[{name}]" in line]
            sys.stdout.write(f"{name}: {count} messages, lives and answers; {len(own)} lines of its own\n")
            sys.stdout.writelines(
                f"    {line[:200]}\n" for line in sorted({line.split("]: ")[-1] for line in own})[:10]
            )
        rclpy.shutdown()


if __name__ == "__main__":
    main()
