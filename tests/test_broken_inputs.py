"""Broken inputs and dying nodes: the run fails with words, and nothing is left behind."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest
import yaml
from running_system import WORKING, Told

import fringedic
from fringedic.errors import MissingTopicError, NodeDiedError, RecordingError
from fringedic.recording import BagReader, BagWriter, recover
from fringedic_bringup.client import RigClient
from fringedic_bringup.graph import rig_graph
from fringedic_bringup.processes import RunningGraph
from fringedic_bringup.replay import replay
from fringedic_bringup.report import RunReport
from fringedic_bringup.run import load_rig, run_experiment


def test_a_node_that_dies_fails_the_run_with_its_log(tiny: Path, tmp_path: Path) -> None:
    rig_file, _ = load_rig(tiny, None, None)
    graph = rig_graph(rig_file, tiny, tmp_path, experiment="dying")
    with (
        RunningGraph(graph, tmp_path / "logs") as running,
        RigClient(graph.namespace, watch=running.check) as client,
        pytest.raises(NodeDiedError, match=r"dic was ended by SIGKILL[\s\S]*dic\.log"),
    ):
        client.wait_until_ready(graph.names)
        os.kill(running.pid("dic"), signal.SIGKILL)
        client.measure()


def test_unreadable_image_fails_one_step(tmp_path: Path) -> None:
    """Of five images one is no image: its step fails with the file's name, the others are measured."""
    import cv2

    images = tmp_path / "images"
    images.mkdir()
    generator = np.random.default_rng(7)
    speckle = cv2.GaussianBlur(generator.normal(128, 120, (140, 180)), (0, 0), 1.5)
    for number in range(5):
        view = np.clip(speckle[5:125, number : 160 + number], 0, 255)
        cv2.imwrite(str(images / f"load_{number}.png"), view.astype(np.uint8))
    (images / "load_2.png").write_bytes(b"this is no image")
    path = tmp_path / "rig.yaml"
    path.write_text(yaml.safe_dump({"camera": {"source": "files", "files": "images"}}))
    rig_file, programme = load_rig(path, None, None)
    told = Told()
    report = run_experiment(rig_file, path, programme, tmp_path / "run", told)
    errors = [step.error for step in report.steps]
    assert "load_2.png" in errors[2]
    assert not any(errors[:2] + errors[3:])
    with fringedic.open_experiment(report.folder / "bag") as dataset:
        # the window moves right over the pattern, so the pattern moves left by one pixel per image
        moved = dataset.displacement_x.sel(step=4).median().item()
    print(f"moved by {moved:.4f} px, true -4")
    assert abs(moved + 4.0) < 0.01


def test_recording_without_frames_is_refused(experiment: RunReport, tmp_path: Path) -> None:
    reader = BagReader(experiment.folder / "bag")
    step = reader.find("experiment/step")["experiment/step"]
    target = tmp_path / "bag"
    writer = BagWriter(target)
    writer.add_recorded_topic(reader.topics[step])
    for message in reader.raw([step]):
        writer.write(message.topic, message.data, message.log_time, message.publish_time)
    writer.close()
    with pytest.raises(MissingTopicError, match="camera/image_raw"):
        fringedic.process_bag(target)
    with pytest.raises((MissingTopicError, NodeDiedError), match="camera/image_raw"):
        replay(target, tmp_path / "replayed", Told())


def test_truncated_recording(experiment: RunReport, tmp_path: Path) -> None:
    """Cut off in the middle: it says what is lost, and the steps before the cut can be measured."""
    bag = tmp_path / "bag"
    shutil.copytree(experiment.folder / "bag", bag)
    [file] = bag.glob("*.mcap")
    with file.open("r+b") as stream:
        stream.truncate(file.stat().st_size * 6 // 10)
    assert BagReader(bag).lost
    whole = recover(bag, tmp_path / "recovered")
    with fringedic.open_experiment(fringedic.process_bag(whole, output=tmp_path / "cut.nc")) as dataset:
        assert np.isfinite(dataset.u.sel(step=0).values).mean() > WORKING
        assert dataset.sizes["step"] < 3 or str(dataset.error.values[-1])
    assert replay(whole, tmp_path / "replayed", Told()).exists()


def test_text_file_instead_of_a_recording(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "bag_0.mcap").write_text("no recording")
    with pytest.raises(RecordingError, match=r"bag_0\.mcap"):
        fringedic.process_bag(tmp_path / "bag")


def test_command_says_what_is_wrong_in_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text("camera: {source: virtual}\nprojektor: {}\n")
    done = subprocess.run(
        ["fringedic", "run", str(tmp_path / "rig.yaml")], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 1
    [sentence] = done.stderr.strip().splitlines()
    assert "rig.yaml" in sentence and "projektor: unknown key" in sentence
