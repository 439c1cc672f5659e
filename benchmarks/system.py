"""What the running system carries: frames to the phase node and the recorder, time from exposure to cloud, memory.

Real nodes in processes of their own, in a ROS domain of its own. The camera takes image files, so that no rendering
competes with what is measured: speckle for the stream, frames of the shipped plate's digital twin for the steps.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rclpy
from ament_index_python.packages import get_package_share_directory
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rich.console import Console
from rich.table import Table
from sensor_msgs.msg import Image

from fringedic.frames.records import FrameRecord
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.patterns.render import render_pattern
from fringedic.recording.reader import BagReader
from fringedic.settings.camera import FilesCamera
from fringedic.virtual_rig import VirtualRig
from fringedic_bringup.client import RigClient
from fringedic_bringup.launch.environment import private_domain
from fringedic_bringup.launch.graph import Graph, NodeEntry, rig_graph
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.procedures.run import load_rig
from fringedic_msgs.msg import Exposure, NodeStatus, RecorderStatus
from fringedic_ros.images import image_message
from fringedic_ros.qos import DIAGNOSTICS, EVENTS, IMAGES, LATCHED
from fringedic_ros.records import exposure_message

SIZE = (960, 1280)
RATE_HZ = 32.0
WANTED_HZ = 30.0
TIMEOUT_S = 30.0
CLOSING_FRAMES = 4  # fringe frames that make the phase node report what it lost before


class Probe:
    """Starts the free run of the camera and receives its exposure records and the status of the nodes."""

    def __init__(self, domain: int, watch: Callable[[], None]) -> None:
        self.exposures: list[Exposure] = []
        self.recorder = RecorderStatus()
        self.statuses: list[NodeStatus] = []
        self.drops: dict[str, int] = {}
        self._watch = watch
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = Node("probe", namespace="bench", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self.listen = listen = self._node.create_subscription
        publish = self._node.create_publisher
        listen(Exposure, "camera/exposure", self.exposures.append, IMAGES)
        listen(RecorderStatus, "recorder/status", lambda message: setattr(self, "recorder", message), LATCHED)
        listen(NodeStatus, "phase/status", self.statuses.append, EVENTS)
        listen(DiagnosticArray, "/diagnostics", self._take_diagnostics, DIAGNOSTICS)
        self._images = publish(Image, "camera/image_raw", IMAGES)
        self._records = publish(Exposure, "camera/exposure", IMAGES)
        self._change_state = self._node.create_client(ChangeState, "camera/change_state")

    def close(self) -> None:
        """End the node."""
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def wait(self, done: Callable[[], Any], what: str, timeout_s: float = TIMEOUT_S) -> None:
        """Spin the node until a condition is true."""
        end = time.monotonic() + timeout_s
        while not done():
            if time.monotonic() > end:
                raise TimeoutError(f"{what} after {timeout_s:g} s")
            self._executor.spin_once(timeout_sec=0.1)
            self._watch()

    def pause(self, seconds: float) -> None:
        """Spin the node for some time."""
        end = time.monotonic() + seconds
        self.wait(lambda: time.monotonic() >= end, "the clock stands still", seconds + 10.0)

    def camera(self, transition: int) -> None:
        """Change the state of the camera."""
        self.wait(self._change_state.service_is_ready, "no service camera/change_state")
        request = ChangeState.Request()
        request.transition.id = transition
        answer = self._change_state.call_async(request)
        self.wait(answer.done, "no answer of camera/change_state")
        if not answer.result().success:
            raise RuntimeError(f"the camera refuses transition {transition}")

    def closing_step(self) -> None:
        """Publish one small step of fringes, after which the phase node reports its lost frames."""
        for index in range(CLOSING_FRAMES):
            pattern = ProjectedPattern(PatternKind.FRINGES, pitch=8.0, shift=index + 1, shifts=CLOSING_FRAMES)
            record = FrameRecord("closing", 1, index, CLOSING_FRAMES, pattern, time.time_ns(), 0.01, 0)
            image = np.full((16, 16), 60 * index, np.uint8)
            self._images.publish(image_message(image, stamp_ns=record.stamp, frame_id="camera_optical_frame"))
            self._records.publish(exposure_message(record, frame_id="camera_optical_frame"))
        self.wait(lambda: self.statuses, "no phase/status of the closing step")
        self.pause(2.5)  # diagnostics and the recorder's state come once a second

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            values = {value.key: value.value for value in status.values}
            self.drops[status.hardware_id] = int(values["drops"])


@dataclass(frozen=True)
class Stream:
    """A free run of the camera.

    Attributes
    ----------
    probe
        What it has heard to the end.
    exposures
        Records that the probe heard.
    duration
        [s].
    written
        Bytes of the recording.
    shares
        Share of one core, and largest resident memory [MB], of each node.
    """

    probe: Probe
    exposures: list[Exposure]
    duration: float
    written: int
    shares: dict[str, tuple[float, float]]

    @property
    def begun(self) -> int:
        """Exposures that were begun, by the index of the last."""
        return self.exposures[-1].index + 1

    @property
    def rate(self) -> float:
        """Frames per second by their stamps."""
        first, last = (
            each.header.stamp.sec + 1e-9 * each.header.stamp.nanosec for each in (self.exposures[0], self.exposures[-1])
        )
        return (self.begun - 1) / (last - first)

    def add_shares(self, table: Table) -> None:
        """Add a row for each node."""
        for name, (share, peak) in self.shares.items():
            table.add_row(f"{name}: share of one core, peak memory", f"{share:.0%}, {peak:.0f} MB", "")


def free_run(
    nodes: tuple[NodeEntry, ...], seconds: float, folder: Path, then: Callable[[Probe], None] = lambda _: None
) -> Stream:
    """Start nodes, one of them an inactive camera, let it run, do something with the nodes and end them."""
    graph = Graph("bench", nodes)
    with (
        private_domain() as domain,
        RunningGraph(graph, folder / "logs", domain=domain) as running,
        RigClient("bench", domain=domain, watch=running.check) as client,
        closing(Probe(domain, running.check)) as probe,
    ):
        probe.camera(Transition.TRANSITION_CONFIGURE)
        client.wait_until_ready(graph.names)
        probe.pause(2.0)
        written, idle, begin = probe.recorder.bytes, usage(running), time.monotonic()
        probe.camera(Transition.TRANSITION_ACTIVATE)
        probe.pause(seconds)
        probe.camera(Transition.TRANSITION_DEACTIVATE)
        duration, busy = time.monotonic() - begin, usage(running)
        probe.pause(2.0)
        shares = {name: ((used - idle[name][0]) / duration, peak) for name, (used, peak) in busy.items()}
        run = Stream(probe, list(probe.exposures), duration, probe.recorder.bytes - written, shares)
        then(probe)
    return run


def noise_images(folder: Path) -> Path:
    """Write some images of noise, which hardly compress."""
    folder.mkdir(parents=True)
    random = np.random.default_rng(1)
    for number in range(8):
        cv2.imwrite(str(folder / f"{number}.pgm"), random.integers(0, 256, SIZE, np.uint8))
    return folder


def stream(seconds: float, folder: Path) -> Table:
    """Free-running camera to phase node and recorder."""
    images = noise_images(folder / "images")
    camera = {"source": "files", "files": str(images), "repeat": True, "frame_rate_hz": RATE_HZ, "autostart": False}
    bag = folder / "bag"
    nodes = (
        NodeEntry("recorder", "recorder_node", "recorder", {"bag_path": str(bag)}),
        NodeEntry("phase", "phase_node", "phase"),
        NodeEntry("camera", "camera_node", "camera", camera),
    )
    run = free_run(nodes, seconds, folder, Probe.closing_step)
    reader = BagReader(bag)
    topics = reader.find("camera/image_raw", "camera/exposure").values()
    recorded = [reader.counts[topic] - CLOSING_FRAMES for topic in topics]
    begun = run.begun
    table = figures(f"Frames of {SIZE[1]}x{SIZE[0]} mono8 for {seconds:g} s, camera to phase node and recorder")
    table.add_row("frames", f"{begun}", "")
    table.add_row("frames per second", f"{run.rate:.2f}", f">= {WANTED_HZ:g}")
    table.add_row("omitted by the camera", f"{run.exposures[-1].dropped}", "0")
    table.add_row("records missing at the probe", f"{begun - len(run.exposures)}", "0")
    table.add_row("lost by the phase node", f"{run.probe.drops['phase']}", "0")
    table.add_row("images, records missing in the recording", f"{begun - recorded[0]}, {begun - recorded[1]}", "0, 0")
    table.add_row("images missing by the recorder's count", f"{run.probe.recorder.missing_images}", "0")
    table.add_row("recording [MB/s]", f"{1e-6 * run.written / run.duration:.1f}", "")
    run.add_shares(table)
    return table


def render_steps(path: Path, images: Path, steps: int) -> tuple[int, tuple[int, int]]:
    """Write the frames of the steps of a virtual rig; return how many a step has, and their size (row, column)."""
    rig, programme = load_rig(path, None, None)
    twin = VirtualRig(rig.virtual_configuration())
    rows, columns = twin.projector_shape
    patterns = [render_pattern(pattern, columns, rows) for pattern in rig.patterns()]
    positions = [step.position or 0.0 for step in programme.load_steps()]
    images.mkdir(parents=True)
    for number in range(steps * len(patterns)):
        step, frame = divmod(number, len(patterns))
        image = twin.expose(patterns[frame], positions[step % len(positions)], number)
        cv2.imwrite(str(images / f"{number:04}.pgm"), image)
    return len(patterns), twin.shape


def plate_steps(folder: Path) -> Iterator[Table]:
    """Fringe steps of the shipped plate, with every node but the load frame: as shipped, then at every pixel."""
    path = Path(get_package_share_directory("fringedic_bringup")) / "config" / "plate.yaml"
    rig, programme = load_rig(path, None, None)
    steps = len(programme.load_steps())
    images = folder / "images"
    frames, _ = render_steps(path, images, steps)
    for spacing in (rig.nodes.dic.spacing, 1):
        dic = rig.nodes.dic.model_copy(update={"spacing": spacing})
        nodes = rig.nodes.model_copy(update={"dic": dic})
        chosen = rig.model_copy(update={"camera": FilesCamera(files=str(images)), "nodes": nodes, "load_frame": None})
        target = folder / f"spacing_{spacing}"
        graph = rig_graph(chosen, path, target, experiment="bench")
        with (
            private_domain() as domain,
            RunningGraph(graph, target / "logs", domain=domain) as running,
            RigClient(graph.namespace, domain=domain, watch=running.check) as client,
        ):
            client.wait_until_ready(graph.names)
            results = [client.measure() for _ in range(steps)]
            used = usage(running)
        warm = results[1:]
        clouds = [result.processing_time for result in warm]
        overheads = [1e3 * (result.duration - result.processing_time) / frames for result in warm]
        table = figures(f"Steps of {frames} frames of {SIZE[1]}x{SIZE[0]}, displacement every {spacing} px")
        table.add_row("last exposure to displacement cloud, median [s]", f"{statistics.median(clouds):.2f}", "")
        extremes = f"{min(clouds):.2f}, {max(clouds):.2f}, {results[0].processing_time:.2f}"
        table.add_row("    fastest, slowest, first [s]", extremes, "")
        table.add_row("show and capture, per frame, median [ms]", f"{statistics.median(overheads):.1f}", "")
        table.add_row("whole step, median [s]", f"{statistics.median(result.duration for result in warm):.2f}", "")
        for name, (_, peak) in used.items():
            table.add_row(f"{name}: peak memory [MB]", f"{peak:.0f}", "")
        yield table


def figures(title: str) -> Table:
    """Return an empty table of measured figures and targets."""
    table = Table("figure", title=title, title_justify="left", min_width=80)
    table.add_column("measured", justify="right")
    table.add_column("target", justify="right")
    return table


def usage(running: RunningGraph) -> dict[str, tuple[float, float]]:
    """Processor time [s] and largest resident memory [MB] of each node so far."""
    used = {}
    for name in running.graph.names:
        process = Path("/proc") / str(running.pid(name))
        ticks = (process / "stat").read_text().rpartition(")")[2].split()[11:13]
        peak = (process / "status").read_text().partition("VmHWM:")[2].split()[0]
        used[name] = sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK"), int(peak) * 1024e-6
    return used


def machine() -> str:
    """Processor, cores, load and date."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    model = next((line.partition(":")[2] for line in lines if line.startswith("model name")), platform.machine())
    load, date = os.getloadavg()[0], datetime.now(UTC).date()
    return f"{model.strip()}, {os.cpu_count()} cores, load {load:.1f}, Python {platform.python_version()}, {date}"


def main() -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="length of the stream [s]")
    seconds = parser.parse_args().seconds
    console = Console(markup=False)
    console.print(f"before: {machine()}", highlight=False)
    with tempfile.TemporaryDirectory(prefix="fringedic-bench-") as folder:
        console.print(stream(seconds, Path(folder) / "stream"))
        for table in plate_steps(Path(folder) / "plate"):
            console.print(table)
    console.print(f"after: {machine()}", highlight=False)


if __name__ == "__main__":
    main()
