"""The command with nodes: a run, its recording in all other commands, and runs that are interrupted or killed."""

from __future__ import annotations

import dataclasses
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from running_system import RecordedExperiment, wait_until
from typer.testing import CliRunner, Result

import fringedic
from fringedic.audit import audit_run
from fringedic.command.main import app
from fringedic.errors import ConfigurationError, ProcessError
from fringedic.evidence import read_log
from fringedic.frames.messages import image_array
from fringedic.recording.reader import BagReader
from fringedic.rig.model import RigModel
from fringedic_ros.testing import node_pids

FRAMES = 12


def fringedic_command(*words: str | Path | int) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


def test_a_run_leaves_recording_dataset_truth_and_pictures(recorded: RecordedExperiment) -> None:
    folder = recorded.report.folder
    names = {path.name for path in folder.iterdir()}
    assert {"bag", "results.nc", "report.html", "truth.nc", "calibration.yaml", "logs"} <= names
    assert {"step_002.png", "step_002_errors.png"} <= names
    counts = {name.removeprefix("/rig/"): count for name, count in BagReader(folder / "bag").counts.items()}
    assert counts["camera/image_raw"] == counts["camera/exposure"] == 3 * FRAMES
    assert counts["experiment/step"] == 3 * (FRAMES + 3)
    assert counts["coupling/displacement"] == counts["coupling/status"] == 3
    with fringedic.open_experiment(folder / "results.nc") as dataset:
        errors = dataset.fringedic.compare_with_truth(folder / "truth.nc")
        assert list(dataset.step.values) == [0, 1, 2]
        moved = [float(abs(dataset.v.sel(step=step)).mean()) for step in (0, 1, 2)]
    assert moved[0] == 0 < moved[1] < moved[2]
    assert float(errors.error_v.sel(step=2)) < 8, "1/50 px at 400 µm per pixel"


def test_a_run_prints_progress_and_a_table(recorded: RecordedExperiment) -> None:
    assert "starting 9 nodes" in recorded.output
    for step in (0, 1, 2):
        assert f"step {step} (last: 2): " in recorded.output
    assert "errors are RMS against the ground truth" in recorded.output
    assert f"{recorded.report.folder}: report.html, recording (bag)" in " ".join(recorded.output.split())


def test_info_export_and_recover(recorded: RecordedExperiment, tmp_path: Path) -> None:
    folder = recorded.report.folder
    shown = fringedic_command("info", folder / "bag")
    assert shown.exit_code == 0
    assert "/rig/camera/image_raw" in shown.stdout
    assert "36" in shown.stdout
    exported = fringedic_command("export", folder / "bag", "--output", tmp_path / "exported")
    assert exported.exit_code == 0, exported.exception
    assert (tmp_path / "exported" / "tiny.nc").exists()
    assert (tmp_path / "exported" / "tiny_png" / "step_001.png").exists()
    words = ("export", folder / "results.nc", "--to", "csv", "--to", "netcdf", "--step", 1)
    again = fringedic_command(*words, "--output", tmp_path / "exported")
    assert "tiny.nc exists already" in again.stdout
    assert "1 of 2 formats" in str(again.exception)
    assert (tmp_path / "exported" / "tiny_csv" / "step_001.csv").exists()
    verified = fringedic_command("verify", folder / "bag")
    assert verified.exit_code == 0, verified.stdout
    assert verified.stdout.splitlines()[-1] == "36 of 36 frames, 0 lost"
    assert "fit manifest.sha256" in verified.stdout
    saved = fringedic_command("recover", folder / "bag", "--output", tmp_path / "saved")
    assert saved.exit_code == 0, saved.exception
    assert "lost: nothing" in saved.stdout.splitlines()
    assert BagReader(tmp_path / "saved").counts == BagReader(folder / "bag").counts


def test_failed_recording_is_named_and_the_others_are_processed(recorded: RecordedExperiment, tmp_path: Path) -> None:
    words = ("process", tmp_path / "nowhere", recorded.report.folder / "bag", "--step", "1", "--reference", "2")
    done = fringedic_command(*words, "--output", tmp_path / "desk")
    assert "nowhere: no such recording" in done.stdout
    assert str(done.exception) == f"failed: {tmp_path / 'nowhere'}"
    with fringedic.open_experiment(tmp_path / "desk" / "tiny.nc") as dataset:
        assert dataset.step.values.tolist() == [1, 2]
        assert set(dataset.reference_step.values.tolist()) == {2}


