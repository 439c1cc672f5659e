"""Records the raw topics of a rig, and the derived ones on request, as they come over the wire."""

from __future__ import annotations

import os
import queue
import shutil
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from experiment_node.messages import header_stamp, message_type
from experiment_node.tally import ExposureTally
from experiment_node.topics import DERIVED_TOPICS, EXPOSURE, IMAGE, RAW_TOPICS, SAMPLE_TOPICS, STEP
from fringedic.errors import DiskFullError, FringedicError
from fringedic.recording import BagWriter, Qos
from fringedic_msgs.msg import RecorderStatus, StepStatus
from fringedic_ros.main import run
from fringedic_ros.parameters import declare
from fringedic_ros.qos import LATCHED, SAMPLES

DISCOVERY_PERIOD_S = 0.1
# Between the middleware and the disk: 13 s of 30 images/s of 1.2 MB.
BACKLOG_BYTES = 512_000_000
# Both outlast a recorder that gets no processor for a while: images for four seconds, samples at 1 kHz for ten.
RECORDING_DEPTH = SAMPLES.depth
AT_ONCE = 100  # messages of one topic, before the others get their turn
# A turn of the executor costs as much as ten samples: of a machine that gives a thousand in a second, some at a time.
GATHERED_S = 0.002
IMAGE_DEPTH = 128
# Of the thread that compresses and writes: measuring a step is more urgent.
NICENESS = 5

Message = tuple[
    str, bytes, int, int, int | None
]  # topic, data, time of receipt and of publishing [ns], sequence number


class RecorderParameters(BaseModel):
    """Parameters of the recorder."""

    model_config = ConfigDict(frozen=True)

    bag_path: str = Field("", description="Folder of the recording, must not exist yet; empty: nothing is recorded.")
    derived: bool = Field(False, description="Record phase, displacement and clouds too, not only raw topics.")
    compression: Literal["none", "zstd"] = Field("none", description="Compression of the recording.")
    flush_interval_s: float = Field(
        0.5, gt=0, le=60, description="What was received longer ago survives a kill of the recorder [s]."
    )
    smallest_free_mb: float = Field(
        100.0, ge=0, le=1e6, description="With less free on the disk the recording is closed in time [MB]."
    )


