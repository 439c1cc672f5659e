"""The subcommands that need no ROS, by the table of docs/command.md, run where ROS cannot be imported."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
import pyvista
from running_system import free_port
from scipy.ndimage import gaussian_filter
from typer.main import get_command

from fringedic.command.main import app
from fringedic.command.plugins import load_commands

ROOT = Path(__file__).parents[4]
WITHOUT_ROS = ROOT / "tests" / "without_ros"
BAG = ROOT / "ros2_ws" / "src" / "fringedic" / "test" / "recordings" / "version_0_1" / "bag"
PLANNED = ROOT / "ros2_ws" / "src" / "fringedic_bringup" / "config" / "planned.yaml"
TABLE = re.findall(
    r"^\| `fringedic ([\w-]+) ?([^`]*)` \| .* \| (yes|no)([^|]*) \|$", (ROOT / "docs" / "command.md").read_text(), re.M
)
ROS_FREE_OPTION = re.compile(r"no with `(--[a-z]+)`")

# Runs the commands given as JSON one after the other, and writes their exit codes and outputs as JSON.
RUNNER = """
import faulthandler, json, os, signal, socket, sys, threading, time, traceback
faulthandler.dump_traceback_later(270, exit=True)
from typer.testing import CliRunner
from fringedic.command.main import app

def draw():
    "Draws a triangle in the window of `fringedic region`, as a person does."
    import pygame
    while not (pygame.display.get_init() and pygame.display.get_surface()):
        time.sleep(0.02)
    for place in ((100, 80), (400, 80), (400, 300)):
        for kind in (pygame.MOUSEBUTTONDOWN, pygame.MOUSEBUTTONUP):
            pygame.event.post(pygame.event.Event(kind, pos=place, button=1))
    pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.K_RETURN))

def end(port):
    "Presses Ctrl-C when the page of `fringedic view` is served."
    while socket.socket().connect_ex(("127.0.0.1", port)):
        time.sleep(0.05)
    os.kill(os.getpid(), signal.SIGINT)

results = {}
for title, words in json.load(sys.stdin).items():
    if words[0] == "region" and "--help" not in words:
        threading.Thread(target=draw, daemon=True).start()
    if words[0] == "view" and "--help" not in words:
        threading.Thread(target=end, args=[int(words[-1])], daemon=True).start()
    done = CliRunner().invoke(app, words)
    error = "".join(traceback.format_exception(done.exception)) if done.exception else ""
    results[title] = [done.exit_code, done.output, error]