def test_replay_and_process_with_the_same_changes_give_the_same_arrays(
    recorded: RecordedExperiment, tmp_path: Path
) -> None:
    """One step, another reference, window and calibration: the results differ from the recorded ones in both."""
    bag = recorded.report.folder / "bag"
    model = RigModel.from_yaml(recorded.report.folder / "calibration.yaml")
    other = dataclasses.replace(model, camera_distance=1.01 * model.camera_distance)
    other.to_yaml(tmp_path / "other.yaml")
    changes = ("--step", 1, "--reference", 2, "--set", "dic.window=20", "--calibration", tmp_path / "other.yaml")
    processed = fringedic_command("process", bag, *changes, "--output", tmp_path / "desk.nc")
    assert processed.exit_code == 0, processed.exception
    replayed = fringedic_command("replay", bag, *changes, "--output", tmp_path / "again")
    assert replayed.exit_code == 0, replayed.exception
    assert "1 of 2: recorded step 2" in replayed.stdout
    assert "2 of 2: recorded step 1" in replayed.stdout
    assert "whole: 2 of 2 steps, 24 frames" in replayed.stdout

    replayed_bag = tmp_path / "again" / "bag"
    reader = BagReader(replayed_bag)
    [calibration] = [message for _, message, _ in reader.messages(reader.find("calibration").values())]
    assert calibration.identifier == RigModel.from_yaml(tmp_path / "other.yaml").identifier
    before, after = phases(bag), phases(replayed_bag)
    np.testing.assert_array_equal(before[[2, 1]], after, "the phase does not depend on any of these changes")
    with (
        fringedic.open_experiment(replayed_bag) as nodes,
        fringedic.open_experiment(tmp_path / "desk.nc") as desk,
        fringedic.open_experiment(bag) as former,
    ):
        for name in ("phase", "displacement_y", "shape_z", "u", "w", "reference_step"):
            assert np.array_equal(nodes[name].values, desk[name].values, equal_nan=True), name
        change = float(np.sqrt(np.nanmean((nodes.shape_z - former.shape_z).values ** 2)))
        assert np.isfinite(change)
        assert change > 1e-6, "the other calibration moves the surface"
    assert [status.window for status in dic_statuses(bag)] == [32, 32, 32]
    assert [status.window for status in dic_statuses(replayed_bag)] == [20, 20]


def dic_statuses(bag: Path) -> list[Any]:
    """Return the statuses of the dic node, one of each step."""
    reader = BagReader(bag)
    return [message for _, message, _ in reader.messages(reader.find("dic/status").values())]


def phases(bag: Path) -> np.ndarray:
    """Return the phase maps of a recording in the order of publishing, shape (step, row, column)."""
    reader = BagReader(bag)
    return np.stack([image_array(message) for _, message, _ in reader.messages(reader.find("phase/map").values())])


def test_replay_of_a_step_that_does_not_exist_is_refused(recorded: RecordedExperiment, tmp_path: Path) -> None:
    words = ("replay", recorded.report.folder / "bag", "--reference", 7, "--output", tmp_path / "x")
    refused = fringedic_command(*words)
    assert isinstance(refused.exception, ConfigurationError)
    assert "has no step 7; it has 0, 1, 2" in str(refused.exception)
    assert not (tmp_path / "x").exists(), "no node was started"


class Running:
    """A run of the command in a process of its own, whose steps take seconds and are only recorded.

    Parameters
    ----------
    tiny
        The rig file.
    folder
        Where everything is written.
    words
        Further words of the command.
    terminal
        Whether it runs in a terminal, which is then the process.
    """

    NODES = ("recorder", "load_frame", "camera", "experiment")

    def __init__(self, tiny: Path, folder: Path, *words: str, terminal: bool = False) -> None:
        self.bag = folder / "run" / "bag"
        self._run, self._output = folder / "run", folder / "output"
        content = yaml.safe_load(tiny.read_text()) | {"recording": {"process": False}}
        content["programme"]["ramp"]["hold_s"] = 3.0
        (folder / "rig.yaml").write_text(yaml.safe_dump(content))
        program = "from fringedic.command.main import main; main()"
        command = [sys.executable, "-u", "-c", program, "run", str(folder / "rig.yaml"), "--output", str(self._run)]
        command += words
        if terminal:
            command = [sys.executable, "-c", "import pty, sys; pty.spawn(sys.argv[1:])", *command]
        environment = {**os.environ, "COLUMNS": "200"}  # no line is wrapped
        with self._output.open("w") as output:
            self.process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, env=environment
            )

    def wait_until_printed(self, words: str) -> None:
        """Wait until the command has printed these words."""

        def printed() -> bool:
            assert self.process.poll() is None, self._output.read_text()
            return words in self._output.read_text()

        wait_until(printed, words, timeout_s=300.0)

    def printed(self) -> str:
        """Return everything that the command has printed."""
        return self._output.read_text()

    def pids(self) -> list[int]:
        """Return the processes of some nodes."""
        running = node_pids(self._run)
        return [running[name] for name in self.NODES]


@pytest.fixture
def start_run(tiny: Path, tmp_path: Path) -> Iterator[Callable[..., Running]]:
    """A function that starts a run, which ends with the test."""
    runs: list[Running] = []

    def start(*words: str, terminal: bool = False) -> Running:
        runs.append(Running(tiny, tmp_path, *words, terminal=terminal))
        return runs[-1]

    yield start
    for each in runs:
        each.process.kill()
        each.process.wait()


