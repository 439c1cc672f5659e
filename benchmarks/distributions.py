"""Every distribution of ROS 2 with every Python of this computer: set-up, tests of nodes, each other's recordings.

Writes docs/validation/distributions.md. Each combination is set up in a fresh clone of this checkout's last commit; a
computer that does nothing else needs about 10 minutes for each.
`python benchmarks/distributions.py jazzy:3.11 kilted:3.13` measures these combinations; without names it measures Jazzy
and Kilted with each Python that is found. The times of the first combination are those that the others are divided by.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "validation" / "distributions.md"
DISTRIBUTIONS = ("jazzy", "kilted")
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
NODES = ("fringedic_ros", "phase_node", "dic_node", "coupling_node", "recorder_node", "player_node")
RECORDED = ROOT / "ros2_ws" / "src" / "fringedic" / "test" / "recordings" / "version_0_1" / "bag"
UNREACHABLE = "the Python package index cannot be reached"
RIG = "tiny"
STEPS, ROUNDS = 10, 3
HEADER = f"""# Distributions of ROS 2

This page shows with which distributions of ROS 2, Python and NumPy the system was built and tested, and whether they
replay each other's recordings bit by bit. `make test-matrix` writes the table, with the Pythons of this computer.

Each line is a fresh clone with a set-up of its own. The tests are those of the packages `{"`, `".join(NODES)}`.
*Step* is the duration of a measured step at rest of the rig `{RIG}` (median of {STEPS} steps, smallest of
{ROUNDS} rounds in turn with the other lines) over that of the first line. *Replayed* are the variables of a
replay that are the same bit by bit as those of the run under the other distribution, and how many there are."""
FOOTER = """
Lyrical is on no package index, so that it is not in the table. What stands for it: the unit tests of the library run
with NumPy 2.4 (Lyrical has 2.3), and type hashes and serialised bytes of all messages are compared with those of the
library `rosbags` for Jazzy, Kilted and Lyrical (`ros2_ws/src/fringedic_ros/test/test_message_formats.py`)."""
TITLES = "| distribution | Python | NumPy | built | set-up | passed | failed | skipped | step | replayed |"
RULE = "|---|---|---|---|---:|---:|---:|---:|---:|---|"
# Executed by the Python of a combination with a number of steps: their median duration at rest [s], and its versions.
STEP = f"""
import json, os, platform, statistics, sys, tempfile
from importlib.metadata import version
from pathlib import Path
from fringedic_bringup.client import RigClient
from fringedic_bringup.launch.environment import private_domain
from fringedic_bringup.launch.graph import rig_graph
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.launch.rig_files import configuration
from fringedic_bringup.procedures.run import load_rig
path = configuration("{RIG}.yaml")
with tempfile.TemporaryDirectory() as folder, private_domain() as domain:
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    graph = rig_graph(load_rig(path, None, None)[0], path, Path(folder))
    with RunningGraph(graph, Path(folder) / "logs"), RigClient() as rig:
        rig.wait_until_ready(graph.names, 300.0)
        times = [rig.measure().duration for _ in range(int(sys.argv[1]) + 1)][1:]
