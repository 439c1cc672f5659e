"""A specimen that is pulled at a constant rate and measured without a hold, through the nodes of the virtual rig."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from running_system import RecordedExperiment, record_experiment

import fringedic
from fringedic.configuration.rig_file import load_rig_file
from fringedic.datasets.processing import dataset_from_derived, process_bag
from fringedic.evaluation import open_truth, rates, strain_curve, truth_errors
from fringedic.frames.region import Region
from fringedic.recording.every_frame import STEPS_PER_STACK
from fringedic.recording.frames import records
from fringedic.recording.reader import BagReader
from fringedic.virtual_rig import VirtualRig

SPEED, END = 6e-6, 1.73e-4  # [m/s] of the crosshead, and where it reaches the force [m]
LOADED = 3e-4  # strain beyond the play of the grips
PATCH = 20  # points of a side; the errors of patches of a map are independent
PULL = "{experiment: pull, continuous: {to_mm: 0.5, speed_mm_per_s: 0.006, until: {force_above_n: 300}}}"


@pytest.fixture(scope="module")
def pulled(tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> RecordedExperiment:
    folder = tmp_path_factory.mktemp("pull")
    (folder / "pull.yaml").write_text(PULL)
    return record_experiment(tiny, folder / "run", "--programme", str(folder / "pull.yaml"))


@pytest.fixture(scope="module")
def results(pulled: RecordedExperiment) -> Iterator[xr.Dataset]:
    with fringedic.open_experiment(pulled.report.folder / "results.nc") as dataset:
        yield dataset


@pytest.fixture(scope="module")
def moving(results: xr.Dataset) -> xr.Dataset:
    """Return the stacks before the end of the move."""
    return results.isel(step=(results.step > 0).values & (results.position < 0.95 * END).values)


def test_force_and_maps_at_many_instants_without_a_hold(
    pulled: RecordedExperiment, results: xr.Dataset, moving: xr.Dataset
) -> None:
    assert "the force of 30" in pulled.output, "the condition ends the move"
    assert moving.sizes["step"] >= 2, "many more on a computer without other work"
    assert results.sizes["step"] - moving.sizes["step"] <= 3, "the step at rest, and stacks at the end of the move"
    assert (moving.error == "").all()
    seconds = 1e-9 * (moving.time.values - moving.time.values[0]).astype(float)
    np.testing.assert_allclose(moving.position, float(moving.position[0]) + SPEED * seconds, atol=2e-7)
    assert (np.diff(moving.force) > 0).all()
    exposed = list(records(BagReader(pulled.report.folder / "bag")))
    for step, drift in zip(moving.step.values, moving.position_drift.values, strict=True):
        first, *_, last = (each for each in exposed if each.step == step)
        seconds = 1e-9 * (last.stamp - first.stamp) + first.exposure_time
        assert drift == pytest.approx(SPEED * seconds, abs=2e-7), "over all exposures of the stack"
    assert (moving.valid_fraction > 0.6).all()


def test_displacements_and_their_rates_have_the_stated_errors(pulled: RecordedExperiment, moving: xr.Dataset) -> None:
    found = rates(moving)
    assert (abs(found.v_rate.median(("row", "column"))) > 0.2 * SPEED).all()
    with open_truth(pulled.report.folder / "truth.nc") as truth:
        errors = [truth_errors(moving, truth, int(step)) for step in moving.step]
    for name in "uvw":
        maps = np.stack([each[f"error_{name}"].values for each in errors])  # [m]
        scores = maps / moving[f"sigma_{name}"].values
        assert 0.8 < float(np.sqrt(np.nanmean(scores**2))) < 1.25, name
        seconds = 1e-9 * np.diff(moving.time.values.astype(np.int64))
        of_rates = np.diff(maps, axis=0) / seconds[:, None, None] / found[f"sigma_{name}_rate"].values
        patches = xr.DataArray(of_rates**2, dims=("interval", "row", "column")).coarsen(row=PATCH, column=PATCH).mean()
        squares = patches.values[np.isfinite(patches.values)]
        chance = 3 * squares.std(ddof=1) / np.sqrt(squares.size)  # few intervals are few independent patches
        assert 0.9**2 - chance < squares.mean() < 1.1**2 + chance, name
        of_an_interval = chance * np.sqrt(len(errors) - 1)  # a busy computer measures few of them during the pull
        assert of_an_interval < 0.6, "a wrong standard deviation is found"


def test_frames_give_the_same_bits_as_the_nodes(pulled: RecordedExperiment, tmp_path: Path) -> None:
    bag = pulled.report.folder / "bag"
    live, again = dataset_from_derived(bag, output=tmp_path / "live.nc"), process_bag(bag, output=tmp_path / "again.nc")
    with fringedic.open_experiment(live) as nodes, fringedic.open_experiment(again) as processed:
        checks = {"confirmed_fraction", "phase_closure"}  # need the frames
        shared = [str(name) for name, each in nodes.data_vars.items() if name in processed and each.dtype.kind in "fi"]
        shared = [name for name in shared if name not in checks]
        assert {"phase", "u", "e_22", "sigma_w", "force", "position"} <= {*shared}
        for name in [*shared, "time"]:
            np.testing.assert_array_equal(nodes[name], processed[name], err_msg=name)


def loaded_points(dataset: xr.Dataset) -> xr.Dataset:
    """Return strain and force of the steps beyond the play of the grips."""
    curve = strain_curve(dataset, Region.rectangle((60, 40), (100, 80)))
    return curve.isel(step=(curve.e_22 > LOADED).values)


def test_force_over_strain_is_that_of_a_stepwise_test_of_the_same_plate(
    moving: xr.Dataset, recorded: RecordedExperiment
) -> None:
    with fringedic.open_experiment(recorded.report.folder / "results.nc") as steps:
        resting, pulled = loaded_points(steps), loaded_points(moving)
    assert pulled.sizes["step"] >= 1, "many more on a computer without other work"
    design, places = (np.stack([np.ones(each.sizes["step"]), each.e_22.values], axis=1) for each in (resting, pulled))
    line = np.linalg.solve(design.T @ design, design.T @ resting.force.values)  # [N], [N per strain]
    spread = np.einsum("ki,ij,kj->k", places, np.linalg.inv(design.T @ design), places)
    noise = float(line[1] * resting.sigma_e_22.max()) ** 2 * spread + (line[1] * pulled.sigma_e_22.values) ** 2
    assert (noise**0.5 < 0.02 * float(resting.force.max())).all()
    assert (np.abs(pulled.force.values - places @ line) < 3 * noise**0.5).all()


def test_a_window_that_slides_by_a_frame_is_as_good_as_a_stack(
    pulled: RecordedExperiment, moving: xr.Dataset, tiny: Path, tmp_path: Path
) -> None:
    first = int(moving.step[0])
    windows = [STEPS_PER_STACK * first + frame for frame in range(8)]
    steps = [0, *windows, STEPS_PER_STACK * (first + 1)]
    sliding = process_bag(pulled.report.folder / "bag", output=tmp_path / "every.nc", steps=steps, every_frame=True)
    rig = VirtualRig(load_rig_file(tiny).virtual_configuration())
    with fringedic.open_experiment(sliding) as every:
        assert (every.error == "").all()
        assert (np.diff(every.time.values) > np.timedelta64(0)).all()
        for name in ("phase", "w"):
            own, stack = every[name].sel(step=windows[0]), moving[name].sel(step=first)
            np.testing.assert_array_equal(own, stack, err_msg=f"{name} of the stack itself")
        for step in windows:
            window = every.sel(step=step)
            # the last frames of a stack and the first ones of the next are further apart than those of one stack
            assert np.isfinite(window.w).mean() > 0.5 * np.isfinite(moving.w.sel(step=first)).mean()
            truth = rig.truth(float(window.position), 0.0)
            for name in "uvw":
                scores = (window[name].values - truth[name]) / window[f"sigma_{name}"].values
                assert 0.8 < float(np.sqrt(np.nanmean(scores**2))) < 1.25, (step, name)


def test_the_report_states_the_motion(pulled: RecordedExperiment) -> None:
    page = (pulled.report.folder / "report.html").read_text("utf-8")
    assert "steps measured in motion" in page
    assert "points lost to motion" in page
    assert "strain rate (e_22)" in page
    assert "0.006 mm/s" in page
