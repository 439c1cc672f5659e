"""What a recording loses: images at 30 frames/s beside load samples at 1 kHz, and the frames of one step on time.

Real nodes in processes of their own. Every message carries its publisher's own count, which the recorder writes down:
gaps in it are messages that were lost on the way.
"""

from __future__ import annotations

import argparse
import shutil
import statistics
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from mcap.reader import make_reader
from rich.console import Console
from rich.table import Table
from system import RATE_HZ, SIZE, WANTED_HZ, figures, free_run, machine, noise_images

from camera_node.testing import FakeCamera
from fringedic_bringup.client import RigClient
from fringedic_bringup.launch.environment import private_domain
from fringedic_bringup.launch.graph import Graph, NodeEntry, rig_graph
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.procedures.run import load_rig

LOAD_HZ = 1000.0
LOAD_TOPICS = ("load_frame/state", "load_frame/wrench", "load_frame/joint_states")
STEP_FRAMES = 20
STEP_HZ = 30.0
STEP_S = 1.0
STEPS = 6
FAKE_CAMERA = "arv-fake-gv-camera-0.8"


def counts(bag: Path) -> dict[str, tuple[int, int]]:
    """Messages of each topic in a recording, and how many of those between its first and last are missing."""
    seen: dict[str, list[int]] = {}
    for file in sorted(bag.glob("*.mcap")):
        with file.open("rb") as stream:
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False):
                seen.setdefault(channel.topic.removeprefix("/bench/"), []).append(message.sequence)
    return {topic: (len(each), max(each) - min(each) + 1 - len(each)) for topic, each in seen.items()}


def stream(seconds: float, folder: Path, camera: dict[str, Any], title: str) -> Table:
    """Images and load samples to the recorder."""
    nodes = (
        NodeEntry("recorder", "recorder_node", "recorder", {"bag_path": str(folder / "bag")}),
        NodeEntry("load_frame", "load_frame_node", "load_frame", {"rate_hz": LOAD_HZ}),
        NodeEntry("camera", "camera_node", "camera", camera | {"frame_rate_hz": RATE_HZ, "autostart": False}),
    )
    run = free_run(nodes, seconds, folder)
    recorded = counts(folder / "bag")
    begun = run.begun
    table = figures(title)
    table.add_row("frames per second", f"{run.rate:.2f}", f">= {WANTED_HZ:g}")
    table.add_row("frames, omitted by the camera", f"{begun}, {run.exposures[-1].dropped}", "0 omitted")
    for topic in ("camera/image_raw", "camera/exposure"):
        table.add_row(f"{topic}: recorded, missing", f"{recorded[topic][0]}, {begun - recorded[topic][0]}", "0 missing")
    for topic in LOAD_TOPICS:
        found, missing = recorded[topic]
        table.add_row(f"{topic}: recorded, missing", f"{found}, {missing}", "0 missing")
    run.add_shares(table)
    return table


def one_step(folder: Path, camera: dict[str, Any]) -> Table:
    """A fringe step with a settled projector and a camera that exposes for a whole frame period."""
    path = Path(get_package_share_directory("fringedic_bringup")) / "config" / "plate.yaml"
    rig, _ = load_rig(path, None, None)
    rig = rig.model_copy(update={"sequence": rig.sequence.model_copy(update={"shifts": [STEP_FRAMES // 4]})})
    graph = rig_graph(rig, path, folder / "run", experiment="bench")
    replaced = {
        "camera": camera | {"exposure_ms": 1e3 / STEP_HZ},
        "experiment": {**next(n for n in graph.nodes if n.name == "experiment").parameters, "record_only": True},
    }
    wanted = ("recorder", "projector", "camera", "experiment")
    graph = Graph(
        graph.namespace,
        tuple(
            replace(node, parameters=replaced.get(node.name, node.parameters))
            for node in graph.nodes
            if node.name in wanted
        ),
    )
    with (
        private_domain() as domain,
        RunningGraph(graph, folder / "logs", domain=domain) as running,
        RigClient(graph.namespace, domain=domain, watch=running.check) as client,
    ):
        client.wait_until_ready(graph.names)
        durations = [client.measure().duration for _ in range(STEPS)][1:]
    table = figures(f"One step of {STEP_FRAMES} frames of {SIZE[1]}x{SIZE[0]}, each exposed for 1/{STEP_HZ:g} s")
    table.add_row("begin to end, median [s]", f"{statistics.median(durations):.2f}", f"<= {STEP_S:g}")
    table.add_row("    fastest, slowest [s]", f"{min(durations):.2f}, {max(durations):.2f}", "")
    return table


def main() -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="length of each stream [s]")
    seconds = parser.parse_args().seconds
    console = Console(markup=False)
    console.print(f"before: {machine()}", highlight=False)
    with tempfile.TemporaryDirectory(prefix="fringedic-bench-") as name:
        folder = Path(name)
        images = noise_images(folder / "images")
        files = {"source": "files", "files": str(images), "repeat": True}
        size = f"{SIZE[1]}x{SIZE[0]}"
        title = f"Images of {size} from files and load samples at {LOAD_HZ:g} Hz for {seconds:g} s, recorded"
        console.print(stream(seconds, folder / "files", files, title))
        virtual = {"source": "virtual", "virtual_rig": "{preset: plate}"}
        title = f"Images of {size} of the virtual camera and load samples at {LOAD_HZ:g} Hz, recorded"
        console.print(stream(seconds, folder / "virtual", virtual, title))
        aravis = {"source": "aravis", "width": SIZE[1], "height": SIZE[0]}
        title = f"Images of {size} of the Aravis fake camera and load samples at {LOAD_HZ:g} Hz, recorded"
        if shutil.which(FAKE_CAMERA) is None:
            console.print(f"not measured: {title}; one step. Install {FAKE_CAMERA} (Debian: aravis-tools)")
            return
        with FakeCamera():
            console.print(stream(seconds, folder / "aravis", aravis, title))
            console.print(one_step(folder / "step", aravis))
    console.print(f"after: {machine()}", highlight=False)


if __name__ == "__main__":
    main()
