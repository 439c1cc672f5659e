"""Pictures: axes, colours and blanks."""

import json

import cv2
import numpy as np
import pytest
import xarray as xr

from fringedic.datasets.millimetres import with_millimetres
from fringedic.errors import DatasetError
from fringedic.figures.maps import maps_figure, save_pictures
from fringedic.figures.panels import ERRORS, SHAPE_AND_DISPLACEMENT, Panel
from fringedic.figures.previews import NOT_MEASURED, displacement_preview, phase_preview

CALIBRATION = {"pixel_size": 1e-4, "pixel_aspect": 1.0, "principal_row": 29.5, "principal_column": 39.5}


def experiment(calibrated=True, white=()):
    """Three steps of 30 x 40 points: u grows to the right, v upwards; a hole on the upper right; step 2 failed."""
    row, column = np.arange(0, 60, 2), np.arange(0, 80, 2)
    fields = {
        "shape_z": 1e-3 * (column / 80 + 0 * row[:, None]),
        "u": 1e-6 * column + 0 * row[:, None],
        "v": 2e-6 * (60 - row[:, None]) + 0 * column,
        "w": 1e-6 * (row[:, None] - column),
        "displacement_x": 0.1 * column + 0 * row[:, None],
        "displacement_y": -0.1 * (60 - row[:, None]) + 0 * column,
        "displacement_sigma_x": 0.01 + (7 * row[:, None] + 3 * column) % 100,
        "displacement_sigma_y": 0.02 + (3 * row[:, None] + 7 * column) % 100,
    }
    maps = {}
    for name, values in fields.items():
        steps = np.stack([step * values for step in (0.0, 1.0, 2.0)]).astype(np.float32)
        steps[:, :6, -8:] = np.nan
        steps[2] = np.nan
        for step in white:
            steps[step] = np.nan if name in ("shape_z", "u", "v", "w") else steps[step]
        maps[name] = (("step", "row", "column"), steps)
    maps["force"] = ("step", [0.0, 12.5, np.nan])
    maps["position"] = ("step", [0.0, 1e-3, np.nan])
    attributes = {"experiment": "plate"} | ({"calibration": json.dumps(CALIBRATION)} if calibrated else {})
    return with_millimetres(xr.Dataset(maps, {"step": [0, 1, 2], "row": row, "column": column}, attributes))


def truth_of(dataset):
    valid = ("step", "row", "column"), np.ones((3, 30, 40), bool)
    return dataset[["u", "v", "w"]].assign(z_deformed=dataset.shape_z, valid=valid)


def panel_axes(figure):
    return [axes for axes in figure.axes if axes.images]


def test_axes_are_millimetres_with_y_upwards():
    step = experiment().sel(step=1)
    figure = maps_figure(step, SHAPE_AND_DISPLACEMENT, title="plate")
    u, v = panel_axes(figure)[1:3]
    assert u.get_xlabel() == "x [mm]"
    assert u.get_ylabel() == "y [mm]"
    assert u.images[0].get_extent() == pytest.approx([-4.05, 3.95, -2.95, 3.05])
    bottom, top = u.get_ylim()
    assert bottom < 0 < top
    shown = v.images[0].get_array()
    assert shown[0, 0] == pytest.approx(120)
    assert shown[-1, 0] == pytest.approx(4)
    assert [axes.child_axes[0].get_ylabel() for axes in panel_axes(figure)] == ["mm", "µm", "µm", "µm"]
    assert v.get_title() == "displacement v along y (up)"


def test_what_is_not_measured_is_grey():
    figure = maps_figure(experiment().sel(step=1), SHAPE_AND_DISPLACEMENT, title="plate")
    image = panel_axes(figure)[1].images[0]
    colours = image.to_rgba(image.get_array(), bytes=True)
    assert tuple(colours[0, -1, :3]) == NOT_MEASURED
    assert tuple(colours[-1, -1, :3]) != NOT_MEASURED


