"""Part of a rig on one host: rig_side.py RIG FOLDER NODE...

With the node `experiment` it is also a client, which answers the lines of its input with one line of JSON each.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from fringedic.configuration.rig_file import load_rig_file
from fringedic.errors import StepFailedError, WaitTimeoutError
from fringedic_bringup.client import RigClient
from fringedic_bringup.launch.graph import Graph, rig_graph
from fringedic_bringup.launch.processes import RunningGraph

# A virtual rig waits two minutes for a frame.
CAMERA_TIMEOUT = {"experiment": {"camera_timeout_s": 4.0}, "camera": {"timeout_s": 4.0}}


def part(graph: Graph, names: set[str]) -> Graph:
    """Return the part of a graph that runs on this host."""
    chosen = [node for node in graph.nodes if node.name in names]
    limited = [replace(node, parameters={**node.parameters, **CAMERA_TIMEOUT.get(node.name, {})}) for node in chosen]
    return Graph(graph.namespace, tuple(limited))


def answers(rig: RigClient, names: list[str]) -> Iterator[dict[str, Any]]:
    """Yield the answer to each line: ``ready``, ``measure``, ``step POSITION_MM``."""
    for line in sys.stdin:
        word, *values = line.split()
        began = time.monotonic()
        answer: dict[str, Any] = {"error": ""}
        try:
            if word == "ready":
                rig.wait_until_ready(names)
            else:
                if word == "step":
                    rig.move(1e-3 * float(values[0]), speed=5e-3)
                result = rig.measure()
                answer |= {"step": result.step, "frames": result.recorded_frames, "valid": result.valid_fraction}
        except (StepFailedError, WaitTimeoutError) as error:
            answer["error"] = str(error)
        yield answer | {"duration": time.monotonic() - began}


@contextmanager
def client(names: set[str]) -> Iterator[RigClient | None]:
    """Yield a client beside the experiment node, else nothing."""
    if "experiment" not in names:
        yield None
        return
    with RigClient() as rig:
        yield rig


def main() -> None:
    """Run the nodes until the end of the input."""
    path, folder, names = Path(sys.argv[1]), Path(sys.argv[2]), set(sys.argv[3:])
    graph = rig_graph(load_rig_file(path), path, folder / "run")
    with RunningGraph(part(graph, names), folder / "run" / "logs"), client(names) as rig:
        if rig is None:
            sys.stdin.read()
            return
        for answer in answers(rig, graph.names):
            sys.stdout.write(json.dumps(answer) + "\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
