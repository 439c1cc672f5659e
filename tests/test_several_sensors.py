"""A test of two sensors: one load frame, one recording, results of each sensor, and the joined surface of both."""

from __future__ import annotations

import os
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest
from running_system import Progress
from sensor_scene import recorded_balls

from fringedic.audit.parts import Result
from fringedic.audit.run import audit_run
from fringedic.configuration.programme import Programme
from fringedic.configuration.rig_sensors import load_rig_sensors
from fringedic.datasets import open_experiment, process_bag
from fringedic.errors import ConfigurationError
from fringedic.frames.records import frame_record
from fringedic.patterns.pattern import PatternKind
from fringedic.recording.programme_end import programme_end
from fringedic.recording.reader import BagReader
from fringedic.recording.verification import verify
from fringedic.sensors.files import save_registration
from fringedic.sensors.recorded import Balls, register_recording
from fringedic_bringup.launch.environment import private_domain
from fringedic_bringup.procedures.continuing import recorded_steps
from fringedic_bringup.procedures.run_sensors import SensorsReport, load_sensors, run_sensors
from fringedic_ros.testing import node_pids

SENSORS = ("left", "right")
FAILED, LAST = 1, 2  # steps: of the killed camera, and after it
FURTHER, FURTHER_MM = 3, 0.45  # step of a later command, and its position
RIG = """
camera: {source: virtual, exposure_ms: 10.0}
projector: {source: virtual}
sequence: {pitches_px: [100.0, 20.0, 5.0], shifts: 4}
load_frame: {source: simulated}
registration: registration.yaml
sensors:
  left:
    virtual_rig: {arrangement: plate, place: left, size: tiny}
    calibration: left.yaml
  right:
    virtual_rig: {arrangement: plate, place: right, size: tiny}
    calibration: right.yaml
    nodes: {composed: true}
programme:
  experiment: two
  steps:
    - {position_mm: 0.0, speed_mm_per_s: 5.0}
    - {position_mm: 0.15, speed_mm_per_s: 5.0}
    - {position_mm: 0.3, speed_mm_per_s: 5.0}
"""