def test_without_calibration_the_axes_are_pixels_with_rows_downwards():
    axes = panel_axes(maps_figure(experiment(calibrated=False).sel(step=1), SHAPE_AND_DISPLACEMENT, title=""))[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("column [px]", "row [px]")
    assert axes.images[0].get_extent() == [-1, 79, 59, -1]


def test_errors_have_a_scale_that_is_symmetric_about_zero():
    step = experiment().sel(step=1)
    errors = step[["shape_z", "u", "v", "w"]].rename(shape_z="error_z", u="error_u", v="error_v", w="error_w")
    figure = maps_figure(errors.map(lambda each: each.assign_attrs(units="m")), ERRORS, title="")
    for axes in panel_axes(figure):
        low, high = axes.images[0].get_clim()
        assert low == -high < 0
    assert "RMS" in panel_axes(figure)[1].get_title()


def test_every_measured_step_has_its_pictures(tmp_path):
    dataset = experiment(white=(1,))
    files = save_pictures(dataset, tmp_path / "maps")
    assert [file.name for file in files] == ["step_000.png", "step_000_sigma.png", "step_001.png", "step_001_sigma.png"]
    pictures = [cv2.imread(str(file)) for file in files]
    assert all(picture.shape[1] == 1250 and picture.std() > 10 for picture in pictures)


def test_a_picture_does_not_depend_on_the_steps_drawn_before(tmp_path):
    dataset = experiment()
    dataset["v"][1] -= 5e-4  # another sign and another number of digits beside the colours
    exact = truth_of(dataset)
    exact["u"] = exact["u"] * (1 + 1e-4 * dataset.step)
    both = save_pictures(dataset, tmp_path / "both", truth=exact)
    alone = save_pictures(dataset.isel(step=[1, 2]), tmp_path / "alone", truth=exact)
    assert len(both) == 2 * len(alone) == 6
    for file, expected in zip(both[3:], alone, strict=True):
        np.testing.assert_array_equal(cv2.imread(str(file)), cv2.imread(str(expected)), err_msg=file.name)


def test_errors_are_drawn_where_the_truth_is_known(tmp_path):
    dataset = experiment()
    exact = truth_of(dataset)
    files = save_pictures(dataset.isel(step=[1, 2]), tmp_path, truth=exact)
    assert [file.name for file in files] == ["step_001.png", "step_001_sigma.png", "step_001_errors.png"]


def test_a_map_that_is_not_there_is_named():
    with pytest.raises(DatasetError, match="has no w"):
        maps_figure(experiment().drop_vars("w").sel(step=1), SHAPE_AND_DISPLACEMENT, title="")


def test_phase_preview_repeats_with_the_fringes():
    phase = np.array([[0.0, 2 * np.pi, 1.0, np.nan, 1.0 - 2 * np.pi]], np.float32)
    colours = phase_preview(phase)
    assert colours.dtype == np.uint8
    assert colours.shape == (1, 5, 3)
    assert (colours[0, 0] == colours[0, 1]).all()
    assert (colours[0, 2] == colours[0, 4]).all()
    assert (colours[0, 0] != colours[0, 2]).any()
    assert tuple(colours[0, 3]) == NOT_MEASURED


def test_displacement_preview_shows_direction_and_length():
    displacement = np.zeros((1, 5, 2), np.float32)
    displacement[0, 0] = 4, 0
    displacement[0, 1] = -4, 0
    displacement[0, 2] = 0, -4  # upwards
    displacement[0, 4] = np.nan
    right, left, up, still, blank = displacement_preview(displacement)[0].astype(int)
    assert right[0] == 255
    assert right[1:].max() == 0
    assert left[0] == 0
    assert left[1:].min() > 250
    assert up[1] == 255
    assert 100 < up[0] < 160
    assert up[2] == 0
    assert still.tolist() == [255, 255, 255]
    assert tuple(blank) == NOT_MEASURED
    assert tuple(displacement_preview(np.full((2, 2, 2), np.nan, np.float32))[0, 0]) == NOT_MEASURED


def test_preview_of_a_large_displacement_shows_some_of_its_points():
    displacement = np.random.default_rng(1).normal(size=(300, 1281, 2)).astype(np.float32)
    displacement[::3, ::3] = 1.0
    preview = displacement_preview(displacement)
    assert preview.shape == (100, 427, 3)
    assert (preview == preview[0, 0]).all()


def test_maps_that_are_compared_have_one_colour_scale():
    step = experiment().sel(step=1)
    step["model_w"] = (0.5 * step["w"]).assign_attrs(units="m")
    alike = panel_axes(maps_figure(step, (Panel("w", "", like="model_w"), Panel("model_w", "", like="w")), title=""))
    (first, second) = (axes.images[0].get_clim() for axes in alike)
    assert first == second
    (own,) = panel_axes(maps_figure(step, (Panel("model_w", ""),), title=""))
    assert own.images[0].get_clim() != second
