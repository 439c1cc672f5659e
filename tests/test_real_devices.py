"""The same ten steps on the virtual rig and on devices with their real protocols: camera, display and machine."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
import yaml
from running_system import MACHINE, WORKING, Killer, ModbusServer, Progress

from camera_node.testing import FakeCamera
from fringe_projector_node.testing import VirtualDisplay
from fringedic.command.outcome import RunReport
from fringedic.frames.records import stamp_of
from fringedic.recording.frames import records
from fringedic.recording.reader import BagReader
from fringedic.rig.model import RigModel
from fringedic.virtual_rig import VirtualRig
from fringedic_bringup.procedures.replay import replay
from fringedic_bringup.procedures.run import load_rig, run_experiment

RIGS = Path(__file__).parent / "rigs"
PULLED = 0.02  # [mm/s]
STEPS, FRAMES = 10, 8 * 12 + 2
# 0; .1 to .4; .5 and back until 400 N, twice; 0. The machine is 2000 N/mm stiff, and relaxes.
POSITIONS = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, None, 0.5, None, 0.0]  # [mm]; None: where the force ended the move


def run(name: str, folder: Path, progress: Progress) -> RunReport:
    rig, programme = load_rig(folder / f"{name}.yaml", folder / "ten_steps.yaml", None)
    return run_experiment(rig, folder / f"{name}.yaml", programme, folder / "run", progress)


def check_drive(report: RunReport) -> None:
    """Check what is the same on every rig: ten steps at their positions, and all their frames recorded."""
    assert [step.error for step in report.steps] == [""] * STEPS
    assert all(step.missing == 0 for step in report.steps)
    for step, position in zip(report.steps, POSITIONS, strict=True):
        if position is not None:
            assert step.position == pytest.approx(1e-3 * position, abs=2e-8)
        else:
            assert 0.1e-3 < step.position < 0.25e-3
            assert 200 < step.force < 420
    recorded = BagReader(report.folder / "bag")
    names = recorded.find("camera/image_raw", "camera/exposure", "load_frame/state")
    whole = {step.step for step in report.steps}
    exposures = [each for _, each, _ in recorded.messages([names["camera/exposure"]]) if each.step in whole]
    images = {str(each.header.stamp) for _, each, _ in recorded.messages([names["camera/image_raw"]])}
    assert len(exposures) == FRAMES
    assert {str(each.header.stamp) for each in exposures} <= images
    assert recorded.counts[names["load_frame/state"]] > FRAMES


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copytree(RIGS, tmp_path / "rigs")
    return tmp_path / "rigs"


@pytest.mark.slow
def test_ten_steps_on_the_virtual_rig(folder: Path) -> None:
    report = run("virtual", folder, Progress())
    check_drive(report)
    assert all(step.dropped == 0 for step in report.steps)
    assert all(step.valid_fraction > WORKING for step in report.steps)


@contextmanager
def devices(folder: Path) -> Iterator[ModbusServer]:
    """Start camera, display and machine, and write the machine file beside the rig files."""
    (folder / "screen").mkdir()
    with (
        FakeCamera(),
        VirtualDisplay(folder / "screen", 640, 480) as display,
        ModbusServer() as machine,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setenv("DISPLAY", display.name)
        (folder / "machine.yaml").write_text(yaml.safe_dump({**MACHINE, "port": machine.port}))
        yield machine


@pytest.mark.slow
@pytest.mark.hardware
def test_ten_steps_on_devices_and_a_killed_camera_node(folder: Path, tmp_path: Path) -> None:
    """The fake camera does not see the display, which the report states for every step.

    A frame whose packets a busy computer loses counts as dropped and is taken again, so that every step is complete.
    """
    with devices(folder):
        progress = Killer(folder / "run", {4: "camera"})
        report = run("devices", folder, progress)
    check_drive(report)
    assert any("camera was ended by SIGKILL" in line and "started again" in line for line in progress.lines)
    recorded = BagReader(report.folder / "bag")
    names = recorded.find("camera/exposure", "camera/image_raw")
    shown = [each.pitch for _, each, _ in recorded.messages([names["camera/exposure"]]) if each.step == 0]
    assert shown == [640.0] * 4 + [128.0] * 4 + [16.0] * 4
    sizes = {(each.width, each.height) for _, each, _ in recorded.messages([names["camera/image_raw"]])}
    assert sizes == {(320, 240)}
    assert "no step could be measured" in report.unmeasured
    assert "patt" in report.unmeasured
    assert all(np.isfinite(step.force) and np.isfinite(step.position) for step in report.steps)
    optics = VirtualRig.from_preset("plate", size="small").optics()
    model = RigModel(**optics | {"projector_width": 640, "projector_height": 480}, identifier="of another rig")
    model.to_yaml(tmp_path / "rig_model.yaml")
    again = BagReader(
        replay(report.folder / "bag", tmp_path / "again", Progress(), calibration=tmp_path / "rig_model.yaml")
    )
    counts = {name.removeprefix("/rig/"): count for name, count in again.counts.items()}
    assert counts["camera/image_raw"] == recorded.counts[names["camera/image_raw"]]
    assert counts["phase/status"] >= STEPS


@pytest.mark.slow
@pytest.mark.hardware
def test_stacks_follow_each_other_on_devices_while_the_machine_moves(folder: Path) -> None:
    """Every frame over GigE Vision is recorded with what was projected; the crosshead passes on without a hold."""
    (folder / "pull.yaml").write_text(f"{{experiment: pull, continuous: {{to_mm: 0.4, speed_mm_per_s: {PULLED}}}}}")
    rig, programme = load_rig(folder / "devices.yaml", folder / "pull.yaml", None)
    with devices(folder):
        report = run_experiment(rig, folder / "devices.yaml", programme, folder / "run", Progress())
    assert [step.error for step in report.steps] == [""] * len(report.steps)
    assert all(step.missing == 0 for step in report.steps)
    recorded = BagReader(report.folder / "bag")
    names = recorded.find("camera/image_raw", "camera/exposure", "load_frame/state")
    images = {stamp_of(each) for _, each, _ in recorded.messages([names["camera/image_raw"]])}
    states = [each for _, each, _ in recorded.messages([names["load_frame/state"]])]
    stamps, positions = [stamp_of(each) for each in states], [each.position for each in states]
    stacks = [[*frames] for _, frames in groupby(records(recorded), key=lambda each: each.step_key)]
    pulled = stacks[1:]
    assert len(pulled) >= 3, "many more on a computer without other work"
    for stack in pulled:
        assert [each.pattern for each in stack] == rig.moving_patterns(), "none lost, none twice"
        assert {each.stamp for each in stack} <= images
    ends = np.array([(stack[0].stamp, stack[-1].stamp) for stack in pulled[:-1]])  # in the last one the move ends
    assert (np.diff(ends.ravel()) > 0).all()
    seconds, passed = 1e-9 * np.diff(ends), np.diff(np.interp(ends, stamps, positions))
    np.testing.assert_allclose(passed, 1e-3 * PULLED * seconds, atol=2e-6, err_msg="the machine moves all the time")
