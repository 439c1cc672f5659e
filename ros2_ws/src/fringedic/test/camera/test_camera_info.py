"""The calibration of a camera by ROS is read as its lens, and is refused by name where a rig is needed."""

import cv2
import numpy as np
import pytest
import yaml

from fringedic.camera import DistortionMap
from fringedic.errors import CalibrationError, GridError
from fringedic.rig.model import RigModel

WIDTH, HEIGHT = 640, 480
MATRIX = [[520.0, 0, 325.0], [0, 522.0, 236.0], [0, 0, 1]]
LENSES = {
    "plumb_bob": [-0.28, 0.07, 1e-3, -5e-4, 0.0],
    "rational_polynomial": [0.3, -0.1, 2e-4, 1e-4, 0.01, 0.6, -0.15, 0.02],
    "equidistant": [0.02, -0.01, 0.004, -0.001],
}


def ost(model, *, flat=False):
    entries = [each for row in MATRIX for each in row]
    if flat:
        sizes = {"width": WIDTH, "height": HEIGHT}
        return sizes | {"distortion_model": model, "k": entries, "d": LENSES[model], "r": [], "p": []}
    return {
        "image_width": WIDTH,
        "image_height": HEIGHT,
        "camera_name": "head",
        "camera_matrix": {"rows": 3, "cols": 3, "data": entries},
        "distortion_model": model,
        "distortion_coefficients": {"rows": 1, "cols": len(LENSES[model]), "data": LENSES[model]},
    }


def written(path, content):
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.mark.parametrize("flat", [False, True], ids=["ost.yaml", "camera_info"])
@pytest.mark.parametrize("model", LENSES)
def test_lens_of_another_program(tmp_path, model, flat):
    """A point of the ideal camera is seen where the model of the lens images it."""
    lens = DistortionMap.load(written(tmp_path / "ost.yaml", ost(model, flat=flat)))
    column, row = np.meshgrid(np.linspace(40, WIDTH - 40, 21), np.linspace(30, HEIGHT - 30, 17))
    points = np.stack([(column - 325) / 520, (row - 236) / 522, np.ones(column.shape)], axis=-1).reshape(1, -1, 3)
    project = cv2.fisheye.projectPoints if model == "equidistant" else cv2.projectPoints
    seen = project(points, np.zeros(3), np.zeros(3), np.array(MATRIX), np.array(LENSES[model]))[0].reshape(-1, 2)
    inside = (seen[:, 0] > 0) & (seen[:, 0] < WIDTH - 1) & (seen[:, 1] > 0) & (seen[:, 1] < HEIGHT - 1)
    assert inside.sum() > 200
    found = np.stack(lens.ideal(*seen[inside].T), axis=-1)
    expected = np.stack([column.ravel(), row.ravel()], axis=-1)[inside]
    assert np.abs(found - expected).max() < 0.01
    assert np.abs(seen[inside] - expected).max() > 1


def test_calibration_of_a_camera_is_none_of_a_rig(tmp_path):
    file = written(tmp_path / "ost.yaml", ost("plumb_bob"))
    with pytest.raises(CalibrationError, match=r"ost\.yaml: this is the calibration of a camera alone.*the lens only"):
        RigModel.from_yaml(file)


def entry(content, name, value):
    return {**content, name: value}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"camera_matrix": {"data": [1]}}, "distortion_model is missing"),
        (entry(ost("plumb_bob"), "distortion_model", "omni"), "distortion_model 'omni' is not supported; known are"),
        (entry(ost("plumb_bob"), "camera_matrix", {"data": [0] * 9}), "this camera is not calibrated"),
        (entry(ost("plumb_bob"), "camera_matrix", {"data": [1, 2]}), "this is not the calibration of a camera"),
        (
            entry(ost("plumb_bob"), "distortion_coefficients", {"data": [-5.0, 0, 0, 0, 0]}),
            "cannot be inverted within its whole image",
        ),
    ],
)
def test_calibration_of_a_camera_that_is_of_no_use_says_why(tmp_path, content, words):
    with pytest.raises(GridError, match=words):
        DistortionMap.load(written(tmp_path / "ost.yaml", content))