class KillsCamera(Progress):
    """Kills a camera when its sensor begins a step."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder, self._killed = folder, False

    def step(self, number: int, last: int, text: str, frame: int = 0, frames: int = 0) -> None:
        super().step(number, last, text, frame, frames)
        if number == FAILED and text.startswith("left: ") and not self._killed:
            self._killed = True
            os.kill(node_pids(self._folder)["left/camera"], signal.SIGKILL)


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> tuple[SensorsReport, Path, list[str]]:
    """Run three steps; the camera of one sensor is killed in the second."""
    folder = tmp_path_factory.mktemp("two")
    _, models, balls = recorded_balls(folder / "balls" / "bag")
    for name, model in models.items():
        model.to_yaml(folder / f"{name}.yaml")
    save_registration(register_recording(balls, balls=Balls(15e-3)), folder / "registration.yaml")
    path = folder / "two.yaml"
    path.write_text(RIG)
    sensors, programme = load_sensors(load_rig_sensors(path), path, None)
    progress = KillsCamera(folder / "run")
    with private_domain() as domain:
        report = run_sensors(sensors, path, programme, folder / "run", progress, domain=domain)
    return report, folder / "run", progress.lines


@pytest.mark.slow
def test_a_sensor_that_fails_fails_its_own_part(ended: tuple[SensorsReport, Path, list[str]]) -> None:
    report, folder, lines = ended
    left, right = report.reports
    assert [step.step for step in left.steps] == [step.step for step in right.steps] == [0, 1, 2], lines
    assert [bool(step.error) for step in left.steps] == [False, True, False], lines
    log = folder / "logs" / "left" / "camera.log"
    assert left.steps[FAILED].error == f"left/camera was ended by SIGKILL (see {log})"
    assert [step.error for step in right.steps] == [""] * 3, lines
    assert any(line.startswith(f"step {FAILED}, sensor left: left/camera was ended by SIGKILL") for line in lines)
    assert left.failed
    assert not right.failed
    assert "fringedic" in (folder / "report.html").read_text("utf-8")
    assert any(f"Step {FAILED} was measured without the sensor 'left'" in words for words in report.words), report.words


@pytest.mark.slow
def test_one_recording_contains_both_sensors_whose_light_is_apart(
    ended: tuple[SensorsReport, Path, list[str]],
) -> None:
    _, folder, _ = ended
    bag = folder / "bag"
    reader = BagReader(bag)
    assert reader.sensors == {"left": "/rig/left/", "right": "/rig/right/"}
    assert {"/rig/load_frame/state", "/rig/programme/status"} <= reader.counts.keys()
    assert not any(name.startswith(("/rig/left/load_frame", "/rig/right/load_frame")) for name in reader.counts)
    checked = verify(bag)
    assert checked.complete, checked
    end = programme_end(bag, "left")
    assert end is not None
    intervals = {}
    for sensor, beginning in reader.sensors.items():
        records = [frame_record(each) for _, each, _ in reader.messages([f"{beginning}camera/exposure"])]
        assert {each.sensor for each in records} == {sensor}
        assert PatternKind.FRINGES in {each.pattern.kind for each in records}
        for each in records:
            first, last = intervals.get((each.step, sensor), (each.stamp, each.stamp))
            intervals[each.step, sensor] = min(first, each.stamp), max(last, each.stamp)
    for step in (0, LAST):
        assert intervals[step, "left"][1] < intervals[step, "right"][0], "one after the other"


@pytest.mark.slow
def test_the_joined_surface_is_that_of_the_specimen(ended: tuple[SensorsReport, Path, list[str]]) -> None:
    report, folder, _ = ended
    assert report.joined == folder / "bag.joined.nc", report.words
    with open_experiment(folder) as joined:
        assert joined.attrs["sensor"] == "joined"
        assert joined.step.values.tolist() == [0, 1, 2]
        step = joined.sel(step=LAST)
        for name in ("u", "v", "w"):
            assert 0.7 < np.sqrt(np.nanmean(step[f"overlap_{name}"].values ** 2)) < 1.4, name
        strain = float(step.position) / 80e-3
        error = step["e_22"].values - (strain + strain**2 / 2)
        several = step["sensors"].values
        assert abs(np.nanmean(error[several == 1])) < 50e-6
        assert abs(np.nanmean(error[several == 2])) < 50e-6


@pytest.mark.slow
def test_the_results_of_the_nodes_are_those_of_the_desk(
    ended: tuple[SensorsReport, Path, list[str]], tmp_path: Path
) -> None:
    """Of the sensor whose nodes ran all the time; a replay gives them to new nodes in the same way."""
    _, folder, _ = ended
    desk = process_bag(folder / "bag", sensor="right", output=tmp_path / "desk.nc")
    with open_experiment(folder, sensor="right") as live, open_experiment(desk) as again:
        assert live.attrs["source"] == "bag"
        assert float(live.sel(step=LAST).force) > 100.0
        for name in ("x", "y", "z", "u", "v", "w", "sigma_u", "sigma_w", "e_11", "force", "position"):
            np.testing.assert_array_equal(again[name].values, live[name].values, err_msg=name)


@pytest.mark.slow
def test_the_run_is_audited_with_the_calibrations_of_both(ended: tuple[SensorsReport, Path, list[str]]) -> None:
    _, folder, _ = ended
    parts = audit_run(folder).parts
    assert not [part for part in parts if part.result is Result.FAILS], parts
    (joined,) = (part for part in parts if part.name == "results bag.joined.nc")
    assert joined.result is Result.HOLDS, joined
    assert "from the results of its sensors and registration.yaml, equal bit by bit" in joined.found
    equal = [part.found for part in parts if part.name == "calibration"]
    assert [Path(words.rpartition(" ")[2]).stem for words in equal] == list(SENSORS)


@pytest.mark.slow
def test_a_later_command_goes_on_with_the_run(ended: tuple[SensorsReport, Path, list[str]], tmp_path: Path) -> None:
    """The displacements of both sensors count from the first step, as those of the steps before."""
    _, folder, _ = ended
    copy = tmp_path / "two"
    shutil.copytree(folder.parent, copy, ignore=shutil.ignore_patterns("balls"))
    path, bag = copy / "two.yaml", copy / "run" / "bag"
    path.write_text(f"{RIG}    - {{position_mm: {FURTHER_MM}, speed_mm_per_s: 5.0}}\n")
    sensors, programme = load_sensors(load_rig_sensors(path), path, None)
    progress = Progress()
    with private_domain() as domain:
        report = run_sensors(sensors, path, programme, copy / "run", progress, domain=domain, resume=True)
    assert "two: 3 steps are measured already" in progress.lines
    for of_sensor in report.reports:
        assert [(step.step, step.error) for step in of_sensor.steps] == [(FURTHER, "")], progress.lines
    assert verify(bag).complete
    for sensor, steps in (("left", [0, LAST, FURTHER]), ("right", [0, FAILED, LAST, FURTHER])):
        with open_experiment(copy / "run", sensor=sensor) as dataset:
            assert dataset.step[dataset.error == ""].values.tolist() == steps
            assert set(dataset.sel(step=steps).reference_step.values.tolist()) == {0}  # a failed step has none
            travel = dataset.position.sel(step=FURTHER) - dataset.position.sel(step=LAST)
            assert float(travel) == pytest.approx(1e-3 * (FURTHER_MM - 0.3), rel=0.01)
    assert report.joined is not None, report.words
    with open_experiment(report.joined) as joined:
        step = joined.sel(step=FURTHER)
        strain = float(step.position) / 80e-3
        assert abs(float(step["e_22"].mean()) - (strain + strain**2 / 2)) < 50e-6
    assert not [part for part in audit_run(copy / "run", recompute=False).parts if part.result is Result.FAILS]


def test_other_sensors_do_not_go_on_with_a_run(ended: tuple[SensorsReport, Path, list[str]]) -> None:
    _, folder, _ = ended
    programme = Programme.model_validate({"steps": [{"position_mm": 0.0}] * 5, "experiment": "two"})
    for namespaces, problem in (
        ({"left": "rig/left", "top": "rig/top"}, "measured by the sensors left, right, and the rig has left, top"),
        ({"left": "rig/left", "right": "other/right"}, "the namespace of the rig is 'other/right'"),
    ):
        with pytest.raises(ConfigurationError, match=problem):
            recorded_steps(folder / "bag", programme, namespaces)
