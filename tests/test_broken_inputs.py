"""Broken inputs and dying nodes: the run fails with an explicit error, and nothing is left behind."""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import threading
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from rewritten import copy_topics
from running_system import CONFIG, WORKING, Progress

import fringedic
from fringedic.command.outcome import RunReport
from fringedic.errors import NodeDiedError, RecordingError
from fringedic.frames.region import Region
from fringedic.recording.reader import BagReader
from fringedic.recording.repair import recover
from fringedic_bringup.client import RigClient
from fringedic_bringup.launch.graph import Graph, NodeEntry
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.procedures.replay import replay
from fringedic_bringup.procedures.run import load_rig, run_experiment
from fringedic_ros.testing import node_pids


def test_a_node_that_dies_ends_the_wait_with_its_log(tmp_path: Path) -> None:
    graph = Graph("rig", (NodeEntry("dic", "dic_node", "dic"),))
    with RunningGraph(graph, tmp_path / "logs") as running, RigClient("rig", watch=running.check) as client:
        client.wait_until_ready(graph.names)
        os.kill(running.pid("dic"), signal.SIGKILL)
        with pytest.raises(NodeDiedError, match=r"dic was ended by SIGKILL[\s\S]*dic\.log"):
            client.measure()


def test_unreadable_image_fails_one_step(tmp_path: Path) -> None:
    """Of five files one is not an image: its step fails with the name of the file, the others are measured."""
    images = tmp_path / "images"
    images.mkdir()
    generator = np.random.default_rng(7)
    speckle = cv2.GaussianBlur(generator.normal(128, 120, (140, 180)), (0, 0), 1.5)
    for number in range(5):
        view = np.clip(speckle[5:125, number : 160 + number], 0, 255)
        cv2.imwrite(str(images / f"load_{number}.png"), view.astype(np.uint8))
    (images / "load_2.png").write_bytes(b"not an image")
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump({"camera": {"source": "files", "files": "images"}}))
    rig_file, programme = load_rig(path, None, None)
    report = run_experiment(rig_file, path, programme, tmp_path / "run", Progress())
    errors = [step.error for step in report.steps]
    assert "load_2.png" in errors[2]
    assert not any(errors[:2] + errors[3:])
    with fringedic.open_experiment(report.folder / "bag") as dataset:
        # the window moves right over the pattern, so the pattern moves left by one pixel per image
        moved = dataset.displacement_x.sel(step=4).median().item()
    assert moved == pytest.approx(-4.0, abs=0.01)


def test_what_is_measured_after_a_test_is_measured_with_the_settings_of_the_rig_file(tmp_path: Path) -> None:
    """No node that has them runs during the test: the recording had the defaults."""
    part = Region.rectangle((40, 30), (120, 90))
    Region(part.polygons, 160, 120).save(tmp_path / "part.png")
    path = tmp_path / "rig.yaml"
    settings = {"recording": {"process": False}, "nodes": {"dic": {"window": 24, "spacing": 2}}}
    tiny = yaml.safe_load((CONFIG / "tiny.yaml").read_text())
    path.write_text(yaml.safe_dump(tiny | settings | {"region_file": "part.yaml"}))
    rig_file, programme = load_rig(path, None, None)
    report = run_experiment(rig_file, path, programme, tmp_path / "run", Progress())
    assert not any(step.error for step in report.steps)
    again = fringedic.process_bag(report.folder / "bag", output=tmp_path / "again.nc")
    for dataset in map(fringedic.open_experiment, (report.folder, again)):
        with dataset:
            [entry] = json.loads(dataset.parameters)
            assert (entry["parameters"]["dic"]["window"], entry["parameters"]["dic"]["spacing"]) == (24, 2)
            assert np.isnan(dataset.z.sel(row=slice(0, 28))).all(), "outside the region"
            assert np.isfinite(dataset.z.sel(row=60, column=80)).all()


def test_recording_without_frames_is_refused(experiment: RunReport, tmp_path: Path) -> None:
    target = copy_topics(experiment.folder / "bag", tmp_path / "bag", only=["experiment/step"])
    with pytest.raises(RecordingError, match="camera/image_raw"):
        fringedic.process_bag(target)
    with pytest.raises(RecordingError, match="camera/image_raw"):
        replay(target, tmp_path / "replayed", Progress())


def test_replay_without_a_known_reference_is_refused(experiment: RunReport, tmp_path: Path) -> None:
    bag = experiment.folder / "bag"
    target = copy_topics(bag, tmp_path / "bag", without=["experiment/reference"])
    with pytest.raises(RecordingError, match=r"which step is the reference .* is not recorded .* --reference STEP"):
        replay(target, tmp_path / "replayed", Progress())


def test_a_replay_whose_recorder_stops_does_not_succeed(experiment: RunReport, tmp_path: Path) -> None:
    """Its summary named all steps as whole, although the new recording ended in the middle."""
    stopping = threading.Event()

    def fill_disk() -> None:
        while not stopping.wait(0.05):
            pid = node_pids(tmp_path).get("recorder")
            if pid is not None:
                with suppress(ProcessLookupError):  # it has just ended
                    resource.prlimit(pid, resource.RLIMIT_FSIZE, (100_000, 100_000))

    disk = threading.Thread(target=fill_disk)
    disk.start()
    try:
        with pytest.raises(RecordingError, match="the recorder stopped: "):
            replay(experiment.folder / "bag", tmp_path, Progress())
    finally:
        stopping.set()
        disk.join()


def test_truncated_recording(experiment: RunReport, tmp_path: Path) -> None:
    """The reader reports the damage, and the steps before the end of the file can be measured."""
    bag = tmp_path / "bag"
    shutil.copytree(experiment.folder / "bag", bag)
    [file] = bag.glob("*.mcap")
    with file.open("r+b") as stream:
        stream.truncate(file.stat().st_size * 6 // 10)
    assert BagReader(bag).lost
    whole = recover(bag, tmp_path / "recovered").path
    with fringedic.open_experiment(fringedic.process_bag(whole, output=tmp_path / "cut.nc")) as dataset:
        assert np.isfinite(dataset.u.sel(step=0).values).mean() > WORKING
        assert dataset.sizes["step"] < 3 or str(dataset.error.values[-1])
    assert replay(whole, tmp_path / "replayed", Progress()).exists()


def test_text_file_instead_of_a_recording(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "bag_0.mcap").write_text("no recording")
    with pytest.raises(RecordingError, match=r"bag_0\.mcap"):
        fringedic.process_bag(tmp_path / "bag")


def test_command_refuses_an_unknown_key_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text("camera: {source: virtual}\nprojektor: {}\n")
    done = subprocess.run(
        ["fringedic", "run", str(tmp_path / "rig.yaml")], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 1
    [sentence] = done.stderr.strip().splitlines()
    assert "rig.yaml" in sentence
    assert "projektor: unknown key" in sentence
