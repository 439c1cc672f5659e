"""Distortion from one image of a grid, on the virtual rig: what is left of a lens, the plane, unusable images."""

import functools
import math
from collections.abc import Callable
from enum import StrEnum
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from fringedic.calibration.sentences import finding_sentence
from fringedic.camera import DistortionMap
from fringedic.camera.findings import GridFinding
from fringedic.camera.grid import GridMeasurement, measure_distortion
from fringedic.camera.homography import apply_homography, fit_homography
from fringedic.errors import GridError, ImageError
from fringedic.rig.model import RigModel
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

PITCH_MM = 0.4
BROWN = {"k1": -0.3, "k2": 1.0, "p1": 2e-4, "p2": -3e-4}
ODD = {"k1": -0.3, "bump_percent": (0.05, -0.03), "bump_centre_percent": (15.0, -8.0), "bump_radius_percent": 12.0}
# Things are seen farther right than they are, on the right side only.
ONE_SIDED = {"bump_percent": (0.1, 0.0), "bump_centre_percent": (25.0, 0.0), "bump_radius_percent": 16.0}


def twin_with(lens: dict[str, Any], **changes: Any) -> VirtualRig:
    stage = {"grid_pitch_mm": PITCH_MM, **changes.pop("stage", {})}
    return VirtualRig(
        VirtualRigConfiguration.from_dict(
            {
                "preset": "reference_plane",
                "alignment": "misaligned",
                "camera": {"lens": lens, **changes.pop("camera", {})},
                "specimen": {"surface": "grid"},
                "stage": stage,
                **changes,
            }
        )
    )


def image_of(twin: VirtualRig, frame: int = 0) -> np.ndarray:
    return twin.expose(np.full(twin.projector_shape, 255, np.uint8), 0.0, frame)


def half_size(lens: dict[str, Any], **changes: Any) -> VirtualRig:
    """The same camera with a quarter of the pixels and half of the field."""
    camera = {"columns": 640, "rows": 480, **changes.pop("camera", {})}
    return twin_with(lens, camera=camera, **changes)


@functools.cache
def good_image() -> np.ndarray:
    image = image_of(half_size({}))
    image.setflags(write=False)
    return image


def left_by(distortion: DistortionMap, twin: VirtualRig) -> tuple[float, np.ndarray]:
    """Distortion left after the best homography [px], root mean square and map, at every fifth pixel of row and column.

    The narrowest bump of a lens is 75 px wide.
    """
    row, column = np.mgrid[: twin.shape[0] : 5, : twin.shape[1] : 5]
    true = np.stack([each[row, column] for each in twin.straight_pixels()], axis=-1).reshape(-1, 2)
    found = np.stack(distortion.ideal(column, row), axis=-1).reshape(-1, 2)
    error = apply_homography(fit_homography(found[::31], true[::31]), found) - true
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1)))), error.reshape(*row.shape, 2)


def untouched(twin: VirtualRig) -> DistortionMap:
    return DistortionMap(twin.shape[1], twin.shape[0], np.zeros((1, 1)), np.zeros((1, 1)))


@pytest.mark.parametrize(
    ("twin_of", "lens", "target"),
    [pytest.param(twin_with, BROWN, 5e-4, id="brown, full size"), pytest.param(half_size, ODD, 5e-3, id="odd")],
)
def test_what_one_noisy_image_leaves_of_a_lens(
    twin_of: Callable[..., VirtualRig], lens: dict[str, Any], target: float
) -> None:
    twin = twin_of(lens)
    found = measure_distortion(image_of(twin), pitch=PITCH_MM * 1e-3)
    left, raw = left_by(found.distortion, twin)[0], left_by(untouched(twin), twin)[0]
    assert left < target
    assert found.magnitude == pytest.approx(raw, rel=0.05)
    assert found.warnings == ()
    assert found.valid_fraction > 0.99


def test_a_lens_without_a_name_on_a_small_image() -> None:
    twin = half_size({**ODD, "k1": -1.0})
    found = measure_distortion(image_of(twin), pitch=PITCH_MM * 1e-3)
    left = left_by(found.distortion, twin)[0]
    brown = found.distortion.brown().residual
    assert left < 5e-3
    assert brown > 10 * left