class RecorderNode(Node):
    """Subscribes to every topic that belongs in a recording as soon as somebody publishes it.

    Messages are taken as serialised bytes and written unchanged by a thread of their own; only the header stamp of
    images and exposures and the stage of steps are looked at. A failure to write ends the recording, not the node.
    """

    def __init__(self) -> None:
        super().__init__("recorder")
        self.parameters = declare(self, RecorderParameters)
        self._subscriptions_by_topic: dict[str, Subscription] = {}
        self._refused: set[str] = set()
        self._tally = ExposureTally()
        self._status = RecorderStatus(state=RecorderStatus.IDLE)
        self._status_publisher = self.create_publisher(RecorderStatus, "recorder/status", LATCHED)
        self._writing: _WritingThread | None = None

        chosen = self.parameters.value
        self._topics = RAW_TOPICS + (DERIVED_TOPICS if chosen.derived else ())
        if chosen.bag_path:
            self._open(chosen)
        self.create_timer(DISCOVERY_PERIOD_S, self._discover)
        self.create_timer(1.0, self._publish_status)
        self._publish_status()

    def destroy_node(self) -> None:
        """Write what is still in hand and close the bag first."""
        self._close()
        super().destroy_node()

    def _close(self) -> None:
        if self._writing:
            self._writing.close()
            self._writing = None

    def _open(self, chosen: RecorderParameters) -> None:
        self._status.path = str(Path(chosen.bag_path).absolute())
        try:
            writer = BagWriter(
                Path(chosen.bag_path), compression=chosen.compression, flush_interval_s=chosen.flush_interval_s
            )
        except (FringedicError, OSError) as error:
            self._fail(error)
            return
        self._writing = _WritingThread(writer, chosen.flush_interval_s)
        self._status.state = RecorderStatus.STARTING

    def _discover(self) -> None:
        """Subscribe to what is new, and begin recording once all that exists has matched."""
        if self._writing and self._writing.error:
            self._fail(self._writing.error)
        if not self._writing:
            return
        try:
            free = shutil.disk_usage(self._status.path).free
        except OSError as error:
            self._fail(error)  # the folder is gone
            return
        if free < 1e6 * self.parameters.value.smallest_free_mb:
            self._fail(
                DiskFullError(
                    f"the disk is full: {free / 1e6:.0f} MB are left for {self._status.path}; the recording is closed "
                    "and readable, free some space and start a new one"
                )
            )
            return
        unmatched = False
        for name in self._topics:
            topic = self.resolve_topic_name(name)
            announced = self.count_publishers(topic)  # ten times a second: asking who they are would keep a core busy
            if announced and topic not in self._subscriptions_by_topic and topic not in self._refused:
                publishers = [each for each in self.get_publishers_info_by_topic(topic) if each.topic_type]
                if publishers:
                    self._subscribe(name, topic, publishers)
            subscription = self._subscriptions_by_topic.get(topic)
            if subscription and name in RAW_TOPICS and subscription.get_publisher_count() < announced:
                unmatched = True
        if self._status.state == RecorderStatus.STARTING and self._subscriptions_by_topic and not unmatched:
            self._status.state = RecorderStatus.RECORDING
            self._publish_status()

    def _subscribe(self, name: str, topic: str, publishers: list[TopicEndpointInfo]) -> None:
        first = publishers[0]
        assert self._writing is not None
        try:
            kind = message_type(first.topic_type)
            offered = [_described(each.qos_profile) for each in publishers]
            self._writing.add_topic(topic, first.topic_type, offered, str(first.topic_type_hash))
        except (FringedicError, OSError, ImportError, AttributeError) as error:
            self._refused.add(topic)
            self._status.error_message = f"{topic} is not recorded: {error}"
            self.get_logger().error(self._status.error_message)
            self._publish_status()
            return

        gathered = name in SAMPLE_TOPICS

        def take(data: bytes, info: dict[str, Any]) -> None:
            taken = [(data, info)]
            if gathered:
                time.sleep(GATHERED_S)
            # what else has come, at once: a turn of the executor takes longer than many messages
            with suppress(InvalidHandle), subscription.handle:
                while len(taken) < AT_ONCE and (waiting := subscription.handle.take_message(kind, True)) is not None:
                    taken.append(waiting)
            self._take(name, topic, taken)

        subscription = self._subscriptions_by_topic[topic] = self.create_subscription(
            kind,
            topic,
            take,  # type: ignore[arg-type]
            _profile(name, publishers),
            raw=True,
        )

    def _take(self, name: str, topic: str, taken: list[tuple[bytes, dict[str, Any]]]) -> None:
        if not self._writing:
            return
        received = self.get_clock().now().nanoseconds
        self._writing.put(
            [
                (topic, data, received, info["source_timestamp"] or received, info.get("publication_sequence_number"))
                for data, info in taken
            ]
        )
        if name in (IMAGE, EXPOSURE, STEP):
            for data, _ in taken:
                self._look_at(name, data)

    def _look_at(self, name: str, data: bytes) -> None:
        if name == IMAGE:
            self._status.images += 1
            self._tally.add_image(header_stamp(data))
        elif name == EXPOSURE:
            self._tally.add_exposure(header_stamp(data))
        elif self._writing:
            stage = deserialize_message(data, StepStatus).stage
            if stage in (StepStatus.END, StepStatus.ERROR):
                self._tally.end_step()
                self._writing.sync()
            elif stage == StepStatus.PROCESS:
                self._publish_status()  # the experiment waits for this sign of life

    def _fail(self, reason: Exception) -> None:
        if self._status.state != RecorderStatus.FAILED:
            self.get_logger().error(f"recording has stopped: {reason}")
        self._status.state = RecorderStatus.FAILED
        full = isinstance(reason, DiskFullError)
        self._status.error_code = RecorderStatus.DISK_FULL if full else RecorderStatus.WRITING_FAILED
        self._status.error_message = str(reason)
        for subscription in self._subscriptions_by_topic.values():
            self.destroy_subscription(subscription)
        self._subscriptions_by_topic.clear()
        self._close()
        self._publish_status()

    def _publish_status(self) -> None:
        self._status.header.stamp = self.get_clock().now().to_msg()
        self._status.missing_images = self._tally.missing
        if self._writing:
            self._status.messages = self._writing.messages
            self._status.bytes = self._writing.bytes
        self._status_publisher.publish(self._status)


