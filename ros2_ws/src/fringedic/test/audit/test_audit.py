"""The audit of a small run: what holds, what does not, and thirty random changes, all of which are found."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
import random
import shutil
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import xarray as xr
from typer.testing import CliRunner

from fringedic.audit import Result, audit_run, compare_bits
from fringedic.audit import results as audit_results
from fringedic.audit.run import Audit
from fringedic.audit.sentences import verdict_sentence
from fringedic.command.main import app
from fringedic.command.outcome import RunReport
from fringedic.command.run_results import sign_results
from fringedic.datasets import open_experiment, process_bag
from fringedic.evidence import begin_log, noted, read_log
from fringedic.evidence.keys import PUBLIC, key_folder, laboratory_key, raw_public
from fringedic.evidence.log import LOG
from fringedic.recording import BagReader, BagWriter
from fringedic.rig.model import RigModel

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"
BENCHMARK = Path(__file__).parents[5] / "benchmarks" / "audit_changes.py"
CHANGES = 30  # the long form is benchmarks/audit_changes.py
DETAILS = {"interrupted": False, "ended_early": "", "failed_steps": 0, "datasets": {"results.nc": {}}}


@pytest.fixture(scope="module")
def signed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A signed run of two steps, with a report that was written later."""
    folder = tmp_path_factory.mktemp("run")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CONFIG_HOME", str(folder / "configuration"))
        run, reader = folder / "plate-7", BagReader(RECORDED)
        with BagWriter(run / "bag") as writer:
            for topic in reader.topics.values():
                writer.add_recorded_topic(topic)
            for message in reader.stored():
                writer.write(*message)
        process_bag(run / "bag", output=run / "results.nc", steps=[1])
        begin_log(run, "run", details=DETAILS | {"datasets": {"results.nc": {"steps": [1]}}})
        yield run


@pytest.fixture(scope="module")
def changes() -> ModuleType:
    specification = importlib.util.spec_from_file_location("audit_changes", BENCHMARK)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.fixture
def run(signed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(signed.with_name("configuration")))
    return Path(shutil.copytree(signed, tmp_path / signed.name))


def results(run: Path) -> dict[str, Result]:
    return {part.name: part.result for part in audit_run(run).parts}


def test_every_part_of_a_whole_run_holds(run: Path, tmp_path: Path) -> None:
    public = key_folder() / PUBLIC
    page, figures = tmp_path / "audit.html", tmp_path / "audit.json"
    done = CliRunner().invoke(app, ["audit", str(run), "--key", str(public), "--output", str(page)])
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    assert (
        lines[-2]
        == "verdict: the files support the results; calibration: the run has none; displacements are in pixels"
    )
    assert "holds       results results.nc: computed again from the raw data, equal bit by bit" in done.stdout
    assert "The files support the results" in page.read_text()
    assert "ompliant" not in page.read_text()

    (run / "added.txt").write_text("by hand")
    done = CliRunner().invoke(app, ["audit", str(run), "--no-recompute", "--output", str(figures)])
    assert done.exit_code == 1
    found = json.loads(figures.read_text())
    assert not found["holds"]
    assert {part["name"]: part["result"] for part in found["parts"]}["files"] == "fails"
    assert "not in the log: added.txt" in done.stdout
    noted = CliRunner().invoke(app, ["note", str(run), "a remark of the operator", "--file", str(run / "added.txt")])
    assert noted.exit_code == 0, noted.output
    assert audit_run(run, recompute=False).parts[2].result is Result.HOLDS


def test_a_geometry_that_is_given_is_no_calibration(tmp_path: Path) -> None:
    model = RigModel.from_yaml(RECORDED.parent / "calibration" / "calibration.yaml")
    for source, result, meaning in (
        ("the rig file", Result.OPEN, "no measurement supports heights, displacements"),
        ("virtual_rig", Result.NOTE, "the virtual rig, whose images are simulated"),
    ):
        dataclasses.replace(model, source=source).to_yaml(tmp_path / "calibration.yaml")
        part, file = audit_results.check_calibration_file(tmp_path, [])
        assert (part.result, file) == (result, None)
        assert part.found.startswith("geometry given, not calibrated: ")
        assert meaning in part.found
        audit = Audit(tmp_path, datetime.now(UTC), (part,), ())
        assert audit.holds == (result is Result.NOTE)
        assert ("calibration: geometry given" in verdict_sentence(audit)) == audit.holds


def test_random_changes_are_found(run: Path, changes: ModuleType) -> None:
    keys = [raw_public(laboratory_key())]
    assert not changes.is_found(run, keys)
    counts = changes.try_changes(run, CHANGES, seed=1, keys=keys)
    assert sum(counts.values()) == CHANGES
    assert not {kind for kind, found in counts if not found}
    assert not changes.is_found(run, keys), "every change was undone"


