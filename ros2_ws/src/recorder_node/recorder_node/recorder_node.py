"""Records the raw topics of a rig, and the derived ones on request, as serialised messages."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Literal, NamedTuple, TypedDict

from rclpy.exceptions import InvalidHandle
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from fringedic.errors import ErrorCode, FringedicError, RecordingError
from fringedic.recording.topics import Qos
from fringedic.recording.writer import BagWriter
from fringedic.settings.recorder import RecorderNodeSettings
from fringedic_msgs.msg import RecorderStatus
from fringedic_ros.diagnostics import NodeDiagnostics
from fringedic_ros.main import run
from fringedic_ros.middleware import Endpoint
from fringedic_ros.parameters import declare
from fringedic_ros.polled import OnDemand
from fringedic_ros.qos import LATCHED, SAMPLES
from fringedic_ros.rig_node import FIXED_QOS, RigNode
from fringedic_ros.serialized import message_type, step_crc
from fringedic_ros.topics import DERIVED_TOPICS, EXPOSURE, IMAGE, RAW_TOPICS, SAMPLE_TOPICS, STEP
from recorder_node.sensor_tally import SensorTally
from recorder_node.writing_thread import ReceivedMessage, WritingThread

DISCOVERY_PERIOD_S = 0.1
# Both depths outlast a recorder without processor time: images for four seconds, samples at 1 kHz for ten.
RECORDING_DEPTH = SAMPLES.depth
IMAGE_DEPTH = 128
BATCH = 100  # messages of one topic that are taken before the other topics are served
SAMPLES_S = 0.05  # samples are taken together after this time: a turn of the executor costs as much as fifty of them
LAST_RECORD_POLL_S = 0.002
LAST_RECORD_S = 3.0  # longest wait for the end of a step that is cut off
UNREADABLE_S = 10.0  # shortest time between two reports of messages that cannot be read


class _Name(NamedTuple):
    """Name of a topic of a rig, with the namespace of its sensor before it, which is empty for the rig itself."""

    namespace: str
    topic: str


class MessageInfo(TypedDict, total=False):
    """Information of the middleware about a message."""

    source_timestamp: int
    publication_sequence_number: int


Taken = list[tuple[bytes, MessageInfo]]


class RecorderNode(RigNode):
    """Subscribes to every topic of a recording as soon as it has a publisher.

    Messages are taken as serialised bytes and written unchanged by a thread of their own. Only the stamps and checksums
    of images, the exposures and the stages of steps are read. A failure to write ends the recording, not the node.
    """

    def __init__(self) -> None:
        super().__init__("recorder")
        self.parameters = declare(self, RecorderNodeSettings)
        self.diagnostics = NodeDiagnostics(self)
        self._subscriptions_by_topic: dict[str, Subscription] = {}
        self._kinds: dict[str, tuple[_Name, type]] = {}  # relative name and type of each subscribed topic
        self._refused: set[str] = set()
        parameters = self.parameters.value
        # the rig, and each sensor in a namespace of its own, whose experiment node waits for a status there
        namespaces = ("", *(f"{sensor}/" for sensor in parameters.sensors))
        self._tallies = {namespace: SensorTally() for namespace in namespaces}
        self._status = RecorderStatus(state=RecorderStatus.IDLE, derived=parameters.derived)
        self._status_publishers = {
            namespace: self.create_publisher(RecorderStatus, f"{namespace}recorder/status", LATCHED)
            for namespace in namespaces
        }
        self._publishing = threading.Lock()
        self._writing: WritingThread | None = None
        topics = RAW_TOPICS + (DERIVED_TOPICS if parameters.derived else ())
        self._topics = [
            _Name(namespace, name)
            for namespace in namespaces
            for name in topics
            if not (namespace and name.startswith("/"))  # a topic of all rigs
        ]
        if parameters.bag_path:
            self._open(parameters)
        self.create_timer(DISCOVERY_PERIOD_S, self._discover)
        self.create_timer(SAMPLES_S, self._take_samples)
        self.create_timer(1.0, self._publish_status)
        self._publish_status()

    def destroy_node(self) -> None:
        """Write what is queued, close the bag and end the node.

        A signal may reach all nodes of a rig at once. The recording of a step that it cuts off ends with the error
        record of the experiment node.
        """
        end = time.monotonic() + LAST_RECORD_S
        while any(each.in_step for each in self._tallies.values()) and self._writing and time.monotonic() < end:
            time.sleep(LAST_RECORD_POLL_S)
            for topic, (name, kind) in self._kinds.items():
                self._record(name, topic, self._waiting_messages(topic, kind))
        self._take_samples()
        self._close()
        super().destroy_node()

    def _close(self) -> None:
        if self._writing:
            self._writing.close()
            self._writing = None

    def _open(self, parameters: RecorderNodeSettings) -> None:
        path, interval = Path(parameters.bag_path), parameters.flush_interval_s
        self._status.path = str(path.absolute())
        try:
            writer = BagWriter(
                path, compression=parameters.compression, flush_interval_s=interval, split=parameters.split
            )
        except (FringedicError, OSError) as error:
            self._fail(error)
            return
        self._writing = WritingThread(writer, interval)
        self._status.state = RecorderStatus.STARTING

    # topics

    def _discover(self) -> None:
        """Subscribe to new topics, and start recording when all publishers are connected."""
        if self._writing and self._writing.error:
            self._fail(self._writing.error)
        if not self._writing or self._is_disk_full():
            return
        unmatched = False
        for name in self._topics:
            topic = self.resolve_topic_name(f"{name.namespace}{name.topic}")
            announced = self.count_publishers(topic)  # ten times a second: asking for their settings costs too much
            if announced and topic not in self._subscriptions_by_topic and topic not in self._refused:
                publishers = [each for each in self.get_publishers_info_by_topic(topic) if each.topic_type]
                if publishers:
                    self._subscribe(name, topic, publishers)
            subscription = self._subscriptions_by_topic.get(topic)
            if subscription and name.topic in RAW_TOPICS and subscription.get_publisher_count() < announced:
                unmatched = True
        if self._status.state == RecorderStatus.STARTING and self._subscriptions_by_topic and not unmatched:
            self._status.state = RecorderStatus.RECORDING
            self._publish_status()

    def _is_disk_full(self) -> bool:
        """Return whether the disk is full or the folder is gone; then the recording has been closed."""
        try:
            free = shutil.disk_usage(self._status.path).free
        except OSError as error:
            self._fail(error)
            return True
        if free >= 1e6 * self.parameters.value.smallest_free_mb:
            return False
        self._fail(
            RecordingError(
                f"the disk is full: {free / 1e6:.0f} MB are left for {self._status.path}; the recording is closed "
                "and readable, free some space and start a new one",
                code=ErrorCode.DISK_FULL,
            )
        )
        return True

    def _subscribe(self, name: _Name, topic: str, publishers: Sequence[Endpoint]) -> None:
        first = publishers[0]
        assert self._writing is not None
        try:
            kind = message_type(first.topic_type)
            offered = [_recorded_qos(each.qos_profile) for each in publishers]
            self._writing.add_topic(topic, first.topic_type, offered, str(first.topic_type_hash))
        except (FringedicError, OSError, ImportError, AttributeError) as error:
            self._refused.add(topic)
            self._status.error_message = f"{topic} is not recorded: {error}"
            self.get_logger().error(self._status.error_message)
            self._publish_status()
            return
        callback = self._take_batches_of(name, topic, kind)
        options = {"callback_group": OnDemand()} if name.topic in SAMPLE_TOPICS else {}
        self._kinds[topic] = name, kind
        self._subscriptions_by_topic[topic] = self.create_subscription(
            kind,
            topic,
            callback,
            _compatible_profile(name.topic, publishers),
            raw=True,
            qos_overriding_options=FIXED_QOS,
            **options,
        )

    # messages

    def _take_batches_of(self, name: _Name, topic: str, kind: type) -> Callable[[bytes, MessageInfo], None]:
        """Return the callback of a topic, which takes all messages that wait: a turn of the executor is expensive."""

        def take(data: bytes, info: MessageInfo) -> None:
            self._record(name, topic, [(data, info), *self._waiting_messages(topic, kind)])

        return take

    def _take_samples(self) -> None:
        """Record the samples that have arrived."""
        for topic, (name, kind) in self._kinds.items():
            while name.topic in SAMPLE_TOPICS and (taken := self._waiting_messages(topic, kind)):
                self._record(name, topic, taken)

    def _waiting_messages(self, topic: str, kind: type) -> Taken:
        """Return the next messages of a topic that have arrived, at most `BATCH`."""
        taken: Taken = []
        subscription = self._subscriptions_by_topic.get(topic)
        if subscription is not None:
            with suppress(InvalidHandle), subscription.handle:
                while len(taken) < BATCH and (waiting := subscription.handle.take_message(kind, True)) is not None:
                    taken.append(waiting)
        return taken

    def _record(self, name: _Name, topic: str, taken: Taken) -> None:
        if not self._writing or not taken:
            return
        if name.topic not in SAMPLE_TOPICS:
            self._take_samples()  # so that those of a step are recorded before its end
        received = time.time_ns()
        self._writing.put(
            [
                ReceivedMessage(
                    topic,
                    data,
                    received,
                    info["source_timestamp"] or received,
                    info.get("publication_sequence_number"),
                )
                for data, info in taken
            ]
        )
        if name.topic in (IMAGE, EXPOSURE, STEP):
            for data, _ in taken:
                try:
                    self._count(name, data)
                except RecordingError as error:
                    self.get_logger().error(f"{topic}: {error}; it is recorded", throttle_duration_sec=UNREADABLE_S)

    def _count(self, name: _Name, data: bytes) -> None:
        """Count an image or exposure, or act on the stage of a step."""
        tally = self._tallies[name.namespace]
        has_ended = tally.count(name.topic, data)
        if name.topic == IMAGE:
            self.diagnostics.success()
        self._confirm(name.namespace)
        if has_ended and self._writing:
            self._writing.sync()

    def _confirm(self, namespace: str) -> None:
        """Publish how many frames of a step are written once all were exposed; the experiment node waits for it."""
        confirmed = self._tallies[namespace].to_confirm()
        if confirmed is not None and self._writing:
            self._writing.then(lambda: self._publish_confirmed(namespace, *confirmed))

    def _publish_confirmed(self, namespace: str, experiment: str, step: int, crcs: list[int]) -> None:
        """Publish, in the thread that has written them."""
        self._tallies[namespace].confirmed = experiment, step, len(crcs), step_crc(crcs)
        self._publish_status()

    # status

    def _fail(self, reason: Exception) -> None:
        if self._status.state != RecorderStatus.FAILED:
            self.get_logger().error(f"the recording has ended: {reason}")
        self._status.state = RecorderStatus.FAILED
        full = isinstance(reason, FringedicError) and reason.code is ErrorCode.DISK_FULL
        self._status.error_code = RecorderStatus.DISK_FULL if full else RecorderStatus.WRITING_FAILED
        self._status.error_message = str(reason)
        self.diagnostics.failure(str(reason))
        for subscription in self._subscriptions_by_topic.values():
            self.destroy_subscription(subscription)
        self._subscriptions_by_topic.clear()
        self._close()
        self._publish_status()

    def _publish_status(self) -> None:
        with self._publishing:  # the writing thread confirms frames meanwhile
            status = self._status
            status.header.stamp = self.get_clock().now().to_msg()
            if self._writing:
                status.messages, status.bytes = self._writing.messages, self._writing.bytes
            for namespace, tally in self._tallies.items():
                tally.fill_in(status)
                if not namespace:  # of all sensors
                    status.images = sum(each.images for each in self._tallies.values())
                    status.missing_images = sum(each.missing for each in self._tallies.values())
                self._status_publishers[namespace].publish(status)


_HISTORIES: dict[HistoryPolicy, Literal["keep_last", "keep_all"]] = {
    HistoryPolicy.KEEP_LAST: "keep_last",
    HistoryPolicy.KEEP_ALL: "keep_all",
}


def _recorded_qos(profile: QoSProfile) -> Qos:
    return Qos(
        depth=profile.depth or Qos.depth,
        history=_HISTORIES.get(profile.history, "unknown"),
        reliability="best_effort" if profile.reliability == ReliabilityPolicy.BEST_EFFORT else "reliable",
        durability="transient_local" if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL else "volatile",
    )


def _compatible_profile(name: str, publishers: Sequence[Endpoint]) -> QoSProfile:
    """Return the strictest QoS that is compatible with every publisher of a topic, with the depth of a recorder."""
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