def test_signs_on_a_lens_that_pushes_one_side() -> None:
    twin = half_size(ONE_SIDED, ideal=True, alignment="aligned")
    found = measure_distortion(image_of(twin), pitch=PITCH_MM * 1e-3)
    left, error = left_by(found.distortion, twin)
    row, column = np.mgrid[:480, :640]
    shift = np.stack(found.distortion.ideal(column, row)) - [column, row]
    true = np.stack(twin.straight_pixels()) - [column, row]
    assert left < 1e-3
    curved = np.array([1, -2, 1])
    found_bend, true_bend = (float(curved @ each[0, 240, [400, 480, 560]]) for each in (shift, true))
    assert true_bend > 0.3, "the shift is most negative at the bump"
    assert found_bend == pytest.approx(true_bend, rel=0.02), "bending along a line is blind to most of a homography"
    assert np.abs(error).max() < 0.01


def test_the_image_s_centre_stays_in_place() -> None:
    twin = half_size(BROWN)
    found = measure_distortion(image_of(twin), pitch=PITCH_MM * 1e-3)
    h = 1e-3
    centre = np.array([319.5, 239.5])
    points = centre + h * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
    ideal = np.stack(found.distortion.ideal(*points.T), axis=1)
    assert np.abs(ideal[0] - centre).max() < 1e-9
    slopes = np.stack([ideal[1] - ideal[2], ideal[3] - ideal[4]]) / (2 * h)
    assert np.abs(slopes - np.eye(2)).max() < 1e-6


@pytest.mark.parametrize("size", ["half", "turned"])
def test_the_plane_gives_scale_and_tilt(size: str) -> None:
    camera = {"tilt_x_degree": 0.8, "tilt_y_degree": -0.5, "pixel_aspect": 1.01}
    turn = 2.0 if size == "half" else -11.0
    twin = half_size({"k1": -0.3}, camera=camera, stage={"grid_turned_degree": turn})
    found = measure_distortion(image_of(twin), pitch=PITCH_MM * 1e-3)
    optics = twin.optics()
    parameters = found.plane.camera(optics["camera_distance"])
    error = {name: parameters[name] - optics[name] for name in parameters}
    assert math.degrees(found.turn) == pytest.approx(turn, abs=0.1)
    assert abs(error["pixel_size"]) < 2e-5 * optics["pixel_size"]
    assert abs(error["pixel_aspect"]) < 2e-5
    assert max(abs(error["camera_tilt_x"]), abs(error["camera_tilt_y"])) < math.radians(0.03)
    # what matters in the end: where the lines of sight meet the plane, up to a motion in the plane
    truth = twin.truth(0.0)
    row, column = np.mgrid[:480, :640]
    x, y = found.plane.on_plane(*found.distortion.ideal(column, row))
    found_points, true_points = (x + 1j * y).ravel(), (truth.x.values + 1j * truth.y.values).ravel()
    found_points, true_points = found_points - found_points.mean(), true_points - true_points.mean()
    motion = np.vdot(found_points, true_points)
    left = np.abs(found_points * motion / abs(motion) - true_points)
    assert np.sqrt(np.mean(left**2)) < 1e-7
    assert abs(np.angle(motion)) < 1e-3, "x is along the image's row"


def test_plane_homography_agrees_with_the_rig_model() -> None:
    """Closed form of the tilts against the rays of RigModel, exactly."""
    optics = half_size({}, camera={"tilt_x_degree": 3.0, "tilt_y_degree": -5.0, "pixel_aspect": 1.1}).optics()
    rig = RigModel(**optics)
    pixels = np.random.default_rng(2).uniform(0, 480, (50, 2))
    rays = np.column_stack([pixels, np.ones(50)]) @ rig.ray_matrix.T
    on_plane = -rig.camera_distance * rays[:, :2] / rays[:, 2:]
    homography = fit_homography(pixels, on_plane)
    x, y, w = homography @ [319.5, 239.5, 1.0]
    homography = np.array([[1, 0, -x / w], [0, 1, -y / w], [0, 0, 1]]) @ homography / w
    from fringedic.camera.plane_homography import PlaneHomography

    parameters = PlaneHomography(homography, 319.5, 239.5).camera(rig.camera_distance)
    for name, value in parameters.items():
        assert value == pytest.approx(getattr(rig, name), rel=1e-6), name