class _WritingThread:
    """Writes to the bag in the order of `put`, away from the middleware's thread.

    When too much waits to be written `put` waits, too: the middleware then holds the messages back, which its depth is
    made for. After an error everything is dropped and `error` says why.
    """

    def __init__(self, writer: BagWriter, flush_interval_s: float) -> None:
        self.error: Exception | None = None
        self.messages = 0
        self.bytes = 0
        self._writer = writer
        self._writer_lock = threading.Lock()
        self._flush_interval_s = flush_interval_s
        self._queue: queue.Queue[list[Message] | Literal["sync", "end"]] = queue.Queue()
        self._waiting_bytes = 0
        self._written = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="bag writer", daemon=True)
        self._thread.start()

    def add_topic(self, topic: str, type_name: str, offered: list[Qos], publisher_hash: str) -> None:
        with self._writer_lock:
            self._writer.add_topic(topic, type_name, offered, publisher_hash=publisher_hash)

    def put(self, messages: list[Message]) -> None:
        with self._written:
            self._written.wait_for(lambda: self._waiting_bytes < BACKLOG_BYTES)
            self._waiting_bytes += _size(messages)
        self._queue.put(messages)

    def sync(self) -> None:
        """Have everything put so far on the disk, where it survives a power cut."""
        self._queue.put("sync")

    def close(self) -> None:
        """Write what was put, close the bag and end the thread."""
        self._queue.put("end")
        self._thread.join()

    def _run(self) -> None:
        with suppress(OSError):  # Linux alone has priorities of single threads
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        ended = False
        while not ended:
            try:
                item: list[Message] | Literal["sync", "end", "flush"]
                item = self._queue.get(timeout=self._flush_interval_s)
            except queue.Empty:
                item = "flush"
            ended = item == "end"
            if not self.error or ended:
                try:
                    with self._writer_lock:
                        self._handle(item)
                except (FringedicError, OSError) as error:
                    self.error = self.error or error
            if isinstance(item, list):
                with self._written:
                    self._waiting_bytes -= _size(item)
                    self._written.notify()

    def _handle(self, item: list[Message] | Literal["sync", "end", "flush"]) -> None:
        match item:
            case "end":
                self._writer.close()
            case "sync":
                self._writer.sync()
                self.bytes = self._writer.size
            case "flush":
                self._writer.flush()
                self.bytes = self._writer.size  # fails when somebody has removed the file
            case _:
                for message in item:
                    self._writer.write(*message)
                self.messages += len(item)


def _size(messages: list[Message]) -> int:
    return sum(len(data) for _, data, *_ in messages)


def _described(profile: QoSProfile) -> Qos:
    return Qos(
        depth=profile.depth,
        reliability="best_effort" if profile.reliability == ReliabilityPolicy.BEST_EFFORT else "reliable",
        durability="transient_local" if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL else "volatile",
    )


def _profile(name: str, publishers: list[TopicEndpointInfo]) -> QoSProfile:
    """Return a QoS that every publisher of a topic can serve, as strict as they allow, with a depth of our own."""
    offered = [each.qos_profile for each in publishers]
    reliable = all(each.reliability == ReliabilityPolicy.RELIABLE for each in offered)
    latched = all(each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in offered)
    return QoSProfile(
        depth=IMAGE_DEPTH if name == IMAGE else RECORDING_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def main() -> int:
    """Run the recorder until SIGINT or SIGTERM, then close the bag."""
    return run(RecorderNode)
