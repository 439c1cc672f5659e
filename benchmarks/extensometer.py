"""The virtual extensometer on a free-running camera: rate, latency from the exposure, error, processor share.

Real nodes in processes of their own. The camera takes images of a speckle pattern stretched by known strains in turn,
so that every strain tells which frame it was measured in.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
from lifecycle_msgs.msg import Transition
from rich.console import Console
from rich.table import Table
from std_msgs.msg import Bool, Float64
from system import Probe, figures, machine, usage

from fringedic_bringup.client import RigClient
from fringedic_bringup.launch.environment import private_domain
from fringedic_bringup.launch.graph import Graph, NodeEntry
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_ros.qos import STATE

RATE_HZ = 30.0
WANTED_HZ = 25.0
WANTED_MS = 60.0
STRAINS = np.array([0, 1000, 2000, 3000, 3500, 2500, 1500, 500]) * 1e-6
NOISE = 1.0  # [grey level]
PAD = 48  # [px]


def write_images(folder: Path, size: tuple[int, int]) -> None:
    """Write speckles, drawn smooth and then stretched about the middle column, one image for each strain."""
    rows, columns = size
    random = np.random.default_rng(1)
    pattern = cv2.GaussianBlur(random.normal(size=size).astype(np.float32), (0, 0), 1.5)
    pattern *= 40 / pattern.std()
    row, column = np.mgrid[0:rows, 0:columns].astype(np.float32)
    middle = (columns - 1) / 2
    for number, strain in enumerate(STRAINS):
        material = ((column - middle) / (1 + strain) + middle).astype(np.float32)
        moved = cv2.remap(pattern, material, row, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT)
        image = 120 + moved + random.normal(0, NOISE, size)
        cv2.imwrite(str(folder / f"{number}.pgm"), np.clip(image.round(), 0, 255).astype(np.uint8))


def measure(seconds: float, folder: Path, size: tuple[int, int], others: tuple[NodeEntry, ...], title: str) -> Table:
    """Camera, extensometer and recorder, with `others` running."""
    images = folder / "images"
    images.mkdir(parents=True)
    write_images(images, size)
    rows, columns = size
    camera = {"source": "files", "files": str(images), "repeat": True, "frame_rate_hz": RATE_HZ, "autostart": False}
    pads = {
        "first_px": [columns // 4, rows // 2],
        "second_px": [3 * columns // 4, rows // 2],
        "subset_px": PAD,
    }
    nodes = (
        NodeEntry("recorder", "recorder_node", "recorder", {"bag_path": str(folder / "bag")}),
        NodeEntry("extensometer", "dic_node", "extensometer", pads),
        *others,
        NodeEntry("camera", "camera_node", "camera", camera),
    )
    graph = Graph("bench", nodes)
    read: list[tuple[int, float]] = []
    valid: list[bool] = []
    with (
        private_domain() as domain,
        RunningGraph(graph, folder / "logs", domain=domain) as running,
        RigClient("bench", domain=domain, watch=running.check) as client,
        closing(Probe(domain, running.check)) as probe,
    ):
        probe.listen(Float64, "extensometer/strain", lambda message: read.append((time.time_ns(), message.data)), STATE)
        probe.listen(Bool, "extensometer/valid", lambda message: valid.append(message.data), STATE)
        probe.camera(Transition.TRANSITION_CONFIGURE)
        client.wait_until_ready(graph.names)
        probe.pause(2.0)
        probe.camera(Transition.TRANSITION_ACTIVATE)
        probe.pause(2.0)  # the first frames load compiled kernels
        probe.exposures.clear(), read.clear(), valid.clear()
        idle, begin = usage(running), time.monotonic()
        probe.pause(seconds)
        duration, busy = time.monotonic() - begin, usage(running)
        exposures = {each.index: each.header.stamp for each in probe.exposures}
        read, invalid = [each for each in read if not np.isnan(each[1])], valid.count(False)
        probe.camera(Transition.TRANSITION_DEACTIVATE)
    latencies, errors = [], []
    for arrived, strain in read:
        # the first frame need not have been the reference: all strains are known up to one factor
        image = int(np.argmin(np.abs(STRAINS - strain)))
        errors.append(strain - STRAINS[image])
        stamps = [s.sec * 10**9 + s.nanosec for index, s in exposures.items() if index % len(STRAINS) == image]
        before = [stamp for stamp in stamps if stamp <= arrived]
        if before:
            latencies.append(1e-6 * (arrived - max(before)))
    table = figures(title)
    table.add_row("frames of the camera per second", f"{len(exposures) / duration:.1f}", f">= {WANTED_HZ:g}")
    table.add_row("strains per second", f"{len(read) / duration:.1f}", f">= {WANTED_HZ:g}")
    table.add_row("invalid, of all", f"{invalid} of {len(read) + invalid}", "0")
    table.add_row("latency from the exposure, median [ms]", f"{statistics.median(latencies):.1f}", f"<= {WANTED_MS:g}")
    table.add_row("    95 % below [ms]", f"{np.quantile(latencies, 0.95):.1f}", f"<= {WANTED_MS:g}")
    table.add_row("    largest [ms]", f"{max(latencies):.1f}", "")
    table.add_row("error of the strain, RMS [µstrain]", f"{1e6 * np.sqrt(np.mean(np.square(errors))):.1f}", "")
    for name, (time_used, peak) in busy.items():
        share = (time_used - idle[name][0]) / duration
        table.add_row(f"{name}: share of one core, peak memory", f"{share:.0%}, {peak:.0f} MB", "")
    return table


def main() -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="length of each stream [s]")
    seconds = parser.parse_args().seconds
    console = Console(markup=False)
    console.print(f"before: {machine()}", highlight=False)
    processing = tuple(NodeEntry(name, f"{name}_node", name) for name in ("phase", "dic", "coupling"))
    with tempfile.TemporaryDirectory(prefix="fringedic-bench-") as folder:
        for name, size, others, title in (
            ("region", (480, 640), (), "Virtual extensometer, region of 640x480, recorded"),
            (
                "whole",
                (960, 1280),
                processing,
                "Virtual extensometer, 1280x960, recorded, with phase, dic and coupling running",
            ),
        ):
            console.print(measure(seconds, Path(folder) / name, size, others, title))
    console.print(f"after: {machine()}", highlight=False)


if __name__ == "__main__":
    main()
