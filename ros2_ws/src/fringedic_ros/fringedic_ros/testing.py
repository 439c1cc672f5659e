"""Node processes, a peer that communicates with them, and frames, for tests over real DDS."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import numpy as np
import rclpy
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.client import Client
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Image

from fringedic.frames.records import FrameRecord
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.patterns.render import render_pattern
from fringedic.patterns.sequences import fringe_sequence
from fringedic.virtual_rig import VirtualRig
from fringedic_msgs.msg import Exposure, NodeParameters, NodeStatus, StepStatus
from fringedic_msgs.srv import CountReaders
from fringedic_ros.images import image_message
from fringedic_ros.qos import EVENTS, IMAGES, LATCHED_BY_MANY
from fringedic_ros.records import exposure_message
from fringedic_ros.stamps import to_msg, to_nanoseconds
from fringedic_ros.waiting import RepeatedRequest

PITCHES = (100.0, 20.0, 5.0)
SHIFTS = (4, 4, 8)
Frame = tuple[FrameRecord, np.ndarray]


def command_lines() -> Iterator[tuple[int, list[str]]]:
    """Yield the process id and the words of the command line of every process that this user may see."""
    for process in Path("/proc").glob("[0-9]*"):
        try:
            words = (process / "cmdline").read_text(errors="replace").split("\0")
        except OSError:
            continue  # it has ended, or belongs to another user
        yield int(process.name), words


def descendant_pid(ancestor: int, executable: str) -> int:
    """Return the process of an executable that another process has started, by itself or by its node server."""
    for pid, words in command_lines():
        if any(Path(word).name == executable for word in words) and ancestor in _ancestors(pid):
            return pid
    raise ProcessLookupError(f"process {ancestor} has not started {executable}")


def _ancestors(pid: int) -> Iterator[int]:
    """Yield the process that has started another one, the one that has started that, and so on."""
    with suppress(OSError):  # one has ended
        while pid:
            pid = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
            yield pid


def node_pids(folder: Path) -> dict[str, int]:
    """Return the processes of the nodes of a run by their names: the command line contains the parameter file."""
    logs = f"{folder / 'logs'}/"
    return {
        word.removeprefix(logs).removesuffix(".yaml"): pid
        for pid, words in command_lines()
        for word in words
        if word.startswith(logs)
    }


class NodeProcess:
    """A node in a process of its own, during a `with` block.

    Parameters
    ----------
    module
        Module whose `main` runs the node.
    folder
        Folder of its log.
    parameters
        Values of its parameters, as YAML.
    """

    def __init__(self, module: str, folder: Path, parameters: Mapping[str, Any] | None = None) -> None:
        self._log = folder / f"{module}.log"
        self._command = [sys.executable, "-c", f"import sys; from {module} import main; sys.exit(main())"]
        values = (parameters or {}).items()
        self._command += ["--ros-args", *(word for name, value in values for word in ("-p", f"{name}:={value}"))]
        self._environment = {**os.environ, "ROS_PYTHON_CHECK_FIELDS": "1"}

    @property
    def log(self) -> str:
        """Text that the process has written."""
        return self._log.read_text()

    def __enter__(self) -> Self:
        with self._log.open("w") as log:
            self.process = subprocess.Popen(
                self._command, env=self._environment, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL
            )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        alive = self.process.poll() is None
        if alive:
            self.process.send_signal(signal.SIGINT)
        try:
            code = self.process.wait(300)
        except subprocess.TimeoutExpired:
            self.process.kill()
            code = self.process.wait()
        if error is not None:
            sys.stdout.write(f"--- {self._log.name}\n{self.log}\n")  # pytest shows it with the failure
        else:
            assert alive, f"the process ended by itself with {code}:\n{self.log}"
            assert code == 0, f"the process ended with {code}:\n{self.log}"


_SILENT_STAGE = """
import sys, time, rclpy
from fringedic_msgs.srv import PlaceReferencePlane
rclpy.init()
node = rclpy.create_node("stage", namespace=sys.argv[1])
def place(*_):
    print("requested", flush=True)
    time.sleep(600)
