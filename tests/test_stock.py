"""The tools of an installed ROS 2: launch file, command and recording."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from pathlib import Path

import pytest
from running_system import RecordedExperiment

from fringedic.recording.reader import BagReader
from fringedic_bringup.client import RigClient
from fringedic_bringup.launch.graph import rig_graph
from fringedic_bringup.launch.launch_arguments import LaunchArguments
from fringedic_bringup.procedures.run import load_rig

pytestmark = [
    pytest.mark.stock,
    pytest.mark.skipif(shutil.which("ros2") is None, reason="no ROS 2 with its tools is sourced"),
]
LAUNCH = ("ros2", "launch", "fringedic_bringup", "rig.launch.py")


def output_of(*command: str) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout


def test_the_launch_file_lists_its_arguments() -> None:
    listed = output_of(*LAUNCH, "--show-args")
    assert all(f"'{name}'" in listed for name in LaunchArguments.model_fields)


def test_the_command_runs() -> None:
    assert "Usage" in output_of("ros2", "run", "fringedic_bringup", "fringedic", "--help")


@pytest.mark.slow
def test_a_launched_rig_measures_and_closes_its_recording(tiny: Path, tmp_path: Path) -> None:
    rig, _ = load_rig(tiny, None, None)
    names = rig_graph(rig, tiny, tmp_path / "names").names
    folder = tmp_path / "run"
    launch = subprocess.Popen([*LAUNCH, f"rig:={tiny}", f"folder:={folder}"], start_new_session=True)
    try:
        with RigClient() as client:
            client.wait_until_ready(names)
            for position in (0.0, 1e-4):
                client.move(position)
                assert client.measure().valid_fraction > 0.5
    finally:
        os.killpg(launch.pid, signal.SIGINT)
        launch.wait(300)
    assert not BagReader(folder / "bag").lost


def test_ros2_bag_reads_a_recording(recorded: RecordedExperiment) -> None:
    listed = output_of("ros2", "bag", "info", str(recorded.report.folder / "bag"))
    assert "fringedic_msgs/msg/Exposure" in listed
