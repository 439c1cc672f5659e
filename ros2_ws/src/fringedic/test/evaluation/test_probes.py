"""Probes on a result whose values are known: a plate that is stretched, turned and shifted over three steps."""

import json

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation

from fringedic.errors import DatasetError, ImageError
from fringedic.evaluation.elasticity import strain_curve
from fringedic.evaluation.force import force_curve
from fringedic.evaluation.probes import extensometer, points_in, profile, region_statistics
from fringedic.evaluation.rigid_motion import remove_rigid_motion
from fringedic.frames.region import Region

ROWS, COLUMNS = np.arange(0, 96, 4), np.arange(0, 160, 4)
STRETCH = (0.0, 0.01, 0.02)
TURN = Rotation.from_rotvec([0.02, -0.05, 0.1])
SHIFT = np.array([1e-3, -2e-3, 3e-3])
SIGMA = 1e-6


def plate(noise: float = 0.0) -> xr.Dataset:
    """Stretched along x by 0, 1 and 2 %; turned and shifted from step to step."""
    column, row = np.meshgrid(COLUMNS, ROWS)
    x, y = 1e-4 * (column - 80.0), -1e-4 * (row - 40.0)
    reference = np.stack([x, y, 0.1 * x])
    rng = np.random.default_rng(2)
    moved = []
    for step, stretch in enumerate(STRETCH):
        deformed = reference.copy()
        deformed[0] *= 1 + stretch
        deformed[2] *= 1 + stretch
        turn = Rotation.from_rotvec(step * TURN.as_rotvec()).as_matrix()
        after = np.tensordot(turn, deformed, 1) + step * SHIFT[:, None, None]
        moved.append(after - reference + noise * rng.normal(size=reference.shape))
    stack = np.array(moved, np.float32)
    maps = {name: np.repeat(each[None], 3, axis=0) for name, each in zip("xyz", reference, strict=True)}
    maps |= {name: stack[:, k] for k, name in enumerate("uvw")}
    maps |= {f"sigma_{name}": np.full_like(stack[:, 0], SIGMA) for name in "uvw"}
    return xr.Dataset(
        {name: (("step", "row", "column"), each, {"units": "m"}) for name, each in maps.items()}
        | {"force": ("step", np.array([5.0, 25.0, 45.0]), {"units": "N"})},
        {"step": [0, 1, 2], "row": ROWS, "column": COLUMNS},
        {"facts": json.dumps({"specimen": {"section_mm2": 10.0}})},
    )


def test_extensometer_measures_the_stretch_whatever_the_motion() -> None:
    result = extensometer(plate(), (20, 40), (140, 40))
    length = 120e-4 * np.hypot(1, 0.1)
    assert np.allclose(result.strain, STRETCH, atol=2e-6), result.strain.values
    assert np.allclose(result.length, length * (1 + np.array(STRETCH)), atol=2e-8)
    assert np.allclose(result.elongation, length * np.array(STRETCH), atol=2e-8)
    assert np.allclose(result.sigma_elongation, np.sqrt(2) * SIGMA, rtol=1e-3)
    assert np.allclose(result.sigma_strain * length, result.sigma_elongation)


def test_gauge_subsets_average_and_ignore_what_is_missing() -> None:
    noisy = plate(2e-6)
    points, subsets = (extensometer(noisy, (20, 40), (140, 40), subset=side) for side in (1, 21))
    assert np.abs(subsets.strain - STRETCH).max() < 0.5 * np.abs(points.strain - STRETCH).max()
    noisy["u"][:, 10, 5] = np.nan
    assert bool(extensometer(noisy, (20, 40), (140, 40), subset=21).strain.notnull().all())
    noisy["w"][1, 5:15, 2:9] = np.nan
    assert extensometer(noisy, (20, 40), (140, 40), subset=21).strain.isnull().values.tolist() == [False, True, False]


def test_one_step_alone() -> None:
    cloud = plate().isel(step=2).drop_vars("step")
    assert float(extensometer(cloud, (20, 40), (140, 40)).strain) == pytest.approx(0.02, abs=2e-6)
    assert profile(cloud, ["u"], (0, 0), (80, 0)).u.dims == ("position",)
    assert region_statistics(cloud, ["u"], Region.rectangle((0, 0), (20, 20))).u.dims == ("statistic",)
    assert remove_rigid_motion(cloud).rotation.shape == (3,)