def test_a_value_that_was_signed_with_the_key_is_found_by_computing_again(
    run: Path, changes: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = changes.change_a_value(run / "results.nc", random.Random(2))
    changes.sign_again(run)
    parts = {part.name: part for part in audit_run(run).parts}
    assert parts["files"].result is Result.HOLDS
    assert parts["results results.nc"].result is Result.FAILS
    assert f"differ: {name} in 1 of" in parts["results results.nc"].found
    here = audit_results.software_identity()
    monkeypatch.setattr(audit_results, "software_identity", lambda: {**here, "numpy": "1.0"})
    part = next(part for part in audit_run(run).parts if part.name == "results results.nc")
    assert part.result is Result.OPEN
    assert "with other software (numpy 1.0 instead of" in part.found


def test_a_run_without_a_log_is_not_signed(run: Path) -> None:
    (run / LOG).unlink()
    found = audit_run(run, recompute=False)
    assert not found.holds
    assert found.parts[0].result is Result.FAILS
    assert "killed before its end" in found.parts[0].found


def test_another_key_than_the_one_that_is_known_is_not_proven(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(run.with_name("nobody")))
    assert audit_run(run, recompute=False).parts[0].result is Result.OPEN
    laboratory_key()
    assert audit_run(run, recompute=False).parts[0].result is Result.OPEN
    assert audit_run(run, keys=[bytes(32)], recompute=False).parts[0].result is Result.FAILS


def test_processing_again_into_the_run_has_an_entry(run: Path) -> None:
    done = CliRunner().invoke(
        app, ["process", str(run), "--step", "1", "--set", "dic.window=24", "--why", "finer maps"]
    )
    assert done.exit_code == 0, done.output
    entry = read_log(run).entries[-1]
    assert (entry.action, entry.why, list(entry.files)) == ("process", "finer maps", ["bag.nc"])
    found = results(run)
    assert found["results bag.nc"] is Result.HOLDS, "the settings of the log are used"
    assert found["results results.nc"] is Result.HOLDS


def test_a_dataset_of_every_frame_stays_beside_that_of_the_steps(run: Path) -> None:
    """It has other steps (100 is step 1): it is not opened for the recording, and an audit repeats its settings."""
    for options, name in ((["--every-frame", "--step", "100"], "bag.every-frame.nc"), (["--step", "1"], "bag.nc")):
        done = CliRunner().invoke(app, ["process", str(run / "bag"), *options])
        assert done.exit_code == 0, done.output
        assert f"/{name}" in done.stdout.replace("\n", "")
    (run / "results.nc").unlink()
    with open_experiment(run / "bag") as steps, open_experiment(run / "bag.every-frame.nc") as frames:
        assert (steps.step.values.tolist(), frames.step.values.tolist()) == ([0, 1], [0, 100])
        np.testing.assert_array_equal(steps.w.sel(step=1), frames.w.sel(step=100))
    found = results(run)
    assert found["results bag.every-frame.nc"] is Result.HOLDS
    assert found["results bag.nc"] is Result.HOLDS


def test_an_interrupted_run_says_so(run: Path) -> None:
    for name in ("evidence.log", "evidence.log.sig"):
        (run / name).unlink()
    begin_log(run, "run", details=DETAILS | {"interrupted": True})
    [part] = [part for part in audit_run(run, recompute=False).parts if part.name == "end of the run"]
    assert (part.result, part.found) == (Result.NOTE, "interrupted by a person or a signal")


def test_a_continued_run_has_one_entry_with_its_end_and_the_settings_of_its_results(run: Path) -> None:
    """As `fringedic run --continue` does around the steps that it measures."""
    with noted(run, "run continued"):
        (run / "logs").mkdir()
        (run / "logs" / "camera.log").write_text("continued")
        process_bag(run / "bag", output=run / "results.nc", experiment="tiny", overwrite=True)
        report = RunReport("tiny", run, [], [], "results.nc", ended_early="a person stopped it")
        assert not sign_results(report)
    first, second = read_log(run).entries
    assert (first.action, second.action) == ("run", "run continued")
    assert {"logs/camera.log", "results.nc", "bag/bag_0.mcap"} <= second.files.keys()
    parts = {part.name: part for part in audit_run(run).parts}
    assert parts["end of the run"].found == "ended before its last step: a person stopped it"
    for name in ("signature", "log", "files", "results results.nc"):
        assert parts[name].result is Result.HOLDS, parts[name]


def test_every_bit_of_a_map_and_every_attribute_is_compared() -> None:
    maps = np.full((2, 3, 4), np.nan, np.float32)
    maps[1] = 1
    times = np.array(["2026-11-30T12:00", "NaT"], "datetime64[ns]")  # the second step was not measured
    one = xr.Dataset(
        {"w": (("step", "row", "column"), maps, {"units": "m"}), "time": ("step", times)}, attrs={"sensor": "left"}
    )
    assert not compare_bits(one, one.copy(deep=True))
    other = one.copy(deep=True)
    other.w[1, 0, 0] = np.nextafter(np.float32(1), np.float32(2))
    [difference] = compare_bits(one, other)
    assert (difference.name, difference.values, difference.of) == ("w", 1, 24)
    assert 1e-7 < difference.largest < 2e-7
    other = one.assign_attrs(sensor="right", software="another")
    assert [each.name for each in compare_bits(one, other)] == ["attribute sensor"]
    assert [each.values for each in compare_bits(one, one.drop_vars("w"))] == [24]
