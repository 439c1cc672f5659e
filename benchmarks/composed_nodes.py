"""Processor time and latency of a step with phase, dic and coupling in processes of their own, and in one process.

Fringe steps of the shipped plate, from image files. Both graphs see the same images, one after the other in the same
run; a ratio below 1 says that the composed nodes need less. A second table shows what a node pays for a frame that it
does not need: as a deserialised message, and as bytes of which only the stamp is read.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from ament_index_python.packages import get_package_share_directory
from rclpy.serialization import serialize_message
from rich.console import Console
from rich.table import Table
from sensor_msgs.msg import Image
from system import machine, render_steps, usage

from fringedic.settings.camera import FilesCamera
from fringedic_bringup.client import RigClient
from fringedic_bringup.launch.environment import private_domain
from fringedic_bringup.launch.graph import PROCESSING_NODES, rig_graph
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.procedures.run import load_rig
from fringedic_ros.images import image_message
from fringedic_ros.serialized import header_stamp, image_view, read

CALLS = 100


@dataclass(frozen=True)
class Measured:
    """Of one graph: processor time of the processing nodes per step, latency, whole step [s]; memory [MB]."""

    processor: float
    latency: float
    duration: float
    memory: float


def measure(path: Path, images: Path, folder: Path, steps: int, *, composed: bool) -> Measured:
    """Measure steps; the first, in which kernels are loaded, does not count."""
    rig, _ = load_rig(path, None, None)
    camera = FilesCamera(files=str(images))
    nodes = rig.nodes.model_copy(update={"composed": composed})
    rig = rig.model_copy(update={"camera": camera, "nodes": nodes, "load_frame": None})
    graph = rig_graph(rig, path, folder, experiment="bench")
    with (
        private_domain() as domain,
        RunningGraph(graph, folder / "logs", domain=domain) as running,
        RigClient(graph.namespace, domain=domain, watch=running.check) as client,
    ):
        client.wait_until_ready(graph.names)
        client.measure()
        before = usage(running)
        results = [client.measure() for _ in range(steps - 1)]
        after = usage(running)
        pids = {running.pid(name): name for name in PROCESSING_NODES}  # one name of each process
    return Measured(
        sum(after[name][0] - before[name][0] for name in pids.values()) / len(results),
        statistics.median(result.processing_time for result in results),
        statistics.median(result.duration for result in results),
        sum(after[name][1] for name in pids.values()),
    )


def compare(separate: Measured, composed: Measured, title: str) -> Table:
    """Return both graphs beside each other."""
    table = Table("figure", "separate", "composed", "ratio", title=title, title_justify="left", min_width=80)
    for name, text in (
        ("processor", "processor time of phase, dic and coupling per step [s]"),
        ("latency", "last exposure to displacement cloud, median [s]"),
        ("duration", "whole step, median [s]"),
        ("memory", "largest memory of their processes together [MB]"),
    ):
        one, other = getattr(separate, name), getattr(composed, name)
        table.add_row(text, f"{one:.3g}", f"{other:.3g}", f"{other / one:.2f}")
    return table


def unneeded_frames(frames: int, shape: tuple[int, int]) -> Table:
    """Return the processor time of a step's frames in a node that needs none of them, and in one that needs all."""
    pixels = np.random.default_rng(0).integers(0, 255, shape, np.uint8)
    data = serialize_message(image_message(pixels, stamp_ns=1, frame_id="camera"))
    title = f"{frames} frames of {shape[1]}x{shape[0]} in a node"
    table = Table("read as", "per step [ms]", "ratio", title=title, title_justify="left", min_width=80)
    whole = _per_call(lambda: read(data, Image))
    for name, call in (("stamp alone", lambda: header_stamp(data)), ("view of the pixels", lambda: image_view(data))):
        cost = _per_call(call)
        table.add_row(name, f"{1e3 * frames * cost:.3f}", f"{cost / whole:.4f}")
    table.add_row("message", f"{1e3 * frames * whole:.3f}", "1")
    return table


def _per_call(call: Callable[[], object]) -> float:
    begin = time.process_time()
    for _ in range(CALLS):
        call()
    return (time.process_time() - begin) / CALLS


def main() -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rig", default="plate", help="an installed rig file with a virtual rig")
    parser.add_argument("--steps", type=int, default=6, help="steps of each graph, the first of which does not count")
    arguments = parser.parse_args()
    path = Path(get_package_share_directory("fringedic_bringup")) / "config" / f"{arguments.rig}.yaml"
    console = Console(markup=False)
    console.print(f"before: {machine()}", highlight=False)
    with tempfile.TemporaryDirectory(prefix="fringedic-bench-") as folder:
        images = Path(folder) / "images"
        frames, shape = render_steps(path, images, arguments.steps)
        separate, composed = (
            measure(path, images, Path(folder) / name, arguments.steps, composed=name == "composed")
            for name in ("separate", "composed")
        )
    console.print(
        compare(separate, composed, f"Steps of {frames} frames of {shape[1]}x{shape[0]}, rig {arguments.rig}")
    )
    console.print(unneeded_frames(frames, shape))
    console.print(f"after: {machine()}", highlight=False)


if __name__ == "__main__":
    main()