def test_profile_follows_a_line() -> None:
    dataset = plate()
    line = profile(dataset, ["x", "u"], (6, 10), (126, 70), points=61)
    assert line.u.dims == ("step", "position")
    assert line.u.units == "m"
    assert list(line) == ["x", "u", "sigma_u"]
    np.testing.assert_allclose(line.sigma_u, SIGMA, rtol=1e-6)
    assert float(line.position[-1]) == pytest.approx(np.hypot(60, 120))
    assert np.allclose(line.x[0], 1e-4 * (line.column - 80), atol=1e-9)
    dataset["u"][1, 10, 16] = np.nan
    holed = profile(dataset, ["u"], (0, 40), (156, 40))
    assert np.isnan(holed.u[1].values[61:67]).all()
    assert np.isfinite(holed.u[1].values[70:]).all()
    with pytest.raises(DatasetError, match="has no length; give two different points"):
        profile(dataset, ["u"], (3, 2), (3, 2))
    with pytest.raises(DatasetError, match="leaves the result"):
        profile(dataset, ["u"], (0, 0), (400, 0))
    with pytest.raises(DatasetError, match="no map e_11"):
        profile(dataset, ["e_11"], (0, 0), (40, 0))


def test_statistics_of_a_region() -> None:
    dataset = plate()
    dataset["u"][:, :2, :] = np.nan
    corners = [(0, 0), (80, 0), (0, 80)]
    triangle = Region.polygon(corners)
    inside = points_in(triangle, dataset)
    assert inside[0, 0]
    assert inside[0, 20]
    assert inside[20, 0]
    assert not inside[20, 2]
    assert inside.sum() == 231
    assert (points_in(Region.polygon(corners[::-1]), dataset) == inside).all()
    table = region_statistics(dataset, ["u", "w"], triangle)
    values = dataset.u.values[2][inside]
    assert float(table.u.sel(step=2, statistic="mean")) == pytest.approx(np.nanmean(values), rel=1e-6)
    assert float(table.u.sel(step=2, statistic="standard_deviation")) == pytest.approx(
        np.nanstd(values, ddof=1), rel=1e-5
    )
    assert float(table.u.sel(step=2, statistic="maximum")) == np.nanmax(values)
    assert float(table.u.sel(step=2, statistic="median")) == pytest.approx(np.nanmedian(values))
    assert float(table.measured_fraction.sel(step=0, map="u")) == pytest.approx(190 / 231)
    assert float(table.measured_fraction.sel(step=0, map="w")) == 1.0
    dataset["u"][1] = np.nan
    assert bool(region_statistics(dataset, ["u"], triangle).u.sel(step=1).isnull().all())
    with pytest.raises(DatasetError, match="no point"):
        points_in(Region.rectangle((1, 1), (2, 2)), dataset)


@pytest.mark.parametrize(
    "attributes",
    [
        {"image_width": np.int64(160), "image_height": np.int64(96)},
        {"calibration": json.dumps({"camera_width": 160, "camera_height": 96})},
    ],
)
def test_a_region_of_another_image_size_is_refused(attributes: dict[str, object]) -> None:
    polygons = Region.rectangle((0, 0), (80, 80)).polygons
    right, wrong = Region(polygons, 160, 96), Region(polygons, 640, 480)
    sizeless = plate()
    assert points_in(wrong, sizeless).any(), "the size of the images is not known"
    dataset = sizeless.assign_attrs(attributes)
    assert points_in(right, dataset).any()
    assert points_in(Region(polygons), dataset).any()
    strains = dict.fromkeys(("e_11", "e_22", "sigma_e_11", "sigma_e_22"), dataset.u)
    for refused in (
        lambda: region_statistics(dataset, ["u"], wrong),
        lambda: remove_rigid_motion(dataset, wrong),
        lambda: strain_curve(dataset.assign(strains), wrong),
    ):
        with pytest.raises(ImageError, match="drawn in an image of 640x480 px, this one has 160x96 px"):
            refused()


