"""Rig: forward and backward, against the six-parameter closed form, against finite differences, and its files."""

import dataclasses
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from aligned_rig import aligned_rig
from numba import get_num_threads, set_num_threads

from fringedic.errors import CalibrationError, ImageError
from fringedic.patterns.pattern import Orientation
from fringedic.rig.geometry import ADDED
from fringedic.rig.model import RigModel
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration, preset

PITCH = 10.0
IDEAL = aligned_rig(
    (128, 96),
    0.5e-3,
    (800, 600),
    5000.0,
    identifier="ideal",
    model="six_parameter",
    camera_distance=0.6,
    pixel_aspect=1.02,
    principal_column=60.0,
    principal_row=50.0,
    projector_position=(0.2, 0.0, 0.55),
)
MISALIGNED = dataclasses.replace(
    IDEAL,
    model="general",
    camera_tilt_x=0.004,
    camera_tilt_y=-0.003,
    projector_position=(0.2, 0.013, 0.55),
    projector_rotation=(0.006, -0.004, 0.008),
    projector_principal_column=402.0,
    projector_principal_row=290.0,
    projector_k1=0.4,
)
LEFT = dataclasses.replace(MISALIGNED, projector_position=(-0.2, 0.013, 0.55))
BROWN = dataclasses.replace(MISALIGNED, projector_k2=-3.0, projector_p1=2e-3, projector_p2=-3e-3, projector_k3=40.0)
ABOVE = dataclasses.replace(MISALIGNED, projector_position=(0.01, 0.22, 0.55))
ABOVE_BROWN = dataclasses.replace(BROWN, projector_position=(0.01, 0.22, 0.55))


