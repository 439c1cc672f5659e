"""`ros2 launch fringedic_bringup rig.launch.py`: every documented line, and the processes that it describes."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
from collections.abc import Iterable
from pathlib import Path

import pytest
import yaml
from launch_stand_in import Node, launched, running
from running_system import CONFIG, ROOT

from fringedic.errors import ConfigurationError
from fringedic.recording.reader import BagReader
from fringedic_bringup.client import RigClient
from fringedic_bringup.launch.environment import node_environment
from fringedic_bringup.launch.processes import GRACE_S, RECORDER_GRACE_S
from fringedic_msgs.msg import StepStatus

LINE = re.compile(r"ros2 launch fringedic_bringup rig\.launch\.py([^\n`]*)")
LINES = sorted({line.strip() for page in ROOT.glob("docs/**/*.md") for line in LINE.findall(page.read_text())})
PROCESSING = ("phase", "dic", "coupling", "experiment", "recorder")


def parameters(node: Node) -> dict[str, object]:
    (file,) = node.parameters
    return yaml.safe_load(Path(file).read_text())["/**"]["ros__parameters"]


@pytest.mark.parametrize("line", LINES)
def test_each_documented_line_finds_its_files(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(CONFIG / "plate.yaml", tmp_path / "bench.yaml")  # a rig file of one's own
    nodes = launched(monkeypatch, **dict(word.split(":=") for word in line.split()))
    assert nodes
    assert all(Path(file).is_relative_to(tmp_path) for node in nodes for file in node.parameters)


def test_the_documentation_has_such_lines() -> None:
    assert "" in LINES, "the line without arguments"
    assert any("nodes:=" in line for line in LINES)


def test_the_environment_is_that_of_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (
        "FASTRTPS_DEFAULT_PROFILES_FILE",
        "FASTDDS_DEFAULT_PROFILES_FILE",
        "FRINGEDIC_SEGMENT_BYTES",
        "FRINGEDIC_ADDRESS",
        "MALLOC_ARENA_MAX",
    ):
        monkeypatch.delenv(name, raising=False)
    expected = node_environment()
    for node in launched(monkeypatch, rig="tiny", folder=str(tmp_path / "run")):
        assert {**os.environ, **node.additional_env} == expected
        grace = RECORDER_GRACE_S if node.name == "recorder" else GRACE_S
        assert float(node.sigterm_timeout) == grace[signal.SIGINT]
        assert float(node.sigkill_timeout) == GRACE_S[signal.SIGTERM]


def test_arguments_reach_the_nodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    arguments = {"namespace": "left/rig", "log_level": "warn", "use_sim_time": "true", "respawn": "true"}
    nodes = launched(monkeypatch, rig="tiny", folder="run", nodes="camera, recorder,phase", **arguments)
    assert [node.name for node in nodes] == ["recorder", "phase", "camera"]
    assert {node.namespace for node in nodes} == {"left/rig"}
    assert {node.name: node.respawn for node in nodes} == {"recorder": False, "phase": True, "camera": True}
    assert all(node.ros_arguments == ["--log-level", "warn"] for node in nodes)
    assert all(parameters(node)["use_sim_time"] is True for node in nodes)
    assert parameters(nodes[0])["bag_path"] == str(tmp_path / "run" / "bag")


def test_nodes_of_several_sensors_are_in_their_namespaces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = str(CONFIG / "two_sensors.yaml")
    nodes = launched(monkeypatch, rig=rig, folder=str(tmp_path / "run"), nodes="load_frame,right/camera")
    assert [(node.namespace, node.name) for node in nodes] == [("rig", "load_frame"), ("rig/right", "camera")]
    assert nodes[0].remappings == []
    assert ("load_frame/state", "/rig/load_frame/state") in nodes[1].remappings
    assert parameters(nodes[1])["sensor"] == "right"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"nodes": "camera,lens"}, "no lens; it has recorder"),
        ({"rig": "plates"}, "no such rig file; installed with fringedic are"),
        ({"log_level": "loud"}, "launch argument log_level:=loud"),
        ({"namespace": "2rigs"}, "namespace"),
    ],
)
def test_a_wrong_argument_is_named(
    arguments: dict[str, str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ConfigurationError, match=words):
        launched(monkeypatch, **{"rig": "tiny", "folder": str(tmp_path / "run")} | arguments)


@pytest.mark.slow
def test_two_sides_measure_and_a_step_that_ctrl_c_cuts_off_has_an_error_record(
    domain: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = yaml.safe_load((CONFIG / "tiny.yaml").read_text())
    content["camera"]["settle_ms"] = 150.0  # so that Ctrl-C comes before the last frame on a busy computer, too
    (tmp_path / "slow.yaml").write_text(yaml.safe_dump(content))
    folder = {"rig": str(tmp_path / "slow.yaml"), "folder": str(tmp_path / "run")}
    here = launched(monkeypatch, **folder, nodes=",".join(PROCESSING))
    there = launched(monkeypatch, **folder, nodes="camera,projector,load_frame,stage")
    names = [node.name for node in (*here, *there)]
    with running(here + there, tmp_path, domain) as processes, RigClient() as rig:
        rig.wait_until_ready(names)
        for process in processes.values():
            assert os.getsid(process.pid) == process.pid, "a session of its own, as with the command"
        for position in (0.0, 1e-4):
            rig.move(position)
            assert rig.measure().valid_fraction > 0.5
        begun = rig.last_step
        with pytest.raises(KeyboardInterrupt):
            rig.measure(feedback=lambda feedback: _interrupt(feedback.frame, processes.values()))
    bag = BagReader(tmp_path / "run" / "bag")
    topic = bag.find("experiment/step")["experiment/step"]
    last = [message for _, message, _ in bag.messages([topic])][-1]
    assert (last.step, last.stage) == (begun + 1, StepStatus.ERROR)
    assert "was ended during the step" in last.error_message
    assert not bag.lost


def _interrupt(frame: int, processes: Iterable[subprocess.Popen[bytes]]) -> None:
    """Press Ctrl-C after the third frame, for the nodes too: the step would have ended before the client has."""
    if frame >= 3:
        for process in processes:
            process.send_signal(signal.SIGINT)
        raise KeyboardInterrupt