json.dump(results, open(sys.argv[1], "w"))
"""


@dataclass(frozen=True)
class Outcome:
    """Exit code, output and traceback of a command."""

    code: int
    output: str
    error: str


def commands(folder: Path) -> dict[str, list[str]]:
    """Return the arguments of every command that needs no ROS, or needs none with an option, by its name."""
    images = [str(folder / f"static-{number}.png") for number in range(3)]
    bag = str(folder / "run" / "bag")
    dataset = str(folder / "without_ros.nc")
    return {
        "init": [
            *("init", str(folder / "bench.yaml"), "--camera", "aravis", "--image-size", "1280x960", "--display", "1"),
            *("--camera-address", "192.168.5.20", "--projector-size", "1920x1080", "--grid-pitch-mm", "0.5"),
            *("--operator", "Ada"),
        ],
        "measure": ["measure", *images, "--spacing", "4", "--output", str(folder / "measured")],
        "phase": [
            *("phase", str(folder / "fringes"), "--description", str(folder / "fringes" / "phase.yaml")),
            *("--output", str(folder / "phases")),
        ],
        "advise": ["advise", *images],
        "plan": ["plan", str(PLANNED), "--set", "plan.angle_degree=30", "--output", str(folder / "plan.html")],
        "check": ["check", str(folder / "acceptance.yaml"), "--vdi", "--output", str(folder / "check")],
        "noise": ["noise", *(word for image in images for word in ("--images", image)), "--output", str(folder / "n")],
        "region": ["region", images[0], "--output", str(folder / "region.png")],
        "target": ["target", "--pitch-mm", "0.5", "--output", str(folder / "grid.pdf")],
        "info": ["info", bag],
        "verify": ["verify", bag],
        "attach": ["attach", str(folder / "run"), str(folder / "grip.csv"), "--offset", "0.1 +- 0.05"],
        "note": ["note", str(folder / "run"), "from another laboratory"],
        "audit": ["audit", str(folder / "run"), "--no-recompute"],
        "recover": ["recover", bag, "--output", str(folder / "recovered")],
        "process": ["process", bag, "--output", dataset],
        "evaluate": ["evaluate", str(folder / "run")],  # without a name, it lists them
        "compare": ["compare", dataset, dataset, "--output", str(folder / "compared.html")],
        "campaign": ["campaign", "run", str(folder / "campaign")],
        "export": ["export", dataset, "--to", "netcdf", "--output", str(folder / "exported")],
        "report": ["report", dataset, "--output", str(folder / "report.html")],
        "compare-model": [
            *("compare-model", dataset, str(folder / "plate.vtp"), "--unit", "mm", "--by", "position"),
            *(
                "--load=100",
                "--step=2",
                "--output",
                str(folder / "compared"),
                "--load-table",
                str(folder / "loads.csv"),
            ),
        ],
        "compare-model --shape": [
            *("compare-model", dataset, str(folder / "plate.vtp"), "--unit", "mm", "--shape"),
            *("--output", str(folder / "shape")),
        ],
        "view": ["view", dataset, "--port", str(free_port())],
        # a recording of an experiment is read and refused, because a calibration of this size is too long for a test
        "calibrate": ["calibrate", "--from", bag, "--output", str(folder / "calibration")],
        # a recording of one sensor is read and refused for the same reason
        "register": ["register", bag, "--balls-mm", "10"],
    }


def environment() -> dict[str, str]:
    """Return the environment of a process that cannot import ROS and draws on a display in memory."""
    paths = os.pathsep.join(filter(None, [str(WITHOUT_ROS), os.environ.get("PYTHONPATH")]))
    return {**os.environ, "PYTHONPATH": paths, "DISPLAY": "none", "SDL_VIDEODRIVER": "dummy", "COLUMNS": "200"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("commands")


@pytest.fixture(scope="module")
def outcomes(folder: Path) -> dict[str, Outcome]:
    """Run all commands, and the help of every subcommand, in one process that cannot import ROS."""
    shutil.copytree(BAG, folder / "run" / "bag")
    (folder / "campaign").mkdir()
    (folder / "campaign" / "campaign.yaml").write_text("recordings: [{path: ../run}]")
    rng = np.random.default_rng(5)
    texture = gaussian_filter(rng.normal(size=(160, 200)), 1.5)
    grey = 128 + 35 * texture / texture.std()
    sheet = pyvista.Plane(i_size=400, j_size=400).triangulate()
    sheet.point_data["displacement"] = 1e-3 * sheet.points
    sheet.save(folder / "plate.vtp")
    (folder / "loads.csv").write_text("step,load\n" + "".join(f"{number},{number / 10}\n" for number in range(20)))
    for number in range(3):
        noisy = grey + rng.normal(0, 2, grey.shape)
        cv2.imwrite(str(folder / f"static-{number}.png"), np.clip(noisy, 0, 255).astype(np.uint8))
    (folder / "grip.csv").write_text("time [s];grip [degC]\n0.0;20.5\n100.0;21.5\n")
    (folder / "acceptance.yaml").write_text(
        "{camera: {source: virtual}, projector: {source: virtual}, calibration: virtual_rig, "
        "virtual_rig: {preset: plate, size: tiny}, acceptance: {ball_diameter_mm: 14, "
        "bar_spacing_mm: 30, volume_mm: [55, 40, 20]}}"
    )
    (folder / "fringes").mkdir()
    for shift in range(4):
        fringes = 120 + 60 * np.cos(2 * np.pi * (np.arange(200) / 20 - shift / 4)) + rng.normal(0, 2, (160, 200))
        cv2.imwrite(str(folder / "fringes" / f"{shift}.png"), fringes.round().astype(np.uint8))
    (folder / "fringes" / "phase.yaml").write_text(
        "{direction: vertical, projector_px: 200, fringes: [{pitch_px: 20, images: [0.png, 1.png, 2.png, 3.png], "
        "shifts: [4, 1, 2, 3]}]}"
    )
    load_commands()
    wanted = commands(folder) | {f"{name} --help": [name, "--help"] for name in get_command(app).commands}
    done = subprocess.run(
        [sys.executable, "-c", RUNNER, str(folder / "results.json")],
        input=json.dumps(wanted),
        env=environment(),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    results = json.loads((folder / "results.json").read_text())
    return {name: Outcome(*result) for name, result in results.items()}


@pytest.mark.parametrize("module", ["rclpy", "sensor_msgs.msg", "fringedic_msgs.msg", "fringedic_ros", "camera_node"])
def test_ros_is_blocked(module: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", f"import {module}"], env=environment(), capture_output=True, text=True, check=False
    )
    assert "ROS is blocked" in done.stderr


def test_table_lists_every_command() -> None:
    load_commands()
    assert sorted(name for name, *_ in TABLE) == sorted(get_command(app).commands)


@pytest.mark.parametrize(
    "name", [name for name, _, needs, rest in TABLE if needs == "no" or ROS_FREE_OPTION.search(rest)]
)
def test_command_runs_without_ros(name: str, outcomes: dict[str, Outcome]) -> None:
    outcome = outcomes[name]
    if name == "calibrate":
        assert "RecordingError" in outcome.error
        assert "experiment/plane" in outcome.error
    elif name == "register":
        assert "contains the sensor sensor only: a recording of two or more sensors is needed" in outcome.error
    elif name == "audit":  # an earlier version has signed nothing at the end of this run
        assert (outcome.code, outcome.output.splitlines()[-1].split(":")[0]) == (1, "verdict")
    else:
        assert outcome.code == 0, outcome.output + outcome.error


@pytest.mark.parametrize("name", [name for name, *_ in TABLE])
def test_help_shows_an_example_without_ros(name: str, outcomes: dict[str, Outcome]) -> None:
    outcome = outcomes[f"{name} --help"]
    assert outcome.code == 0, outcome.error
    assert f"Example: fringedic {name}" in outcome.output


def test_a_command_that_starts_nodes_says_in_one_sentence_what_is_missing(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "fringedic", "run", str(PLANNED.with_name("tiny.yaml")), "--output", str(tmp_path)]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 1
    [sentence] = done.stderr.splitlines()
    assert sentence.startswith("ROS 2 is needed, and its module")


def test_results_are_written(folder: Path, outcomes: dict[str, Outcome]) -> None:
    assert outcomes
    names = (
        "measured/displacement.nc",
        "n/noise_floor.yaml",
        "region.png",
        "region.yaml",
        "grid.pdf",
        "recovered",
        "bench.yaml",
        "plan.html",
        "check/acceptance.html",
    )
    for name in (*names, "without_ros.nc", "report.html"):
        assert (folder / name).exists(), name
    assert list((folder / "exported").glob("*.nc"))
    page = (folder / "compared" / "comparison.html").read_text(encoding="utf-8")
    assert "The shape is" in page
    assert list((folder / "compared").glob("*_vtk/*.pvd"))
    assert list((folder / "compared" / "mesh").glob("*.pvd"))
    assert outcomes["compare-model --shape"].code == 0, outcomes["compare-model --shape"].error
    assert "peak to valley" in (folder / "shape" / "comparison.html").read_text(encoding="utf-8")
