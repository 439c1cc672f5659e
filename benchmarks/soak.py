"""A long test: the tiny virtual rig measures step after step, with its camera free-running at 30 frames/s in between.

``python benchmarks/soak.py --minutes 60`` counts what the recording lost and how the memory of every node grows. A
fixed computation after every step shows whether steps get longer or the computer slower.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from recording import counts
from rich.console import Console
from rich.table import Table
from system import figures, machine

from fringedic.configuration.sections import ExtensometerSection
from fringedic.errors import StepFailedError
from fringedic.recording import BagReader
from fringedic_bringup.client import RigClient
from fringedic_bringup.launch.environment import private_domain
from fringedic_bringup.launch.graph import rig_graph
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.launch.rig_files import configuration
from fringedic_bringup.procedures.run import load_rig
from fringedic_ros.testing import node_pids

WARM_UP = 100  # steps until buffers, histories and compiled kernels have their final size
FARTHEST = 6e-4  # [m] crosshead
SPEED = 5e-3  # [m/s]
STROKES = 20  # positions of the crosshead before it goes back
RATE_HZ = 30.0


@dataclass
class Soak:
    """What was noted after every step.

    Attributes
    ----------
    memory
        Resident memory of each node [kB].
    durations
        Duration of each successful step [s].
    computations
        Processor time of the fixed computation after each successful step [s].
    failures
        Messages of the steps that failed.
    """

    memory: dict[str, list[int]] = field(default_factory=dict)
    durations: list[float] = field(default_factory=list)
    computations: list[float] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)

    def note(self, folder: Path) -> None:
        """Note the memory of all nodes of the run."""
        for name, pid in node_pids(folder).items():
            with suppress(OSError):  # it has just ended, and the next step says so
                status = Path(f"/proc/{pid}/status").read_text()
                self.memory.setdefault(name, []).append(int(status.split("VmRSS:")[1].split()[0]))


def fixed_computation() -> float:
    """Return the processor time of a computation that is always the same [s], 2 to 4 ms."""
    begin = time.thread_time()
    sum(number * number for number in range(50_000))
    return time.thread_time() - begin


def growth(sizes: list[int]) -> tuple[float, float]:
    """Return slope and its standard uncertainty [kB per step] by least squares."""
    (slope, _), covariance = np.polyfit(np.arange(len(sizes)), sizes, 1, cov=True)
    return float(slope), float(np.sqrt(covariance[0, 0]))


@contextmanager
def rig(folder: Path) -> Iterator[RigClient]:
    """Run the nodes of the tiny rig and an extensometer, which makes the camera run free."""
    path = configuration("tiny.yaml")
    tiny, _ = load_rig(path, None, None)
    gauge = ExtensometerSection(first_px=[50, 60], second_px=[110, 60], subset_px=32, rate_hz=RATE_HZ)
    graph = rig_graph(tiny.model_copy(update={"extensometer": gauge}), path, folder, experiment="soak")
    with (
        private_domain() as domain,
        RunningGraph(graph, folder / "logs", domain=domain) as running,
        RigClient(graph.namespace, domain=domain, watch=running.check) as client,
    ):
        client.wait_until_ready(graph.names)
        yield client


def soak(folder: Path, seconds: float) -> Soak:
    """Measure until the time is over."""
    noted = Soak()
    end = time.monotonic() + seconds
    with rig(folder) as client:
        number = 0
        while time.monotonic() < end:
            client.move(FARTHEST * (number % STROKES) / STROKES, SPEED)
            try:
                noted.durations.append(client.measure().duration)
                noted.computations.append(fixed_computation())
            except StepFailedError as error:
                noted.failures.append(str(error))
            noted.note(folder)
            number += 1
    return noted


def losses(bag: Path) -> tuple[int, int, int]:
    """Return the images and records in a recording, and how many are missing by the counts of their publisher."""
    found = {topic.removeprefix("/rig/"): each for topic, each in counts(bag).items()}
    images, records = found["camera/image_raw"], found["camera/exposure"]
    return images[0], records[0], images[1] + records[1]


def tenths(seconds: list[float]) -> str:
    """Return the median of each tenth of a series after the warm-up [ms], with three digits."""
    medians = [1e3 * np.median(tenth) for tenth in np.array_split(seconds[WARM_UP:], 10)]
    return " ".join(f"{median:#.3g}".rstrip(".") for median in medians)


def table_of(noted: Soak, bag: Path, minutes: float) -> Table:
    """Return the figures beside their targets."""
    steps = len(noted.durations) + len(noted.failures)
    table = figures(f"{steps} steps of the tiny rig in {minutes:g} min, free run at {RATE_HZ:g} Hz between them")
    images, records, missing = losses(bag)
    table.add_row("images, records; missing", f"{images}, {records}; {missing}", "0 missing")
    table.add_row("damage of the recording", BagReader(bag, check=True).lost or "none", "none")
    table.add_row("failed steps", f"{len(noted.failures)}", "0")
    first, last = noted.durations[WARM_UP : 2 * WARM_UP], noted.durations[-WARM_UP:]
    table.add_row(
        f"duration of a step, steps {WARM_UP} to {2 * WARM_UP} / last {WARM_UP}, median [s]",
        f"{statistics.median(first):.3f} / {statistics.median(last):.3f}",
        "equal",
    )
    table.add_row("duration of a step, tenths of the test, medians [ms]", tenths(noted.durations), "-")
    table.add_row("processor time of a fixed computation, the same [ms]", tenths(noted.computations), "-")
    for name, sizes in sorted(noted.memory.items()):
        half = (WARM_UP + len(sizes)) // 2
        slopes = [f"{slope:+.2f} ± {sigma:.2f}" for slope, sigma in map(growth, (sizes[WARM_UP:half], sizes[half:]))]
        value = f"{sizes[-1] / 1024:.0f} MB, {', '.join(slopes)} kB per step"
        table.add_row(f"memory of {name}, growth in both halves", value, "flat")
    return table


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="length of the test [min]")
    minutes: float = parser.parse_args().minutes
    console = Console(markup=False, width=140)
    console.print(f"before: {machine()}", highlight=False)
    with tempfile.TemporaryDirectory(prefix="fringedic-soak-") as name:
        folder = Path(name) / "run"
        noted = soak(folder, 60 * minutes)
        if len(noted.durations) < 2 * WARM_UP:
            parser.error(f"{len(noted.durations)} steps are too few for these figures; give more --minutes")
        console.print(table_of(noted, folder / "bag", minutes))
    for failure in noted.failures:
        console.print(failure, highlight=False)


if __name__ == "__main__":
    main()
