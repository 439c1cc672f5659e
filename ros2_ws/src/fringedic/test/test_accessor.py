"""The methods of datasets: the first picture of a user has to be right side up."""

import json

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr

import fringedic
from fringedic.datasets.millimetres import with_millimetres
from fringedic.errors import DatasetError

SCALE = 1e-4  # [m/px]
CALIBRATION = {"pixel_size": SCALE, "pixel_aspect": 1.0, "principal_row": 20.0, "principal_column": 30.0}


@pytest.fixture
def experiment():
    """A plate stretched by 1 % along x, whose upper half moves towards the camera; step 1 is twice step 0."""
    _ = fringedic.ExperimentAccessor  # the first public name registers the methods
    rows, columns = np.arange(0, 40, 2), np.arange(0, 60, 2)
    column, row = np.meshgrid(columns, rows)
    one = {
        "x": SCALE * (column - 30.0),
        "y": -SCALE * (row - 20.0),
        "z": 0.0 * row,
        "u": 0.01 * SCALE * (column - 30.0),
        "v": 0.0 * row,
        "w": np.where(row < 20, 5e-6, 0.0),
    }
    fields = {
        name: (("step", "row", "column"), np.stack([each, each if name in "xyz" else 2 * each]), {"units": "m"})
        for name, each in one.items()
    }
    attributes = {"experiment": "plate", "calibration": json.dumps(CALIBRATION)}
    dataset = xr.Dataset(fields, {"step": [0, 1], "row": rows, "column": columns}, attributes)
    return with_millimetres(dataset.assign(force=("step", [0.0, 50.0])))


@pytest.fixture(autouse=True)
def _close_figures():
    plt.switch_backend("agg")
    yield
    plt.close("all")


def test_the_first_picture_is_right_side_up_and_in_millimetres(experiment):
    axes = experiment.fringedic.plot("w", step=-1)
    image = axes.images[0]
    drawn = axes.figure
    drawn.canvas.draw()
    left, right, bottom, top = image.get_extent()
    assert (left, right, bottom, top) == pytest.approx((-3.1, 2.9, -1.9, 2.1))
    # the upper half of the specimen moves, and it has to be the upper half of the picture
    above, below = (axes.transData.transform((0.0, y))[1] for y in (1.0, -1.0))
    assert above > below
    values = image.get_array()
    assert values[0, 0] == pytest.approx(10)
    assert values[-1, 0] == pytest.approx(0)
    assert (axes.get_xlabel(), axes.get_ylabel(), axes.child_axes[0].get_ylabel()) == ("x [mm]", "y [mm]", "µm")
    assert axes.get_title() == "step 1: displacement w along z (to the camera)"


def test_xarray_draws_the_same_with_the_coordinates_in_millimetres(experiment):
    drawn = experiment.w.isel(step=-1).plot(x="x_mm", y="y_mm")
    axes = drawn.axes
    assert axes.get_xlabel() == "x (right) [mm]"
    above, below = (axes.transData.transform((0.0, y))[1] for y in (1.0, -1.0))
    assert above > below
    assert float(experiment.w.isel(step=-1).swap_dims(row="y_mm").sel(y_mm=1.0).max()) == pytest.approx(10e-6)


def test_methods_return_what_the_functions_return(experiment):
    of_dataset = experiment.fringedic
    gauge = of_dataset.extensometer((10, 20), (50, 20))
    assert gauge.strain.values == pytest.approx([0.01, 0.02])
    assert of_dataset.force_curve(gauge.strain, section=1e-5).stress.values == pytest.approx([0, 5e6])
    line = of_dataset.profile("w", (30, 2), (30, 36))
    assert float(line.w.isel(step=1, position=0)) == pytest.approx(10e-6)
    upper = fringedic.Region.rectangle((0, 0), (58, 18))
    assert of_dataset.region("w", upper).w.sel(statistic="mean").values == pytest.approx([5e-6, 10e-6])
    assert abs(of_dataset.remove_rigid_motion(upper).w.isel(row=0)).max() < 1e-12
    strain = of_dataset.strain(window=9, measures=["von_mises"])
    middle = strain.isel(row=5, column=15)
    assert float(middle.e_11) == pytest.approx(0.02 + 0.02**2 / 2)
    assert float(middle.e_von_mises) > 0.02
    assert float(of_dataset.strain(window=9, step=0).e_11.isel(row=5, column=15)) == pytest.approx(0.01 + 0.01**2 / 2)


def test_wrong_names_and_steps_are_one_sentence(experiment):
    with pytest.raises(DatasetError, match=r"the dataset has no map q; it has .*w"):
        experiment.fringedic.plot("q")
    with pytest.raises(DatasetError, match="has no step 7; it has 0, 1, and -1 is the last one"):
        experiment.fringedic.plot("w", step=7)
    with pytest.raises(DatasetError, match="name is 3: it has to be a text"):
        experiment.fringedic.plot(3)


def test_files_are_written(experiment, tmp_path):
    [done] = experiment.fringedic.export(tmp_path / "out", "csv")
    data = (done.path / "step_001.csv").read_bytes()
    assert data.startswith(b"\xef\xbb\xbf"), "Excel shows µ as another character without a byte-order mark"
    table = np.genfromtxt(done.path / "step_001.csv", delimiter=",", names=True, encoding="utf-8-sig")
    assert table["w_µm"][0] == pytest.approx(10)