def test_a_rig_has_one_owner_whose_interruption_closes_recording_and_nodes(
    start_run: Callable[..., Running], tiny: Path, tmp_path: Path
) -> None:
    running = start_run()
    running.wait_until_printed("step 1 (last: 2)")
    pids = running.pids()
    second = fringedic_command("run", tiny, "--output", tmp_path / "second")
    assert isinstance(second.exception, ProcessError)
    words = rf"is in use by process {running.process.pid} \(.*run.*\) since 20.*, folder {tmp_path / 'run'}; wait"
    assert re.search(words, str(second.exception)), second.exception
    assert running.process.poll() is None
    running.process.send_signal(signal.SIGINT)
    assert running.process.wait(300) == 130, "it writes dataset and report before it ends"
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
    assert not BagReader(running.bag).lost
    assert "--continue" in running.printed()
    with fringedic.open_experiment(running.bag.parent) as dataset:
        before = np.count_nonzero(dataset.error.values == "")
    assert 1 <= before < 3
    assert [entry.details["interrupted"] for entry in read_log(running.bag.parent).entries] == [True]
    continued = start_run("--continue")
    continued.wait_until_printed("(last: 2): move")
    os.kill(node_pids(running.bag.parent)["recorder"], signal.SIGKILL)
    assert continued.process.wait(300) == 0, continued.printed()
    assert f"{before} steps are measured already" in continued.printed()
    assert f": {3 - before} step" in continued.printed(), "the forecast is that of the steps that are left"
    assert sorted(part.name for part in running.bag.with_name("parts").iterdir()) == ["bag-1", "bag-2", "bag-3"]
    with fringedic.open_experiment(running.bag.parent) as dataset:
        measured = dataset.step.values[dataset.error.values == ""]
        assert len(measured) == 3
        assert set(dataset.reference_step.sel(step=measured).values.tolist()) == {0}, "the recording decides it"
        position = dataset.position.sel(step=measured).values
    assert position == pytest.approx([0.0, 0.3e-3, 0.6e-3], abs=1e-6)
    reader = BagReader(running.bag)
    announced = [message for _, message, _ in reader.messages(reader.find("experiment/reference").values())]
    assert {(each.step > 0, each.previous_lost) for each in announced} == {(False, False), (True, True)}
    log = read_log(running.bag.parent)
    assert [(entry.action, entry.details["interrupted"]) for entry in log.entries] == [
        ("run", True),
        ("run continued", False),
    ]
    parts = {part.name: part for part in audit_run(running.bag.parent, keys=log.keys).parts}
    assert {parts[name].result for name in ("signature", "log", "files", "results results.nc")} == {"holds"}
    assert "36 of 36 frames, 0 lost" in parts["raw data"].found, "load samples are missing while there is no recorder"
    again = fringedic_command("run", tmp_path / "rig.yaml", "--output", running.bag.parent, "--continue")
    assert "no step of the programme is left, 3 of 3 are measured" in str(again.exception)


def test_the_end_of_a_session_ends_a_run_as_ctrl_c_does(start_run: Callable[..., Running]) -> None:
    running = start_run()
    running.wait_until_printed("step 1 (last: 2)")
    pids = running.pids()
    for number in (signal.SIGTERM, signal.SIGHUP):
        running.process.send_signal(number)
    assert running.process.wait(300) == 130, running.printed()
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
    assert "a hold was requested" in running.printed()
    assert_measured_before_the_end(running)


def test_a_closed_terminal_ends_a_run_as_ctrl_c_does(start_run: Callable[..., Running]) -> None:
    running = start_run(terminal=True)
    running.wait_until_printed("step 1 (last: 2)")
    terminal, pids = running.process.pid, running.pids()
    (command,) = Path(f"/proc/{terminal}/task/{terminal}/children").read_text().split()
    running.process.kill()
    running.process.wait()
    wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in (command, *pids)), "the end of the command")
    assert_measured_before_the_end(running)


def assert_measured_before_the_end(running: Running) -> None:
    """Check that recording, dataset and report contain the steps before an interruption."""
    assert not BagReader(running.bag).lost
    assert (running.bag.parent / "report.html").exists()
    with fringedic.open_experiment(running.bag.parent) as dataset:
        assert 1 <= np.count_nonzero(dataset.error.values == "") < 3


def test_a_second_ctrl_c_closes_the_recording_nevertheless(start_run: Callable[..., Running]) -> None:
    running = start_run()
    running.wait_until_printed("step 1 (last: 2)")
    pids = running.pids()
    running.process.send_signal(signal.SIGINT)
    running.wait_until_printed("closing the recording")
    running.process.send_signal(signal.SIGINT)
    assert running.process.wait(300) == 130, running.printed()
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
    assert "a hold was requested" in running.printed()
    assert "writing dataset" not in running.printed()
    assert not BagReader(running.bag).lost


def test_nodes_end_with_a_killed_command(start_run: Callable[..., Running]) -> None:
    running = start_run()
    running.wait_until_printed("step 0 (last: 2)")
    pids = running.pids()
    os.kill(running.process.pid, signal.SIGKILL)
    running.process.wait()
    wait_until(lambda: not any(Path(f"/proc/{pid}").exists() for pid in pids), "the end of the nodes")
    assert not BagReader(running.bag).lost
