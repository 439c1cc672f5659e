"""Time that a test loses by a killed node: random kills of every node of a rig while a programme runs.

``python benchmarks/killed_nodes.py 200`` kills 200 times, in runs of 20, and prints the figures so far after each run;
without a number 20 times. The rig is the virtual one, or with ``devices`` behind the number that of the tests with real
protocols: a GigE Vision camera, a display and a machine with Modbus TCP.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import statistics
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, suppress
from itertools import pairwise
from pathlib import Path

sys.path.extend(
    str(Path(__file__).resolve().parents[1] / folder)
    for folder in ("tests", "ros2_ws/src/fringedic/test/report/page_server")
)
from test_real_devices import RIGS, devices

from fringedic.command.outcome import RunReport
from fringedic.configuration.programme import Programme
from fringedic_bringup.launch.environment import private_domain
from fringedic_bringup.launch.graph import PROCESSING_NODES
from fringedic_bringup.launch.rig_files import configuration
from fringedic_bringup.procedures.run import load_rig, run_experiment
from fringedic_ros.testing import node_pids

NODES = ("recorder", "projector", "camera", "load_frame", "experiment")
OF_THE_VIRTUAL_RIG = ("stage", *PROCESSING_NODES)  # that of devices is recorded only
IN_ONE_RUN = 20
LONGEST_DELAY_S = 1.2  # a step of this rig takes 0.6 s
SECOND = 0.3  # probability of a second kill within 3 s


class Victims:
    """Receives the progress of a run, kills nodes, and keeps the time of each step."""

    def __init__(self, folder: Path, kills: int, seed: int, nodes: tuple[str, ...]) -> None:
        self._nodes = nodes
        self._random = random.Random(seed)
        self._folder, self._started = folder, time.monotonic()
        self._planned = {3 + 2 * number + self._random.randrange(2) for number in range(kills)}
        self.starts: dict[int, float] = {}
        self.killed: list[tuple[int, str]] = []

    def stage(self, text: str) -> None:
        """Ignore what is being done now."""

    def note(self, text: str) -> None:
        """Tell what happened to the nodes."""
        print(f"{time.monotonic() - self._started:8.1f} s  {text}", file=sys.stderr)

    def part(self, *_: object) -> None:
        """Ignore parts of procedures: no node is killed in them."""

    def step(self, number: int, *_: object) -> None:
        """Plan a kill when one of the chosen steps begins."""
        if number in self.starts:
            return
        self.starts[number] = time.monotonic()
        if len(self.starts) in self._planned:  # a repeated step takes two numbers
            delay = self._random.uniform(0, LONGEST_DELAY_S)
            threading.Timer(delay, self._kill, (self._random.choice(self._nodes),)).start()
            if self._random.random() < SECOND:
                delay = self._random.uniform(0, 3.0)
                threading.Timer(delay, self._kill, (self._random.choice(self._nodes),)).start()

    def _kill(self, name: str) -> None:
        with suppress(KeyError, ProcessLookupError):  # it has just ended
            os.kill(node_pids(self._folder)[name], signal.SIGKILL)
            self.killed.append((max(self.starts), name))

    def lost(self) -> dict[str, list[float]]:
        """Return the time [s] that each kill cost its step, by node; that of a pair counts for both."""
        hit = {number for number, _ in self.killed}
        durations = {n: self.starts[after] - self.starts[n] for n, after in pairwise(sorted(self.starts))}
        usual = statistics.median(value for number, value in durations.items() if number not in hit)
        found: dict[str, list[float]] = {}
        for number, name in self.killed:
            if number in durations:
                found.setdefault(name, []).append(durations[number] - usual)
        return found


def run(folder: Path, kills: int, seed: int, *, with_devices: bool) -> tuple[RunReport, Victims]:
    """Run a programme of two steps for each kill."""
    ramp = {"from_mm": 0.0, "to_mm": 0.6, "steps": 2 * kills + 4, "speed_mm_per_s": 2.0}
    programme = Programme.model_validate({"experiment": "killed", "ramp": ramp})
    victims = Victims(folder / "run", kills, seed, NODES if with_devices else NODES + OF_THE_VIRTUAL_RIG)
    path, first_programme = configuration("tiny.yaml"), None
    with ExitStack() as closing:
        if with_devices:
            shutil.copytree(RIGS, folder / "rig")
            path, first_programme = folder / "rig" / "devices.yaml", RIGS / "ten_steps.yaml"
            closing.enter_context(devices(folder / "rig"))
        rig, _ = load_rig(path, first_programme, None)
        domain = closing.enter_context(private_domain())
        return run_experiment(rig, path, programme, folder / "run", victims, domain=domain), victims


def main(kills: int, *, with_devices: bool) -> None:
    """Print the time lost by node, and what was not measured, after each run."""
    lost: dict[str, list[float]] = {}
    steps = failed = missing = early = 0
    for seed in range(-(-kills // IN_ONE_RUN)):
        with tempfile.TemporaryDirectory() as folder:
            report, victims = run(Path(folder), min(kills, IN_ONE_RUN), seed, with_devices=with_devices)
        if report.interrupted:
            sys.exit("interrupted: any figures above are those of the runs before this one")
        for name, values in victims.lost().items():
            lost.setdefault(name, []).extend(values)
        steps += len(report.steps)
        failed += sum(bool(step.error) for step in report.steps)
        missing += sum(step.missing for step in report.steps)
        early += bool(report.ended_early)
        print("| node | kills | time lost, median | largest |\n|---|---|---|---|")
        everything = [value for values in lost.values() for value in values]
        for name, values in [*sorted(lost.items()), ("all", everything)]:
            print(f"| {name} | {len(values)} | {statistics.median(values):.1f} s | {max(values):.1f} s |")
        print(f"{steps} steps: {failed} failed, {missing} frames missing, {early} runs ended early", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else IN_ONE_RUN, with_devices="devices" in sys.argv[2:])
