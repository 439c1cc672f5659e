"""The command alone, and with subcommands of another package."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from fringedic.command import main, plugins
from fringedic.command.app import app

HELLO = """
from fringedic.command.app import app, say

@app.command()
def hello() -> None:
    "Greet."
    say("hello from the bench")
"""


def fringedic(folder: Path, code: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run the command where a package is installed whose module of subcommands contains some code."""
    (folder / "bench_commands.py").write_text(code)
    package = folder / "bench-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: bench\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[fringedic.commands]\nbench = bench_commands\n")
    paths = os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH")]))
    command = [sys.executable, "-m", "fringedic", *words]
    environment = {**os.environ, "PYTHONPATH": paths}
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)


def test_another_package_adds_a_subcommand(tmp_path: Path) -> None:
    done = fringedic(tmp_path, HELLO, "hello")
    assert done.stdout == "hello from the bench\n", done.stderr


def test_a_package_that_cannot_be_imported_is_named_in_one_sentence(tmp_path: Path) -> None:
    done = fringedic(tmp_path, "raise RuntimeError('no driver on this computer')", "hello")
    assert done.returncode == 1
    assert done.stderr.splitlines() == [
        "the commands of the package bench cannot be imported: no driver on this computer; repair or uninstall it"
    ]


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """The library without other packages, whose subcommands another test may have added."""
    monkeypatch.setattr(plugins, "entry_points", lambda **_: [])
    own = [
        each for each in app.registered_commands if each.callback and each.callback.__module__.startswith("fringedic.")
    ]
    monkeypatch.setattr(app, "registered_commands", own)
    plugins.load_commands.cache_clear()


@pytest.mark.usefixtures("alone")
@pytest.mark.parametrize(
    ("words", "code"), [(["run", "plate.yaml"], 2), (["calibrate", "RIG"], 1), (["noise", "RIG"], 1)]
)
def test_what_needs_nodes_says_in_one_sentence_what_is_missing(
    words: list[str], code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        "{camera: {source: virtual}, projector: {source: virtual}, virtual_rig: {preset: plate, size: tiny}}"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["fringedic", *(str(rig) if word == "RIG" else word for word in words)])
    monkeypatch.setattr(main, "_interrupt_at_end_of_session", lambda: None)  # for the process of the tests
    with pytest.raises(SystemExit) as ended:
        main.main()
    assert ended.value.code == code
    [sentence] = capsys.readouterr().err.splitlines()
    assert "fringedic_bringup" in sentence
    assert "install ROS 2" in sentence


def test_a_missing_module_of_ros_is_one_sentence() -> None:
    with (
        pytest.raises(plugins.ConfigurationError, match="its module rclpy is missing: install ROS 2"),
        plugins.ros_as_sentence(),
    ):
        raise ModuleNotFoundError("No module named 'rclpy'", name="rclpy.node")
    with pytest.raises(ModuleNotFoundError), plugins.ros_as_sentence():
        raise ModuleNotFoundError("No module named 'h5py'", name="h5py")