def test_positions_are_column_and_row() -> None:
    dataset = plate()
    inside = points_in(Region.rectangle((100, 8), (120, 12)), dataset)
    rows, columns = np.nonzero(inside)
    assert set(ROWS[rows]) == {8, 12}
    assert set(COLUMNS[columns]) == {100, 104, 108, 112, 116, 120}
    line = profile(dataset, ["x"], (100, 8), (140, 8))
    assert set(line.row.values) == {8.0}
    assert line.column.values[[0, -1]].tolist() == [100.0, 140.0]


def test_rigid_motion_is_removed_and_told() -> None:
    dataset = plate()
    still = remove_rigid_motion(dataset)
    for step, stretch in enumerate(STRETCH):
        found = still.sel(step=step)
        expected = stretch * (dataset.x[0] - dataset.x[0].mean())
        wrong = np.abs(found.u - expected).max()
        assert wrong < 5e-9
        assert np.abs(found.v).max() < 5e-9
        assert np.allclose(found.rotation, step * TURN.as_rotvec(), atol=1e-6)
    np.testing.assert_allclose(still[["sigma_u", "sigma_v", "sigma_w"]].to_array(), SIGMA, rtol=1e-6)
    # a quarter turn about z: the error along y before is that along x
    turn = {"u": -dataset.y - dataset.x, "v": dataset.x - dataset.y, "w": 0 * dataset.w}
    quarter = dataset.assign(turn).assign(sigma_v=3 * dataset.sigma_v)
    turned = remove_rigid_motion(quarter)
    np.testing.assert_allclose(turned.u, 0, atol=1e-8)
    np.testing.assert_allclose(turned.sigma_u, 3 * SIGMA, rtol=1e-6)
    np.testing.assert_allclose(turned.sigma_v, SIGMA, rtol=1e-6)
    # the centroid stays where it was in the reference
    assert abs(float(still.u[2].mean())) < 1e-9
    clamped = remove_rigid_motion(dataset, Region.rectangle((0, 0), (40, 92)))
    grip = clamped.u[2].values[:, :11]
    assert np.abs(grip).mean() < 0.2 * np.abs(clamped.u[2].values[:, -11:]).mean()
    dataset["u"][1] = np.nan
    with pytest.raises(DatasetError, match="fewer than three"):
        remove_rigid_motion(dataset)


def test_force_and_stress_against_strain() -> None:
    dataset = plate()
    strain = extensometer(dataset, (20, 40), (140, 40)).strain
    curve = force_curve(dataset, strain, tare=5.0)
    assert curve.force.values.tolist() == [0.0, 20.0, 40.0]
    assert np.allclose(curve.stress, [0.0, 2e6, 4e6]), "recorded section of 10 mm2"
    assert np.allclose(force_curve(dataset, strain, section=5e-6, sign=-1).stress, [-1e6, -5e6, -9e6])
    assert "force_sigma" not in curve, "the sensor states none"
    stated = force_curve(dataset.assign(force_sigma=("step", [0.1, 0.2, 0.3])), strain)
    assert stated.force_sigma.values.tolist() == [0.1, 0.2, 0.3]
    np.testing.assert_allclose(stated.stress_sigma, [1e4, 2e4, 3e4])
    del dataset.attrs["facts"]
    assert "stress" not in force_curve(dataset, strain)
    for wrong, words in (
        ({"sign": 2}, "1 or -1"),
        ({"section": 0.0}, "above 0"),
    ):
        with pytest.raises(DatasetError, match=words):
            force_curve(dataset, strain, **wrong)
    with pytest.raises(DatasetError, match="has 3 steps"):
        force_curve(dataset, [0.0])
    with pytest.raises(DatasetError, match=r"the dataset has no force \[N\] .force., only none; record a load frame"):
        force_curve(dataset.drop_vars("force"), strain)


def test_places_outside_are_named() -> None:
    dataset = plate()
    with pytest.raises(DatasetError, match="outside the result"):
        extensometer(dataset, (20, 40), (400, 40))
    with pytest.raises(DatasetError, match="move them apart"):
        extensometer(dataset, (20, 40), (21, 40))
    with pytest.raises(DatasetError, match="above 0"):
        extensometer(dataset, (20, 40), (80, 40), subset=0)