node.create_service(PlaceReferencePlane, "reference_plane/place", place)
rclpy.spin(node)
"""


@contextmanager
def killed_stage(namespace: str, then: Callable[[], object] = lambda: None) -> Iterator[None]:
    """Run a stage that never answers and is killed at its first request; `then` is called after that, in a thread."""
    command = [sys.executable, "-c", _SILENT_STAGE, namespace]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:

        def kill() -> None:
            assert process.stdout is not None
            process.stdout.readline()
            process.kill()
            then()

        killing = threading.Thread(target=kill)
        killing.start()
        yield
        process.kill()
        killing.join()


def fringe_step(rig: VirtualRig, position: float, experiment: str, step: int) -> list[Frame]:
    """Return the frames of one step of a tiny virtual rig with their records; stamps increase from step to step."""
    rows, columns = rig.projector_shape
    sequence = fringe_sequence(columns, rows, PITCHES, SHIFTS)
    count = len(sequence)
    frames = []
    for index, pattern in enumerate(sequence.patterns):
        stamp = (1000 * (step + 1) + index) * 10_000_000
        record = FrameRecord(experiment, step, index, count, pattern, stamp, exposure_time=0.005)
        frames.append((record, rig.expose(sequence.frame(index), position, frame=count * step + index)))
    return frames


def white_step(rig: VirtualRig, position: float, experiment: str, step: int) -> list[Frame]:
    """Return the one frame of a step in white light, with its record."""
    rows, columns = rig.projector_shape
    pattern = ProjectedPattern(PatternKind.WHITE)
    record = FrameRecord(experiment, step, 0, 1, pattern, 1000 * (step + 1) * 10_000_000, exposure_time=0.005)
    return [(record, rig.expose(render_pattern(pattern, columns, rows), position, frame=step))]


def await_readers(publisher: Publisher, count: int) -> None:
    """Wait until a publisher is connected to so many readers, as a camera does before the first frame of a step."""
    deadline = time.monotonic() + 60.0
    while publisher.get_subscription_count() < count:
        assert time.monotonic() < deadline, f"{publisher.topic_name} has less than {count} readers"
        time.sleep(0.01)


class Peer(Node):
    """Counterpart of a tested node: publishes, serves and collects messages; the waiting test spins it."""

    def __init__(self, name: str = "peer") -> None:
        super().__init__(name)
        self._heard: list[list[Any]] = []
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)

    def listen(self, kind: type[Any], topic: str, qos: QoSProfile) -> list[Any]:
        """Subscribe and return the list that collects the messages."""
        heard: list[Any] = []
        self._heard.append(heard)
        self.create_subscription(kind, topic, heard.append, qos)
        return heard

    def serve_also(self, node: Node) -> None:
        """Spin a node of this process together with this one."""
        self._executor.add_node(node)

    def forget(self) -> None:
        """Empty all lists of messages."""
        for heard in self._heard:
            heard.clear()

    def wait(self, predicate: Callable[[], Any], what: str, timeout_s: float = 300.0) -> None:
        """Serve callbacks until the predicate is true."""
        deadline = time.monotonic() + timeout_s
        while not predicate():
            assert time.monotonic() < deadline, f"{what} did not happen within {timeout_s:g} s"
            self._executor.spin_once(timeout_sec=0.01)

    def serve(self, seconds: float) -> None:
        """Serve callbacks for a time."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.01)

    def ask(self, client: Client, request: Any, what: str, timeout_s: float = 300.0) -> Any:
        """Return the response to a request whose effect is the same every time; it is sent again when one is lost."""
        with RepeatedRequest(client, request) as repeated:
            self.wait(repeated.is_answered, what, timeout_s)
            return repeated.response

    def meet(self, node: str) -> None:
        """Wait until a node knows all clients of this one, so that no response to a later request or goal is lost.

        Endpoints become known in the order of their creation, and the client of this question is the last one.
        """
        client = self.create_client(GetParameters, f"{node}/get_parameters")
        self.ask(client, GetParameters.Request(), f"the {node} node")
        self.destroy_client(client)

    def destroy_node(self) -> None:
        """Leave the executor first."""
        self._executor.shutdown()
        super().destroy_node()


