"""A damaged ground truth costs a run its comparison, not its table, its pictures and its report."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from rich.console import Console

from fringedic.command.outcome import RunReport, StepReport
from fringedic.command.run_results import write_results
from fringedic.command.run_table import report_table
from fringedic.datasets import open_experiment, process_bag

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"
STEPS = 3


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> RunReport:
    """Write the results of a recording; beside it lie a truncated ground truth and a dataset of its first steps."""
    folder = tmp_path_factory.mktemp("run")
    shutil.copytree(RECORDED, folder / "bag")
    process_bag(folder / "bag", steps=[0, 1])
    xr.Dataset({"u": (("step", "row"), np.zeros((STEPS, 5000)))}).to_netcdf(folder / "truth.nc", engine="h5netcdf")
    data = (folder / "truth.nc").read_bytes()
    (folder / "truth.nc").write_bytes(data[: len(data) * 6 // 10])
    return write_results("tiny", folder, [StepReport(step, 1e-4 * step, force=-1e6) for step in range(STEPS)])


def test_results_are_written(written: RunReport) -> None:
    assert not written.failed
    assert (written.folder / "results.nc").exists()
    assert sorted(path.name for path in written.pictures) == [
        f"step_00{step}{kind}.png" for step in range(STEPS) for kind in ("", "_resolution", "_sigma", "_strain")
    ]


def test_the_table_has_the_force_of_the_dataset(written: RunReport) -> None:
    """The nodes give the reading of the load cell, without sign and tare of the specimen."""
    with open_experiment(written.folder / "results.nc") as dataset:
        assert [step.force for step in written.steps] == dataset.force.values.tolist()
        assert abs(dataset.force.values[-1]) < 1e4


def test_reason_is_in_the_table_and_in_the_report(written: RunReport) -> None:
    assert "truth.nc: is no ground truth or is damaged" in written.no_errors
    assert not any(step.errors for step in written.steps)
    table = report_table(written)
    assert "no errors against the ground truth" in str(table.title)
    assert table.row_count == STEPS
    assert Console(width=200).render_lines(table)
    page = (written.folder / "report.html").read_text()
    assert "No comparison with the ground truth" in page


def test_the_report_is_that_of_the_results(written: RunReport) -> None:
    """It was that of a dataset that another command had made of the recording during the run."""
    assert f"step {STEPS - 1}" in (written.folder / "report.html").read_text()
