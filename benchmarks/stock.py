"""A stock ROS 2 laboratory: a step under `ros2 launch` and under the command, and a rig on two hosts.

The launch file is read by the stand-in of the tests, which starts the nodes as launch_ros does. The two hosts are
network namespaces, which need root.
"""

from __future__ import annotations

import os
import signal
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

sys.path.extend(
    str(Path(__file__).resolve().parents[1] / folder)
    for folder in ("tests", "ros2_ws/src/fringedic/test/report/page_server")
)
from launch_stand_in import launched
from test_two_hosts import PROCESSING_SIDE, RIG_SIDE, lost_images
from two_hosts import Side, two_hosts, why_not

from fringedic.errors import StepFailedError
from fringedic_bringup.client import RigClient
from fringedic_bringup.launch.environment import private_domain
from fringedic_bringup.launch.graph import rig_graph
from fringedic_bringup.launch.processes import RECORDER_GRACE_S, RunningGraph
from fringedic_bringup.launch.rig_files import configuration
from fringedic_bringup.procedures.run import load_rig

RIG = "plate"  # 1280x960, 16 frames a step
ROUNDS, STEPS, HOST_STEPS = 2, 6, 20
CUT_S = 10.0
LOSS = 0.01
READY_S = 300.0  # a busy computer starts ten nodes slowly


@contextmanager
def by_command(folder: Path) -> Iterator[list[str]]:
    """Start the nodes of the rig as the command does."""
    path = configuration(f"{RIG}.yaml")
    graph = rig_graph(load_rig(path, None, None)[0], path, folder)
    with RunningGraph(graph, folder / "logs"):
        yield graph.names


@contextmanager
def by_launch(folder: Path) -> Iterator[list[str]]:
    """Start the nodes of the rig as the launch file does."""
    with pytest.MonkeyPatch.context() as patch:
        nodes = launched(patch, rig=RIG, folder=str(folder))
    processes = [node.start(folder / f"{node.name}.txt", os.environ["ROS_DOMAIN_ID"]) for node in nodes]
    try:
        yield [node.name for node in nodes]
    finally:
        for process in processes:
            process.send_signal(signal.SIGINT)
        for process in processes:
            process.wait(RECORDER_GRACE_S[signal.SIGINT])


def step_times(names: list[str]) -> list[float]:
    """Return the durations [s] of steps at rest; the first, in which a virtual camera renders, is left out."""
    with RigClient() as rig:
        rig.wait_until_ready(names, READY_S)
        return [duration for _ in range(STEPS + 1) if (duration := step_time(rig)) is not None][1:]


def step_time(rig: RigClient) -> float | None:
    """Return the duration of a step [s]; None when it failed, as on an overloaded computer."""
    try:
        return float(rig.measure().duration)
    except StepFailedError as error:
        print(f"  {error}")
        return None


def compare(folder: Path) -> None:
    """Print the time of a step under launch and under the command, measured in turns."""
    times: dict[str, list[float]] = {"fringedic run": [], "ros2 launch": []}
    for number in range(ROUNDS):
        for name, start in (("fringedic run", by_command), ("ros2 launch", by_launch)):
            with private_domain() as domain:
                os.environ["ROS_DOMAIN_ID"] = str(domain)
                with start(folder / f"{name.split()[-1]}{number}") as names:
                    times[name] += step_times(names)
    for name, values in times.items():
        print(f"{name:14} {statistics.median(values):6.2f} s a step ({min(values):.2f} to {max(values):.2f})")
    ratio = statistics.median(times["ros2 launch"]) / statistics.median(times["fringedic run"])
    print(f"ratio {ratio:.3f} (target: at most 1.05)")


def measure_steps(processing: Side, name: str) -> set[int]:
    """Print steps per minute and failures; return the numbers of the steps that succeeded."""
    answers = [processing.ask("measure") for _ in range(HOST_STEPS)]
    done = [answer for answer in answers if not answer["error"]]
    durations = [answer["duration"] for answer in done]
    rate = 60 / statistics.median(durations) if done else 0.0
    print(
        f"{name}: {len(done)} of {HOST_STEPS} steps, {rate:.1f} a minute, the longest {max(durations, default=0):.1f} s"
    )
    for answer in answers:
        if answer["error"]:
            print(f"  {answer['error']}")
    return {answer["step"] for answer in done}


def measure_hosts(folder: Path) -> None:
    """Print steps per minute of a rig on two hosts, without and with lost packets, and what a cut link costs."""
    rig = configuration(f"{RIG}.yaml")
    finished = set()
    with (
        private_domain() as domain,
        two_hosts() as (there, here),
        Side(here, rig, folder / "here", PROCESSING_SIDE, str(domain)) as processing,
        Side(there, rig, folder / "there", RIG_SIDE, str(domain)) as camera,
    ):
        print(f"ready after {processing.ask('ready')['duration']:.1f} s")
        processing.ask("measure")  # the virtual camera renders
        finished |= measure_steps(processing, "without loss")
        for host in (there, here):
            host.lose(LOSS)
        finished |= measure_steps(processing, f"{LOSS:.0%} of the packets lost")
        print(f"{there.lost()} and {here.lost()} packets lost")
        for host in (there, here):
            host.lose(0.0)
        processing.tell("measure")
        time.sleep(0.5)
        camera.host.plug("down")
        time.sleep(CUT_S)
        camera.host.plug("up")
        back = time.monotonic()
        print(f"link cut for {CUT_S:g} s: {processing.answer()['error']}")
        while (answer := processing.ask("step", 0.01))["error"]:
            print(f"  again: {answer['error']}")
        finished.add(answer["step"])
        print(f"first step that succeeds: {time.monotonic() - back:.1f} s after the link is back")
        camera.crash()
        answer = processing.ask("measure")
        print(f"host gone: after {answer['duration']:.1f} s {answer['error']}")
    print(f"{lost_images(folder / 'here' / 'run' / 'bag', finished)} images of {len(finished)} finished steps lost")


def main() -> None:
    """Print both tables."""
    with tempfile.TemporaryDirectory() as folder:
        compare(Path(folder))
        reason = why_not()
        if reason:
            print(f"two hosts are not measured: {reason}")
        else:
            measure_hosts(Path(folder))


if __name__ == "__main__":
    main()