class Bench(Peer):
    """Camera and experiment node for one processing node; collects its status.

    Parameters
    ----------
    tested
        Name of the node.

    Attributes
    ----------
    unread
        Topics that the node does not read.
    """

    unread: tuple[str, ...] = ()

    def __init__(self, tested: str) -> None:
        super().__init__("bench")
        self._tested = tested
        self._steps = self.create_publisher(StepStatus, "experiment/step", EVENTS)
        self._exposures = self.create_publisher(Exposure, "camera/exposure", IMAGES)
        self._images = self.create_publisher(Image, "camera/image_raw", IMAGES)
        self._set_parameters = self.create_client(SetParameters, f"{tested}/set_parameters")
        self.statuses = self.listen(NodeStatus, f"{tested}/status", EVENTS)
        self.node_parameters = self.listen(NodeParameters, "node_parameters", LATCHED_BY_MANY)

    def connect(self) -> None:
        """Wait until the node is present and every topic between it and this one is connected."""
        self.wait(lambda: self.count_publishers(f"{self._tested}/status"), f"the {self._tested} node")
        self.wait(self._set_parameters.service_is_ready, "its parameters")
        self.meet(self._tested)
        for publisher in self.publishers:
            if not publisher.topic_name.endswith(("/parameter_events", "/rosout", *self.unread)):
                self.wait(publisher.get_subscription_count, f"a reader of {publisher.topic_name}")

    def until_read(self, topic: str) -> None:
        """Wait until the node has discovered a subscription to one of its topics."""
        client = self.create_client(CountReaders, f"{self._tested}/count_readers")
        request = CountReaders.Request(topics=[self.resolve_topic_name(topic)])
        self.wait(lambda: self.ask(client, request, "the number of readers").counts[0], f"a reader of {topic}")
        self.destroy_client(client)

    def taken(self, messages: int = 1) -> None:
        """Wait until the node has taken what was published, at most so many messages of each topic.

        Before it answers a request, a node takes one message of each topic.
        """
        for publisher in self.publishers:
            assert publisher.wait_for_all_acked(Duration(seconds=180)), publisher.topic_name
        for _ in range(messages):
            self.change()

    def send(self, frames: Iterable[Frame], *, exposures_first: bool = False) -> None:
        """Publish frames with their records."""
        messages = [
            (
                image_message(image, stamp_ns=record.stamp, frame_id="camera_optical_frame"),
                exposure_message(record, frame_id="camera_optical_frame"),
            )
            for record, image in frames
        ]
        if exposures_first:
            for _, exposure in messages:
                self._exposures.publish(exposure)
        for image, exposure in messages:
            self._images.publish(image)
            if not exposures_first:
                self._exposures.publish(exposure)

    def send_message(self, image: Image, record: FrameRecord) -> None:
        """Publish one image message unchanged, with a record."""
        self._images.publish(image)
        self._exposures.publish(exposure_message(record, frame_id="camera_optical_frame"))

    def abort(self, experiment: str, step: int, stamp: int = 0) -> None:
        """End a step with an error of the experiment."""
        message = StepStatus(experiment=experiment, step=step, stage=StepStatus.ERROR)
        message.error_message = "the camera stopped"
        message.header.stamp = to_msg(stamp)
        self._steps.publish(message)

    def status_of(self, experiment: str, step: int) -> NodeStatus:
        """Return the one status of a step; a second one would arrive at once."""

        def answers() -> list[NodeStatus]:
            return [each for each in self.statuses if (each.experiment, each.step) == (experiment, step)]

        self.wait(answers, f"the status of step {step}")
        self.serve(0.15)
        assert len(answers()) == 1, answers()
        return answers()[0]

    def change(self, **values: Any) -> None:
        """Change parameters of the node, or none."""
        changes = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        response = self.ask(self._set_parameters, SetParameters.Request(parameters=changes), "the change of parameters")
        assert all(result.successful for result in response.results), response


AnyBench = TypeVar("AnyBench", bound=Bench)


@contextmanager
def connected_bench(make_bench: Callable[[], AnyBench], module: str, folder: Path) -> Iterator[AnyBench]:
    """Run the node of a module, with its log in a folder, and provide a bench that is connected to it."""
    rclpy.init()
    bench = make_bench()
    with NodeProcess(module, folder):
        bench.connect()
        yield bench
    bench.destroy_node()
    rclpy.try_shutdown()


def of_stamp(messages: list[Any], stamp: int) -> list[Any]:
    """Return the messages with exactly this stamp [ns]."""
    return [message for message in messages if to_nanoseconds(message.header.stamp) == stamp]
