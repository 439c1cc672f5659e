"""Every distribution of ROS 2 with every Python of this computer: set-up, tests of nodes, a recording and its replay.

Writes docs/validation/distributions.md. Each combination is set up in a fresh clone of this checkout's last commit.
`python benchmarks/distributions.py kilted:3.13 jazzy:3.11` measures these combinations in this order and writes nothing
else; without names it measures Jazzy and Kilted with each Python that is found.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "validation" / "distributions.md"
DISTRIBUTIONS = ("jazzy", "kilted")
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
NODES = ("phase_node", "dic_node", "coupling_node", "load_frame_node", "recorder_node", "player_node", "fringedic_ros")
RIG = "tiny"
STEPS = 20
HEADER = """# Distributions of ROS 2: measured figures

This page shows with which distributions of ROS 2, Python and NumPy the system was built and tested, and whether each
replays a recording of the others. It is written by `python benchmarks/distributions.py` (`make test-matrix`).
The time of a step is a ratio to the first line; *equal* are the variables of a replay that are the same bit by bit as
those of the run.

| distribution | Python | NumPy | set-up | tests of nodes: passed, failed, skipped | step | equal in a replay of |
|---|---|---|---:|---|---:|---|"""
# Executed by the Python of a combination: versions, duration of a step at rest [s], and the results of recordings.
MEASURE = f"""
import json, os, statistics, sys, tempfile
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
        times = [rig.measure().duration for _ in range({STEPS} + 1)][1:]
print(json.dumps({{"python": sys.version.split()[0], "numpy": version("numpy"), "step_s": statistics.median(times)}}))
"""
COMPARE = """
import sys
import fringedic
first, second = (fringedic.open_experiment(path).load() for path in sys.argv[1:3])
names = set(first.data_vars) | set(second.data_vars)
different = [name for name in sorted(names) if not first.get(name, fringedic).equals(second.get(name))]
print(len(names) - len(different), len(names), *different)
"""


@dataclass
class Combination:
    """A distribution of ROS 2 with a Python, set up in a folder of its own."""

    distribution: str
    interpreter: str
    folder: Path

    @property
    def checkout(self) -> Path:
        """The fresh clone."""
        return self.folder / "fringedic"

    def set_up(self) -> float:
        """Clone and build; return the duration [s]."""
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(self.checkout)], check=True)
        begun = time.monotonic()
        subprocess.run(
            ["make", "setup"], cwd=self.checkout, env=self._environment(), check=True, stdout=subprocess.DEVNULL
        )
        return time.monotonic() - begun

    def run(self, *command: str, check: bool = True) -> str:
        """Run a command in the environment of this combination and return what it prints."""
        done = subprocess.run(
            ["bash", "-c", '. setup/environment.sh && exec "$@"', "-", *command],
            cwd=self.checkout,
            env=self._environment(),
            capture_output=True,
            text=True,
            check=False,
        )
        if check and done.returncode:
            sys.exit(f"{self.distribution}, {self.interpreter}: {' '.join(command)[:80]}\n{done.stdout}{done.stderr}")
        return done.stdout

    def _environment(self) -> dict[str, str]:
        own = ("AMENT", "CMAKE_PREFIX", "LD_", "ROS_", "PYTHONPATH", "VIRTUAL_ENV", "_ROS")
        environment = {name: value for name, value in os.environ.items() if not name.startswith(own)}
        paths = [path for path in os.environ["PATH"].split(":") if not path.startswith(str(ROOT))]
        return environment | {"PATH": ":".join(paths), "ROS": self.distribution, "PYTHON": self.interpreter}


def interpreters() -> dict[str, str]:
    """Return the Pythons of this computer by their versions."""
    found = {}
    for version in PYTHONS:
        candidates = [shutil.which(f"python{version}"), *Path.home().glob(f".pyenv/versions/{version}.*/bin/python3")]
        for candidate in candidates:
            if candidate and not subprocess.run([candidate, "-c", ""], capture_output=True, check=False).returncode:
                found[version] = os.path.realpath(candidate)
    return found


def measure(combination: Combination) -> dict[str, Any]:
    """Set up a combination, record and process an experiment, run the tests of the nodes."""
    figures: dict[str, Any] = {"distribution": combination.distribution, "setup_s": combination.set_up()}
    figures |= json.loads(combination.run("python", "-c", MEASURE).splitlines()[-1])
    combination.run("fringedic", "run", RIG, "--output", str(combination.folder / "run"))
    packages = [f"ros2_ws/src/{name}/test" for name in NODES]
    tests = combination.run("python", "-m", "pytest", "-q", "-n", "2", "--dist", "loadfile", *packages, check=False)
    counts = re.findall(r"(\d+) (passed|failed|skipped|error)", tests.splitlines()[-1])
    figures["tests"] = {outcome: int(number) for number, outcome in counts}
    figures["failed"] = re.findall(r"^FAILED (\S+)", tests, re.MULTILINE)
    return figures


def replay(there: Combination, here: Combination) -> str:
    """Replay the recording of one combination with the nodes of another; return how many variables are equal."""
    output = here.folder / f"replayed-{there.distribution}"
    here.run("fringedic", "replay", str(there.folder / "run" / "bag"), "--output", str(output))
    equal, total, *different = here.run("python", "-c", COMPARE, str(there.folder / "run"), str(output)).split()
    return f"{equal} of {total}" + (f" ({', '.join(different)} differ)" if different else "")


def page(rows: list[dict[str, Any]]) -> str:
    """Return the page."""
    lines = [HEADER]
    for row in rows:
        cells = (
            row["distribution"].capitalize(),
            row["python"],
            row["numpy"],
            f"{row['setup_s']:.0f} s",
            ", ".join(str(row["tests"].get(outcome, 0)) for outcome in ("passed", "failed", "skipped")),
            f"{row['step_s'] / rows[0]['step_s']:.2f}",
            "; ".join(row["replayed"]) or "-",
        )
        lines.append(f"| {' | '.join(cells)} |")
    failed = [f"- {row['distribution']} {row['python']}: `{name}`" for row in rows for name in row["failed"]]
    return "\n".join(lines + (["", "Failed:", "", *failed] if failed else [])) + "\n"


def main() -> None:
    """Measure the combinations one after the other."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("combinations", nargs="*", metavar="DISTRIBUTION:PYTHON")
    parser.add_argument("--folder", type=Path, help="where the clones stay, instead of a temporary folder")
    options = parser.parse_args()
    found = interpreters()
    names = options.combinations or [f"{each}:{version}" for each in DISTRIBUTIONS for version in found]
    with tempfile.TemporaryDirectory(prefix="fringedic-matrix-") as temporary:
        folder = options.folder or Path(temporary)
        done: list[tuple[Combination, dict[str, Any]]] = []
        for name in names:
            distribution, version = name.split(":")
            combination = Combination(distribution, found[version], folder / f"{distribution}-{version}")
            combination.folder.mkdir(parents=True)
            figures = measure(combination)
            figures["replayed"] = [
                f"{other.distribution} {other_figures['python']}: {replay(other, combination)}"
                for other, other_figures in done
                if other.distribution != distribution
            ]
            print(json.dumps(figures), flush=True)
            done.append((combination, figures))
    text = page([figures for _, figures in done])
    print(text)
    if not options.combinations:
        PAGE.write_text(text)


if __name__ == "__main__":
    main()