def test_noise_of_the_field_is_foretold() -> None:
    twin = half_size({})
    sigma, errors = [], []
    for frame in range(4):
        found = measure_distortion(image_of(twin, frame), pitch=PITCH_MM * 1e-3, order=5)
        sigma.append(found.sigma)
        row, column = np.mgrid[0:480:8, 0:640:8]
        errors.append(np.stack(found.distortion.ideal(column, row)))
    # the gauge at the centre is noisy too: compare after the best homography, as the distortion is stated
    mean = np.mean(errors, axis=0).reshape(2, -1).T
    spread = []
    for each in errors:
        points = each.reshape(2, -1).T
        spread.append(np.sum((apply_homography(fit_homography(points, mean), points) - mean) ** 2, axis=1).mean())
    scatter = float(np.sqrt(np.sum(spread) / 3 / np.mean(np.square(sigma))))
    assert 0.5 < scatter < 1.1


def test_a_pitch_in_step_with_the_pixels_is_named() -> None:
    aligned = {"alignment": "aligned", "ideal": True}
    image = image_of(half_size({}, stage={"grid_turned_degree": 0.0, "grid_pitch_mm": 0.2}, **aligned))
    with pytest.raises(GridError, match=r"turned by 0.0 degree: turn the grid so that it is 2 degrees"):
        measure_distortion(image, pitch=2e-4)
    weak = image_of(half_size({}, stage={"grid_turned_degree": 0.0, "grid_pitch_mm": 0.4}, **aligned))
    found = measure_distortion(weak, pitch=4e-4)
    assert codes(found) == [GridFinding.IN_STEP]
    turned = image_of(half_size({}, stage={"grid_turned_degree": 2.0, "grid_pitch_mm": 0.4}, **aligned))
    assert measure_distortion(turned, pitch=4e-4).warnings == ()


def codes(found: GridMeasurement) -> list[StrEnum]:
    return [each.code for each in found.warnings]


def small_image(turn: float, period: float) -> tuple[VirtualRig, np.ndarray]:
    """The field of the usual rig on 320 x 240 px; the mean of four frames, blurred by lens and pixels."""
    camera = {"columns": 320, "rows": 240, "pixel_size_um": 200.0}
    stage = {"grid_pitch_mm": 0.2 * period, "grid_blur_um": 86.0, "grid_turned_degree": turn}
    twin = twin_with(BROWN, camera=camera, stage=stage)
    return twin, np.mean([image_of(twin, frame) for frame in range(4)], axis=0)


def test_few_lines_have_to_be_turned_more() -> None:
    """Aliases are slower in a small image: what is warned of is worse, and the advice is good."""
    twin, little = small_image(2.0, 8.0)
    warned = measure_distortion(little, pitch=1.6e-3)
    assert len(warned.warnings) == 1
    words = finding_sentence(warned.warnings[0])
    assert "columns and rows" in words
    assert "turn the grid so that it is 3.5 degrees" in words
    turned, enough = small_image(3.5, 8.0)
    found = measure_distortion(enough, pitch=1.6e-3)
    left, before = left_by(found.distortion, turned)[0], left_by(warned.distortion, twin)[0]
    assert found.warnings == ()
    assert left < 1e-3
    assert before > 1.5 * left
    with pytest.raises(GridError, match=r"3.5 degrees"):
        measure_distortion(small_image(2.0, 6.0)[1], pitch=1.2e-3)


def test_crossings_in_step_with_the_pixels_are_warned_of() -> None:
    """tan 6 degree is about a tenth, and so is the frequency of the lines."""
    found = measure_distortion(small_image(6.0, 10.0)[1], pitch=2e-3)
    assert GridFinding.IN_STEP in codes(found)


def test_a_lens_without_errors_gets_no_order_by_chance() -> None:
    twin = half_size({}, camera={"columns": 400, "rows": 300}, stage={"grid_pitch_mm": 0.5})
    orders = [measure_distortion(image_of(twin, frame), pitch=5e-4).order for frame in range(8)]
    assert orders.count(1) >= 6, f"orders {orders}"


def test_images_without_a_grid_are_refused() -> None:
    random = np.random.default_rng(1)
    plain = half_size({}).with_specimen({"kind": "reference_plane"})
    speckle = VirtualRig(VirtualRigConfiguration.from_dict({"preset": "plate", "size": "small"}))
    for image in (
        image_of(plain),
        image_of(speckle),
        random.integers(0, 255, (480, 640)).astype(np.uint8),
        np.zeros((480, 640), np.uint8),
    ):
        with pytest.raises(GridError, match="no grid"):
            measure_distortion(image, pitch=4e-4)