found = {{"python": platform.python_version(), "numpy": version("numpy"), "step_s": statistics.median(times)}}
print(json.dumps(found))
"""
# Of two runs: the number of variables, and the names of those that are not the same. Attributes describe the recording.
COMPARE = """
import json, sys
import fringedic
from fringedic.audit.comparison import compare_bits
first, second = (fringedic.open_experiment(path) for path in sys.argv[1:])
different = {each.name for each in compare_bits(first.drop_attrs(deep=False), second.drop_attrs(deep=False))}
print(json.dumps([len(first.variables.keys() | second.variables.keys()), sorted(different)]))
"""


class CommandError(Exception):
    """A command of a combination failed; the message is the end of its output."""


@dataclass
class Combination:
    """A distribution of ROS 2 with a Python, in a folder of its own, and what was found."""

    distribution: str
    python: str
    interpreter: str
    folder: Path
    has_kernels: bool = False
    setup_s: float = 0.0
    numpy: str = ""
    steps_s: list[float] = field(default_factory=list)
    tests: dict[str, int] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)
    replayed: list[str] = field(default_factory=list)

    @property
    def name(self) -> str:
        """The distribution and the Python."""
        return f"{self.distribution.capitalize()} with Python {self.python}"

    @property
    def checkout(self) -> Path:
        """The fresh clone."""
        return self.folder / "fringedic"

    def set_up(self, commit: str) -> None:
        """Clone, build, and record an experiment."""
        self.folder.mkdir(parents=True)
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(self.checkout)], check=True)
        subprocess.run(["git", "checkout", "--quiet", commit], cwd=self.checkout, check=True)
        self.build()
        self.run("fringedic", "run", RIG, "--output", str(self.folder / "run"))

    def build(self) -> None:
        """Call set-up and measure its duration; a failure is told with the end of its log, which is temporary."""
        begun = time.monotonic()
        try:
            self._run("make", "setup")
        except CommandError as error:
            log = self.checkout / "setup.log"
            said = " ".join(log.read_text(errors="replace").split())[-1500:] if log.is_file() else "(none)"
            raise CommandError(f"{error}; the end of its log: {said}") from error
        self.setup_s = time.monotonic() - begun

    def test(self) -> None:
        """Run the tests of the nodes."""
        packages = [f"ros2_ws/src/{name}/test" for name in NODES]
        pytest = ("env", "--default-signal=INT,HUP", "python", "-m", "pytest", "-q", "-n", "2", "--dist", "loadfile")
        output = self.run(*pytest, *packages, check=False)
        counts = re.findall(r"(\d+) (passed|failed|skipped|error)", output.splitlines()[-1])
        self.tests = {outcome: int(number) for number, outcome in counts}
        self.remarks += re.findall(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)

    def measure_steps(self, steps: int = STEPS) -> None:
        """Measure the duration of a step once more."""
        found = json.loads(self.run("python", "-c", STEP, str(steps)).splitlines()[-1])
        self.python, self.numpy = found["python"], found["numpy"]
        self.steps_s.append(found["step_s"])

    def replay(self, other: Combination) -> None:
        """Replay the recording of another combination, and compare the results with those of its run."""
        output = self.folder / f"replayed-{other.distribution}"
        self.run("fringedic", "replay", str(other.folder / "run" / "bag"), "--output", str(output))
        total, different = self.compare(other.folder / "run", output)
        self.replayed.append(f"{other.name}: {total - len(different)} of {total}")
        self.remarks += [f"`{name}` differs in the replay of {other.name}" for name in different]

    def compare(self, one: Path, other: Path) -> tuple[int, list[str]]:
        """Return how many variables two runs have, and which of them are not the same bit by bit."""
        total, different = json.loads(self.run("python", "-c", COMPARE, str(one), str(other)).splitlines()[-1])
        return total, different

    def attempt(self, action: Callable[[], None]) -> bool:
        """Return whether an action succeeded; what failed becomes a remark."""
        try:
            action()
        except CommandError as error:
            self.remarks.append(str(error))
            return False
        return True

    def run(self, *command: str, check: bool = True) -> str:
        """Run a command in the environment of this combination and return what it prints."""
        return self._run("bash", "-c", '. setup/environment.sh && exec "$@"', "-", *command, check=check)

    def _run(self, *command: str, check: bool = True) -> str:
        done = subprocess.run(
            command,
            cwd=self.checkout,
            env=self._environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        if check and done.returncode:
            raise CommandError(f"`{' '.join(command[-4:])[:80]}` failed: " + " ".join(done.stdout.split())[-600:])
        return done.stdout

    def _environment(self) -> dict[str, str]:
        """Return the environment without what this checkout and another `make` have added."""
        own = ("AMENT", "CMAKE_PREFIX", "LD_", "MAKE", "ROS_", "PYTHONPATH", "VIRTUAL_ENV", "_ROS")
        environment = {name: value for name, value in os.environ.items() if not name.startswith(own)}
        paths = [path for path in os.environ["PATH"].split(":") if not path.startswith(str(ROOT))]
        tests = {"OPENBLAS_NUM_THREADS": "1", "ROS_PYTHON_CHECK_FIELDS": "1"}  # as of setup/check.sh
        tests |= {"KERNELS": "no"} if self.has_kernels else {}
        return environment | tests | {"PATH": ":".join(paths), "ROS": self.distribution, "PYTHON": self.interpreter}


def interpreters() -> dict[str, str]:
    """Return the Pythons of this computer by their versions."""
    found = {}
    for version in PYTHONS:
        own = [str(path) for path in Path.home().glob(f".pyenv/versions/{version}.*/bin/python3")]
        for candidate in (shutil.which(f"python{version}"), *own):
            if candidate and not subprocess.run([candidate, "-c", ""], capture_output=True, check=False).returncode:
                found[version] = candidate
    return found


def measure(combinations: list[Combination]) -> None:
    """Set up and test the combinations one after the other, then measure those that were built beside each other."""
    commit = subprocess.check_output(["git", "rev-parse", "HEAD"], cwd=ROOT, text=True).strip()
    for each in combinations:
        if each.attempt(partial(each.set_up, commit)):
            each.attempt(each.test)
            each.attempt(each.measure_steps)
        print(each.name, f"{each.setup_s:.0f} s", each.tests, each.remarks, flush=True)
    working = [each for each in combinations if each.steps_s]
    for each in working:
        for other in [other for other in working if other.distribution != each.distribution][:1]:
            each.attempt(partial(each.replay, other))
            print(each.name, each.replayed, each.remarks, flush=True)
    for _ in range(1, ROUNDS):
        for each in working:
            each.attempt(each.measure_steps)


def smoke() -> str:
    """Set up the other distribution than that of this checkout, and replay a recording with the nodes of both.

    The Python is that of this checkout, so that its compiled kernels are valid.

    Returns
    -------
    str
        What was done, or why the test is left out.

    Raises
    ------
    CommandError
        A command failed, or the results are not the same bit by bit.
    """
    begun = time.monotonic()
    here = (ROOT / ".venv" / "stamps" / "distribution").read_text()
    if not any((ROOT / ".venv").glob("lib/python3.*/site-packages/rclpy")):
        return f"is left out: ROS 2 {here} is sourced, and would be sourced for the other one, too"
    other = next(each for each in DISTRIBUTIONS if each != here)
    python = os.path.realpath(sys.executable)
    with tempfile.TemporaryDirectory(prefix="fringedic-smoke-") as folder:
        version = platform.python_version()
        both = [Combination(each, version, python, Path(folder) / each, has_kernels=True) for each in (here, other)]
        for each in both:
            each.folder.mkdir()
        both[0].checkout.symlink_to(ROOT)
        copy_sources(both[1].checkout)
        try:
            both[1].build()
        except CommandError as error:
            if UNREACHABLE in str(error):
                return f"{both[1].name} is left out: {UNREACHABLE}"
            raise
        both[1].measure_steps(1)
        replayed = [each.folder / "replayed" for each in both]
        for each, output in zip(both, replayed, strict=True):
            each.run("fringedic", "replay", str(RECORDED), "--output", str(output))
        total, different = both[0].compare(*replayed)
        if different:
            raise CommandError(f"{both[1].name} replays other values than {both[0].name}: {', '.join(different)}")
        times = os.times()
        processor = times.children_user + times.children_system
        return (
            f"{both[1].name}: {total} variables of a replay as with {both[0].name}; {time.monotonic() - begun:.0f} s "
            f"(set-up {both[1].setup_s:.0f} s), {processor:.0f} s of processor time"
        )


def copy_sources(target: Path) -> None:
    """Copy the files of this checkout with their times, and with the compiled kernels that fit them."""
    names = subprocess.check_output(["git", "ls-files"], cwd=ROOT, text=True).splitlines()
    library = ROOT / "ros2_ws" / "src" / "fringedic"
    # without the mark of `fringedic.warm_up` the first command would delete the kernels and compile them again
    kernels = [path for pattern in ("*.nb[ic]", "fringedic-warm-up") for path in library.rglob(pattern)]
    for name in (*names, *(str(path.relative_to(ROOT)) for path in kernels)):
        if (ROOT / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, target / name)


def page(combinations: list[Combination]) -> str:
    """Return the page."""
    lines, first = [HEADER, "", TITLES, RULE], combinations[0]
    for each in combinations:
        cells = (
            each.distribution.capitalize(),
            each.python,
            each.numpy or "-",
            "yes" if each.setup_s else "no",
            f"{each.setup_s:.0f} s" if each.setup_s else "-",
            *(str(each.tests.get(outcome, 0)) if each.tests else "-" for outcome in ("passed", "failed", "skipped")),
            f"{min(each.steps_s) / min(first.steps_s):.2f}" if each.steps_s and first.steps_s else "-",
            "; ".join(each.replayed) or "-",
        )
        lines.append(f"| {' | '.join(cells)} |")
    remarks = [f"- {each.name}: {remark}" for each in combinations for remark in each.remarks]
    load = statistics.fmean(os.getloadavg())
    system = platform.freedesktop_os_release()["PRETTY_NAME"]
    lines += ["", f"{os.cpu_count()} cores, {system}, load average {load:.0f} at the end."]
    lines += ["", "Not as expected:", "", *remarks] if remarks else []
    return "\n".join([*lines, FOOTER]) + "\n"


def main() -> None:
    """Measure the combinations and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("combinations", nargs="*", metavar="DISTRIBUTION:PYTHON")
    parser.add_argument("--smoke", action="store_true", help="a short test of the distribution that is not installed")
    parser.add_argument("--output", type=Path, default=PAGE, help="the page that is written")
    options = parser.parse_args()
    if options.smoke:
        try:
            print("smoke test:", smoke())
        except CommandError as error:
            sys.exit(f"smoke test: {error}")
        return
    found = interpreters()
    names = options.combinations or [f"{each}:{version}" for each in DISTRIBUTIONS for version in found]
    with tempfile.TemporaryDirectory(prefix="fringedic-matrix-") as folder:
        combinations = []
        for name in names:
            distribution, _, version = name.partition(":")
            if distribution not in DISTRIBUTIONS or version not in found:
                sys.exit(f"{name}: name {' or '.join(DISTRIBUTIONS)} with a Python of these: {', '.join(found)}")
            place = Path(folder) / name.replace(":", "-")
            combinations.append(Combination(distribution, version, found[version], place))
        measure(combinations)
        text = page(combinations)
    print(text)
    options.output.write_text(text)


if __name__ == "__main__":
    main()
