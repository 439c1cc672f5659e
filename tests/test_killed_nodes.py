"""A killed node does not end a test: the command starts it again, and all planned steps are measured."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from running_system import CONFIG, WORKING, Killer

import fringedic
from fringedic.configuration.programme import Programme
from fringedic.evaluation.truth import open_truth
from fringedic.recording.reader import BagReader
from fringedic.recording.verification import verify
from fringedic_bringup.procedures.run import load_rig, run_experiment

PROGRAMME = {
    "experiment": "killed",
    "steps": [
        {"position_mm": position, "speed_mm_per_s": 5.0, "set_reference": position == 0.2}
        for position in (0.0, 0.2, 0.4, 0.6)
    ],
}
VICTIMS = ("experiment", "recorder", "dic")  # nodes with a state in memory
EARLY = ("projector", "recorder", "experiment")  # killed before the first step


@pytest.mark.slow
def test_the_test_goes_on_whichever_node_is_killed(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    path = tmp_path / "left.yaml"
    path.write_text("sensor: left\n" + (CONFIG / "tiny.yaml").read_text())  # nodes that start again have the name, too
    rig, _ = load_rig(path, None, None)
    progress = Killer(folder, dict(enumerate(VICTIMS, start=2)), EARLY)
    programme = Programme.model_validate(PROGRAMME)
    report = run_experiment(rig, path, programme, folder, progress)
    assert [step.error for step in report.steps] == [""] * 4, progress.lines
    positions = np.array([step.position for step in report.steps])
    assert positions == pytest.approx(np.linspace(0, 0.6e-3, 4), abs=1e-8)
    for name in EARLY:
        log = folder / "logs" / f"{name}.log"
        assert f"{name} was ended by SIGKILL (see {log}); it is started again" in progress.lines, progress.lines
    for name in VICTIMS:
        assert any(f"{name} was ended by SIGKILL" in line and "started again" in line for line in progress.lines), name

    numbers = [step.step for step in report.steps]
    assert numbers == sorted(set(numbers)), "numbers are not used twice"
    assert numbers[-1] > 4, "interrupted steps have a number"
    reader = BagReader(folder / "bag")
    assert not reader.lost
    assert {topic for topic in reader.counts if not topic.startswith("/rig/left/")} == set()
    assert reader.sensors == {"left": "/rig/left/"}
    assert (folder / "calibration.left.yaml").exists()
    with AnyReader([folder / "bag"]) as other:
        assert len({each.topic for each in other.connections}) == len(other.connections), "one channel per topic"
        assert sum(1 for _ in other.messages()) == sum(reader.counts.values())
    verification = verify(folder / "bag")
    assert not verification.damage
    assert not {(programme.experiment, number) for number in numbers} & verification.unfinished_steps.keys()
    assert sorted(part.name for part in (folder / "parts").iterdir()) == ["bag-1", "bag-2"]
    assert all(step.missing == step.dropped == 0 for step in report.steps)
    assert report.dataset == "results.left.nc"
    with fringedic.open_experiment(folder) as dataset:
        assert (dataset.attrs["sensor"], json.loads(dataset.attrs["calibration"])["sensor"]) == ("left", "left")
        measured = dataset.sel(step=numbers)
        references = [numbers[0], *[numbers[1]] * 3]
        assert measured.reference_step.values.tolist() == references, "those of the programme, although dic lost them"
        assert (np.isfinite(measured.w).mean(("row", "column")) > WORKING).all()
        assert report.steps[0].errors["v"] < 12
        assert all(math.isnan(step.errors["v"]) for step in report.steps[2:]), "the truth counts from the first step"
        truth = open_truth(folder).sel(row=dataset.row, column=dataset.column).v.values
        moved = truth[numbers] - truth[references]  # all points move alike
        errors = (measured.v.values - moved)[:, np.isfinite(moved).all(0)]
        assert np.sqrt(np.nanmean(errors**2, axis=1)).max() < 12e-6