def waves(period: float, other: float | None = None) -> np.ndarray:
    row, column = np.mgrid[:480, :640]
    turned = math.radians(2.0)
    a = math.cos(turned) * column - math.sin(turned) * row
    b = math.cos(turned) * row + math.sin(turned) * column
    image = 120 + 40 * np.cos(2 * np.pi * a / period)
    if other is not None:
        image += 40 * np.cos(2 * np.pi * b / other)
    return image + np.random.default_rng(1).normal(0, 1, image.shape)


def test_unusable_periods_and_directions_are_named() -> None:
    with pytest.raises(GridError, match="one direction"):
        measure_distortion(waves(9.0), pitch=4e-4)
    with pytest.raises(GridError, match="too coarse"):
        measure_distortion(waves(70.0, 70.0), pitch=4e-4)
    with pytest.raises(GridError, match="too fine"):
        measure_distortion(waves(3.1, 3.1), pitch=4e-4)
    assert measure_distortion(waves(9.0, 9.1), pitch=4e-4).period == pytest.approx(9.05, abs=0.01)


def test_a_wrong_pitch_contradicts_a_known_scale() -> None:
    found = measure_distortion(good_image(), pitch=4e-4, pixel_size=5e-5)
    assert found.plane.pixel_size == pytest.approx(5e-5, rel=1e-3)
    with pytest.raises(GridError, match=r"250.0 µm on the plane and not about 50.0 µm"):
        measure_distortion(good_image(), pitch=2e-3, pixel_size=5e-5)


def test_covered_parts_are_named() -> None:
    covered = good_image().copy()
    covered[:150, 450:] = 30
    with pytest.raises(GridError, match="upper right"):
        measure_distortion(covered, pitch=4e-4)
    spot = good_image().copy()
    row, column = np.mgrid[:480, :640]
    spot[np.hypot(row - 240, column - 150) < 40] = 200
    found = measure_distortion(spot, pitch=4e-4)
    left = left_by(found.distortion, half_size({}))[0]
    assert left < 1e-3
    assert any("left" in finding_sentence(warning) for warning in found.warnings)
    masked = measure_distortion(spot, pitch=4e-4, mask=np.hypot(row - 240, column - 150) > 45)
    assert left_by(masked.distortion, half_size({}))[0] < 1e-3
    with pytest.raises(GridError, match="no pixel"):
        measure_distortion(spot, pitch=4e-4, mask=np.zeros((480, 640), bool))


def test_bad_exposures_are_named() -> None:
    white = np.clip(good_image().astype(float) * 2.5, 0, 255).astype(np.uint8)
    for given in (white, white.astype(float)):
        with pytest.raises(GridError, match="saturated"):
            measure_distortion(given, pitch=4e-4)
    blurred = gaussian_filter(good_image().astype(float), 4.5) + np.random.default_rng(1).normal(0, 0.1, (480, 640))
    with pytest.raises(GridError, match="focus"):
        measure_distortion(blurred, pitch=4e-4)
    noisy = good_image() + np.random.default_rng(1).normal(0, 60, (480, 640))
    with pytest.raises(GridError, match="scatter"):
        measure_distortion(noisy, pitch=4e-4)


def test_wrong_arguments_are_named() -> None:
    with pytest.raises(ImageError, match="64 px"):
        measure_distortion(np.zeros((20, 300)), pitch=4e-4)
    with pytest.raises(GridError, match="pitch"):
        measure_distortion(good_image(), pitch=0.0)
    with pytest.raises(GridError, match="order"):
        measure_distortion(good_image(), pitch=4e-4, order=0)
    with pytest.raises(ImageError, match="mask"):
        measure_distortion(good_image(), pitch=4e-4, mask=np.ones((3, 3), bool))


def test_result_names_its_parts() -> None:
    found = measure_distortion(good_image(), pitch=4e-4)
    assert isinstance(found, GridMeasurement)
    assert len(found.orders) == len(found.cross_validation)
    assert found.columns.shape == found.residual_columns.shape
    assert found.columns.min() < 8, "points reach the image's edges"
    assert found.columns.max() > 631