def surface_seen_by(rig: RigModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points on lines of sight at asymmetric heights, found with nothing but the ray of each pixel."""
    column, row = np.meshgrid(np.arange(rig.camera_width), np.arange(rig.camera_height))
    z = 0.004 * np.sin(column / 17) + 0.006 * np.cos(row / 23 + 1) + 1e-4 * column
    direction = np.stack([column, row, np.ones_like(row)], axis=-1) @ rig.ray_matrix.T
    along = (z - rig.camera_distance) / direction[..., 2]
    return along * direction[..., 0], along * direction[..., 1], z


@pytest.mark.parametrize("orientation", list(Orientation))
@pytest.mark.parametrize(
    "rig",
    [IDEAL, MISALIGNED, LEFT, ABOVE, BROWN, ABOVE_BROWN],
    ids=["ideal", "misaligned", "left", "above", "five coefficients", "above, five coefficients"],
)
def test_reconstruct_inverts_the_forward_model(rig: RigModel, orientation: Orientation) -> None:
    if orientation == Orientation.HORIZONTAL and abs(rig.projector_position[1]) < 0.1:
        rig = dataclasses.replace(rig, projector_position=(0.03, -0.2, 0.55))
    x, y, z = surface_seen_by(rig)
    shape = rig.reconstruct(rig.phase(x, y, z, PITCH, orientation), PITCH, orientation=orientation)
    error = max(float(np.abs(shape[name] - true).max()) for name, true in (("x", x), ("y", y), ("z", z)))
    assert error < 1e-9
    assert shape.z.dims == ("row", "column")
    assert bool(shape.sigma_z.isnull().all()), "the noise of a phase without sigma is not known"


def test_axes_and_signs() -> None:
    """x to the right, y up, z towards the camera; the phase grows to the right, and falls with z when d > 0."""
    reference = IDEAL.reconstruct(IDEAL.phase(*surface_seen_by(IDEAL)[:2], 0.0, PITCH), PITCH)
    assert float(reference.x[0, -1]) > 0 > float(reference.x[0, 0])
    assert float(reference.y[0, 0]) > 0 > float(reference.y[-1, 0])
    assert IDEAL.phase(0.01, 0.0, 0.0, PITCH) > IDEAL.phase(0.0, 0.0, 0.0, PITCH)
    assert abs(IDEAL.phase(0.0, 0.01, 0.0, PITCH)) < 1e-9, "the projector axis meets the origin"
    assert IDEAL.phase(0.0, 0.0, 0.005, PITCH) < 0 < LEFT_IDEAL.phase(0.0, 0.0, 0.005, PITCH)
    assert IDEAL.phase(0.0, 0.01, 0.0, PITCH, Orientation.HORIZONTAL) > 0
    above = dataclasses.replace(IDEAL, projector_position=(0.0, 0.2, 0.55))
    assert above.phase(0.0, 0.0, 0.005, PITCH, Orientation.HORIZONTAL) < 0


LEFT_IDEAL = dataclasses.replace(IDEAL, projector_position=(-0.2, 0.0, 0.55))


def test_camera_tilts_are_right_handed() -> None:
    """A positive tilt about x turns the view, which points along -z, towards +y; about y towards -x."""
    tilted_x = dataclasses.replace(IDEAL, camera_tilt_x=0.01).ray_matrix @ (60.0, 50.0, 1.0)
    tilted_y = dataclasses.replace(IDEAL, camera_tilt_y=0.01).ray_matrix @ (60.0, 50.0, 1.0)
    assert np.allclose(tilted_x, (0.0, np.sin(0.01), -np.cos(0.01)), atol=1e-15)
    assert np.allclose(tilted_y, (-np.sin(0.01), 0.0, -np.cos(0.01)), atol=1e-15)


def test_projector_rotations_turn_about_its_own_axes() -> None:
    base = IDEAL.projector_axes
    assert np.allclose(base.T @ base, np.eye(3), atol=1e-15)
    assert base[0, 0] > 0.9
    assert base[1, 1] > 0.9
    assert np.allclose(base[:, 2] * np.linalg.norm(IDEAL.projector_position), IDEAL.projector_position)
    for index, fixed in enumerate((1, 0, 2)):
        rotation = [0.0, 0.0, 0.0]
        rotation[index] = 0.1
        turned = dataclasses.replace(IDEAL, projector_rotation=tuple(rotation)).projector_axes
        assert np.allclose(turned[:, fixed], base[:, fixed])
    yawed = dataclasses.replace(IDEAL, projector_rotation=(0.1, 0.0, 0.0))
    assert yawed.phase(0.0, 0.0, 0.0, PITCH) > 0, "yaw to the left: the origin moves to the right in its image"


def test_general_model_contains_the_six_parameter_model() -> None:
    x, y, z = surface_seen_by(IDEAL)
    closed_form = IDEAL.six_parameter_model(PITCH)
    column, row = np.meshgrid(np.arange(IDEAL.camera_width), np.arange(IDEAL.camera_height))
    big_x = IDEAL.pixel_size / IDEAL.pixel_aspect * (column - IDEAL.principal_column)
    big_y = -IDEAL.pixel_size * (row - IDEAL.principal_row)
    phase = closed_form.phase(x, z)
    assert np.abs(phase - IDEAL.phase(x, y, z, PITCH)).max() < 1e-9
    general = IDEAL.reconstruct(phase, PITCH, np.full(phase.shape, 0.02))
    for name, closed in zip("xyz", closed_form.position(phase, big_x, big_y), strict=True):
        error = float(np.abs(general[name] - closed).max())
        assert error < 1e-9
    slope = closed_form.dz_dphi(phase, big_x)
    assert np.allclose(general.dz_dphi, slope, rtol=1e-9)
    assert np.allclose(general.sigma_z, np.abs(slope) * 0.02)
    assert np.allclose(general.sigma_x, np.abs(big_x) * general.sigma_z / IDEAL.camera_distance)
    assert np.allclose(general.sigma_y, np.abs(big_y) * general.sigma_z / IDEAL.camera_distance)
    step = 1e-4
    difference = (
        closed_form.position(phase + step, big_x, big_y)[2] - closed_form.position(phase - step, big_x, big_y)[2]
    )
    assert np.allclose(slope, difference / (2 * step), rtol=1e-6)


@pytest.mark.parametrize("rig", [MISALIGNED, LEFT, BROWN], ids=["misaligned", "left", "five coefficients"])
def test_noise_follows_finite_differences(rig: RigModel) -> None:
    phase = rig.phase(*surface_seen_by(rig), PITCH)
    step, sigma = 1e-4, 0.02
    before, after = rig.reconstruct(phase - step, PITCH), rig.reconstruct(phase + step, PITCH)
    shape = rig.reconstruct(phase, PITCH, np.full(phase.shape, sigma))
    assert np.allclose(shape.dz_dphi, (after.z - before.z) / (2 * step), rtol=1e-6)
    for name in "xyz":
        numeric = np.abs(after[name] - before[name]) / (2 * step) * sigma
        assert np.allclose(shape[f"sigma_{name}"], numeric, rtol=1e-6, atol=1e-15)


def test_six_parameter_model_refuses_other_rigs() -> None:
    with pytest.raises(CalibrationError, match="six-parameter"):
        MISALIGNED.six_parameter_model(PITCH)


def test_nan_and_float32_and_crops() -> None:
    phase = MISALIGNED.phase(*surface_seen_by(MISALIGNED), PITCH).astype(np.float32)
    phase[3, 4] = np.nan
    whole = MISALIGNED.reconstruct(phase, PITCH, np.full_like(phase, 0.02))
    assert whole.z.dtype == np.float32
    assert int(whole.z.isnull().sum()) == int(whole.x.isnull().sum()) == int(whole.sigma_z.isnull().sum()) == 1
    cropped = whole.z.copy(data=phase)[10:50, 20:90]
    part = MISALIGNED.reconstruct(cropped, PITCH)
    assert np.array_equal(part.z, whole.z[10:50, 20:90])
    assert np.array_equal(part.x, whole.x[10:50, 20:90])


def test_result_does_not_depend_on_the_number_of_threads() -> None:
    phase = MISALIGNED.phase(*surface_seen_by(MISALIGNED), PITCH)
    before = get_num_threads()
    try:
        set_num_threads(1)
        one = MISALIGNED.reconstruct(phase, PITCH)
    finally:
        set_num_threads(before)
    assert one.identical(MISALIGNED.reconstruct(phase, PITCH))


def test_yaml_round_trip_in_units_of_people(tmp_path: Path) -> None:
    rig = dataclasses.replace(
        BROWN,
        source="bench",
        camera_first_column=320,
        camera_first_row=240,
        parameter_names=("camera_distance", "projector_x"),
        covariance=(1e-8, 1e-9, 1e-9, 4e-8),
    )
    path = tmp_path / "rig.yaml"
    rig.to_yaml(path)
    assert RigModel.from_message(SimpleNamespace(**rig.message_fields())) == rig
    text = path.read_text()
    assert "distance_mm: 600.0" in text
    assert "pixel_size_mm: 0.5" in text
    read = RigModel.from_yaml(path)
    for field in dataclasses.fields(rig):
        value, expected = getattr(read, field.name), getattr(rig, field.name)
        is_number = isinstance(expected, float) or (isinstance(expected, tuple) and isinstance(expected[0], float))
        assert value == (pytest.approx(expected, rel=1e-14) if is_number else expected), field.name


def without_hash(text: str) -> str:
    """Return the text of a calibration file as earlier versions wrote it."""
    return "\n".join(line for line in text.splitlines() if not line.startswith("checksum: "))


def test_older_files_and_messages_name_the_model_paper(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    IDEAL.to_yaml(path)
    text = path.read_text()
    assert "model: six_parameter" in text
    path.write_text(without_hash(text).replace("model: six_parameter", "model: paper"))
    assert RigModel.from_yaml(path).model == "six_parameter"
    fields = IDEAL.message_fields()
    assert fields["model"] == "six_parameter"
    assert RigModel.from_message(SimpleNamespace(**{**fields, "model": "paper"})) == IDEAL


def test_files_and_messages_with_k1_alone_have_no_other_distortion(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    BROWN.to_yaml(path)
    text = without_hash(path.read_text())
    lines = [line for line in text.splitlines() if line.strip()[:3] not in ("k2:", "p1:", "p2:", "k3:")]
    path.write_text("\n".join(lines))
    assert RigModel.from_yaml(path).phase(0.01, 0.02, 0.0, PITCH) == pytest.approx(
        MISALIGNED.phase(0.01, 0.02, 0.0, PITCH)
    )
    fields = {name: value for name, value in BROWN.message_fields().items() if name not in ADDED}
    assert RigModel.from_message(SimpleNamespace(**fields)) == MISALIGNED


@pytest.mark.parametrize("orientation", list(Orientation))
def test_distortion_of_the_projector_is_that_of_opencv(orientation: Orientation) -> None:
    """A camera of OpenCV (y down, z forward) in the projector's place sees points where their fringes leave it."""
    points = np.stack(surface_seen_by(BROWN), axis=-1)[::8, ::8].reshape(-1, 3)
    axes = BROWN.projector_axes * (1, -1, -1)  # right, down, forward
    focal = BROWN.projector_focal_length
    matrix = np.array(
        [[focal, 0, BROWN.projector_principal_column], [0, focal, BROWN.projector_principal_row], [0, 0, 1.0]]
    )
    lens = np.array([getattr(BROWN, f"projector_{name}") for name in ("k1", "k2", "p1", "p2", "k3")])
    seen, _ = cv2.projectPoints(points, cv2.Rodrigues(axes.T)[0], -axes.T @ BROWN.projector_position, matrix, lens)
    column, row = seen[:, 0].T
    if orientation == Orientation.VERTICAL:
        coordinate = column - (BROWN.projector_width - 1) / 2
    else:
        coordinate = (BROWN.projector_height - 1) / 2 - row
    error = BROWN.phase(*points.T, PITCH, orientation) - 2 * np.pi * coordinate / PITCH
    assert float(np.abs(error).max()) < 1e-9


def test_bad_models_are_refused(tmp_path: Path) -> None:
    for change, says in (
        ({"camera_distance": 0.0}, "camera_distance"),
        ({"pixel_size": float("nan")}, "pixel_size"),
        ({"projector_position": (0.1, 0.0, -0.5)}, "projector_position"),
        ({"model": "other"}, "other"),
        ({"covariance": (1.0,)}, "covariance"),
    ):
        with pytest.raises(CalibrationError, match=says):
            dataclasses.replace(IDEAL, **change)
    with pytest.raises(CalibrationError, match=r"covariance is .* a finite number") as refused:
        dataclasses.replace(IDEAL, covariance=(float("nan"),) * 196)
    assert len(str(refused.value)) < 500
    path = tmp_path / "rig.yaml"
    IDEAL.to_yaml(path)
    path.write_text(path.read_text().replace("distance_mm: 600.0", "distance_mm: -600.0") + "edited: true\n")
    with pytest.raises(CalibrationError, match=r"rig.yaml: camera_distance"):
        RigModel.from_yaml(path)
    path.write_text("camera: {width_px: 12}")
    with pytest.raises(CalibrationError, match="height_px is missing"):
        RigModel.from_yaml(path)
    path.write_text("[]")
    with pytest.raises(CalibrationError, match="not the calibration"):
        RigModel.from_yaml(path)
    with pytest.raises(ImageError, match="sigma"):
        IDEAL.reconstruct(np.zeros((3, 4)), PITCH, np.zeros((4, 3)))
    with pytest.raises(ImageError, match="image"):
        IDEAL.reconstruct(np.zeros(3), PITCH)


AGAINST_TWIN = {
    "misaligned": {},
    "distorted": {"projector": {"k1": 0.3}},
    "five coefficients": {"projector": {"k1": 0.3, "k2": -3.0, "p1": 2e-3, "p2": -3e-3, "k3": 40.0}},
    "skew": {
        "camera": {"tilt_x_degree": -1.0, "tilt_y_degree": 2.0, "principal_column": 70.0, "pixel_aspect": 1.03},
        "projector": {"x_mm": -150.0, "y_mm": 40.0, "yaw_degree": 1.0, "roll_degree": -3.0, "principal_row": 20.0},
    },
}


@pytest.mark.parametrize("orientation", list(Orientation))
@pytest.mark.parametrize("changes", AGAINST_TWIN.values(), ids=AGAINST_TWIN.keys())
def test_agrees_with_the_digital_twin(changes: dict[str, dict[str, float]], orientation: Orientation) -> None:
    """The twin traces its own rays with its own matrices: agreement is a check of both."""
    sections = preset("sphere", size="tiny")
    if orientation == Orientation.HORIZONTAL:
        changes = {**changes, "projector": {**changes.get("projector", {}), "x_mm": 10.0, "y_mm": 180.0}}
    for name, entries in changes.items():
        sections[name] = {**sections.get(name, {}), **entries}
    twin = VirtualRig(VirtualRigConfiguration.from_dict(sections))
    rig = RigModel(**twin.optics())
    view, truth = twin.view(0.0), twin.truth(0.0)
    if orientation == Orientation.VERTICAL:
        coordinate = view.projector_column - (rig.projector_width - 1) / 2
    else:
        coordinate = (rig.projector_height - 1) / 2 - view.projector_row
    shape = rig.reconstruct(2 * np.pi * coordinate / PITCH, PITCH, orientation=orientation)
    assert float(truth.z.notnull().mean()) > 0.5
    for name in "xyz":
        error = float(np.abs(shape[name] - truth[name]).max())
        assert error < 1e-9
        assert np.array_equal(shape[name].isnull(), truth[name].isnull())
