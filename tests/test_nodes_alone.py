"""Every node starts alone by hand, from its executable, and ends at Ctrl-C."""

from __future__ import annotations

import os
import re
import signal
import subprocess
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix
from running_system import ROOT, wait_until

NODES = {
    "projector": ("fringe_projector_node", []),
    "camera": ("camera_node", ["-p", 'virtual_rig:="{preset: plate, size: tiny}"']),
    "load_frame": ("load_frame_node", []),
    "phase": ("phase_node", []),
    "dic": ("dic_node", []),
    "coupling": ("coupling_node", []),
    "experiment": ("experiment_node", []),
    "recorder": ("recorder_node", []),
    "signals": ("load_frame_node", []),
    "stage": ("load_frame_node", []),
    "live_view": ("camera_node", []),
    "extensometer": ("dic_node", ["-p", "first_px:=[160, 240]", "-p", "second_px:=[480, 240]"]),
}


def executable(package: str, name: str) -> str:
    return str(Path(get_package_prefix(package), "lib", package, name))


def test_the_pages_start_nodes_by_paths_that_are_installed() -> None:
    pages = {page.name: page.read_text() for page in (ROOT / "docs" / "nodes").glob("*.md")}
    named = {name: re.findall(r"ros2_ws/install/lib/(\w+)/(\w+)", text) for name, text in pages.items()}
    assert all(named.values()), "every page starts its node without the command ros2"
    missing = [each for found in named.values() for each in found if not Path(executable(*each)).exists()]
    assert not missing


def test_every_node_starts_and_ends_by_hand(tmp_path: Path) -> None:
    import rclpy
    from rclpy.context import Context

    context = Context()
    rclpy.init(context=context)
    observer = rclpy.create_node("observer", context=context)
    started = {}
    for name, (package, arguments) in NODES.items():
        with (tmp_path / name).open("w") as log:
            started[name] = subprocess.Popen(
                [executable(package, name), "--ros-args", "-r", "__ns:=/bench", *arguments],
                stdout=log,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
            )
    try:
        wait_until(
            lambda: (
                {("/bench", name) for name in NODES}
                <= {(space, name) for name, space in observer.get_node_names_and_namespaces()}
            ),
            "the start of every node",
        )
        codes = {}
        for process in started.values():
            process.send_signal(signal.SIGINT)
        for name, process in started.items():
            codes[name] = process.wait(timeout=300)
        unclean = [name for name, code in codes.items() if code]
        assert not unclean, {name: (codes[name], (tmp_path / name).read_text()) for name in unclean}
    finally:
        for process in started.values():
            if process.poll() is None:
                process.kill()
                process.wait()
        observer.destroy_node()
        context.try_shutdown()


@pytest.mark.parametrize(
    ("package", "name", "parameter", "words"),
    [
        ("dic_node", "dic", "window:=-1", "window"),
        ("camera_node", "camera", "exposure_ms:=.nan", "exposure_ms"),
        ("experiment_node", "experiment", "calibration_file:=/no/such/file.yaml", "/no/such/file.yaml"),
    ],
)
def test_unusable_parameters_at_start(package: str, name: str, parameter: str, words: str) -> None:
    done = subprocess.run(
        [executable(package, name), "--ros-args", "-p", parameter],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env=os.environ,
    )
    assert done.returncode == 1
    assert words in done.stderr + done.stdout
