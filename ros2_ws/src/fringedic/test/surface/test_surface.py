"""Coupling on exact cases: perspective, noise, holes, discontinuities; strain of rigid motions, stretch and shear."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from numba import get_num_threads, set_num_threads
from scipy.ndimage import gaussian_filter
from surface_case import (
    COLUMN,
    PITCH,
    RIG,
    ROW,
    Case,
    Field,
    at_rest,
    cloud_of,
    flat,
    relief,
    seen_point,
)

from fringedic.errors import CalibrationError, ImageError, SurfaceError
from fringedic.patterns.sequences import fringe_sequence
from fringedic.phase import absolute_phase
from fringedic.rig.model import RigModel
from fringedic.surface import couple, surface_strain, to_local_frame
from fringedic.virtual_rig import VirtualRig


@pytest.fixture(scope="module")
def case() -> Case:
    return Case()


def rms(values: xr.DataArray | np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(np.asarray(values, float) ** 2)))


def test_exact_input_gives_the_exact_displacement(case: Case) -> None:
    measured = couple(*case.measured(0, 0))
    assert float(measured.w.notnull().mean()) > 0.93
    for name in ("u", "v", "w", "x", "y", "z"):
        error = 1e9 * rms(measured[name] - getattr(case, name))
        assert error < 5, f"{name}: {error:.2f} nm RMS"
    assert float(measured.v.mean()) < 0 < case.displacement_y.mean(), "downwards in the image is -v"
    naive = 50e-6 / 1.01 * case.displacement_x - case.u
    assert rms(naive) > 3e-6


@pytest.mark.parametrize(("z_filter", "targets"), [(0.0, (0.40, 0.31, 9.5)), (2.0, (0.15, 0.15, 1.4))])
def test_noise_of_the_displacement(case: Case, z_filter: float, targets: tuple[float, float, float]) -> None:
    measured = couple(*case.measured(0.002, 0.0026), z_filter=z_filter)
    inner = measured[{"row": slice(12, -12), "column": slice(12, -12)}]
    truth = {name: getattr(case, name)[12:-12, 12:-12] for name in "uvw"}
    for name, target in zip("uvw", targets, strict=True):
        error = inner[name] - truth[name]
        score = rms(error / inner[f"sigma_{name}"])
        assert 1e6 * rms(error) < target, name
        assert 0.97 < score < 1.03, name


@pytest.mark.parametrize("specimen", ["rigid", "leather"])
def test_rendered_frames_of_the_digital_twin(specimen: str) -> None:
    """From rendered fringes to u, v, w, with the twin's own displacement in the image."""
    twin = VirtualRig.from_preset(specimen, size="small")
    position = 0.2 * twin.maximum_position
    rig = RigModel(**twin.optics())
    sequence = fringe_sequence(rig.projector_width, rig.projector_height, [rig.projector_width, 40, 10], [4, 4, 8])
    shapes = []
    for step, crosshead in enumerate((0.0, position)):
        frames = np.array([twin.expose(image, crosshead, 100 * step + k) for k, image in enumerate(sequence)])
        measured = absolute_phase(frames, list(sequence.patterns))
        shapes.append(rig.reconstruct(measured.phase, 10.0, measured.sigma))
    truth = twin.truth(position)
    displacement = truth[["displacement_x", "displacement_y"]].assign(
        sigma_x=0 * truth.displacement_x, sigma_y=0 * truth.displacement_y
    )
    for z_filter in (0.0, 2.0):
        cloud = couple(*shapes, displacement, z_filter=z_filter)
        error = {name: cloud[name] - truth[name] for name in "uvw"}
        scores = {name: float((error[name] / cloud[f"sigma_{name}"]).std()) for name in "uvw"}
        assert float(cloud.w.notnull().sum()) > 0.95 * float((truth.valid & truth.lit).sum())
        assert all(0.9 < score < 1.1 for score in scores.values())
        assert abs(float(error["w"].median())) < 0.1 * rms(error["w"])


def test_noise_that_comes_from_the_displacement() -> None:
    """On a slope an error of the displacement becomes one of w: the gradient terms of sigma."""
    steep = Case(lambda x, y: 0.5 * x - 0.3 * y, lambda x, *_: (x * 0 + 1.3e-4, x * 0, x * 0))
    measured = couple(*steep.measured(1e-6, 0.05))
    for name in "uvw":
        score = rms((measured[name] - getattr(steep, name)) / measured[f"sigma_{name}"])
        assert 0.97 < score < 1.03, name


def test_the_reference_against_itself_is_zero_wherever_it_is_measured(case: Case) -> None:
    shape, _, displacement = case.measured(0.0021, 0)
    shape["z"][40:50, 60:80] = np.nan
    still = displacement * 0
    for z_filter in (0.0, 2.0):
        measured = couple(shape, shape, still, z_filter=z_filter)
        assert np.array_equal(measured.u.isnull(), shape.z.isnull())
        for name in "uvw":
            assert not measured[name].where(measured[name].notnull(), 0).any()


def test_holes_do_not_spread(case: Case) -> None:
    shape, after, displacement = case.measured(0, 0)
    after["z"][80:90, 100:120] = np.nan
    whole = couple(*case.measured(0, 0))
    measured = couple(shape, after, displacement)
    lost = measured.w.isnull() & whole.w.notnull()
    target_row, target_column = ROW + case.displacement_y, COLUMN + case.displacement_x
    touches = (target_row > 78) & (target_row < 92) & (target_column > 98) & (target_column < 122)
    assert not (lost.values & ~touches).any()
    inside = (target_row > 79) & (target_row < 90) & (target_column > 99) & (target_column < 120)
    assert lost.values[inside].all()
    kept = ~measured.w.isnull()
    assert np.array_equal(measured.w.values[kept], whole.w.values[kept])


@pytest.mark.parametrize("z_filter", [0.0, 2.0])
def test_nothing_leaks_over_a_step_of_the_surface(z_filter: float) -> None:
    """A step of 2 mm that moves with the material: every measured point is as good as one far from the step."""

    def terrace(_: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.where(COLUMN < 120, 0.0, 2e-3) + 0.3 * y

    still = Case(lambda _, y: 0.3 * y, at_rest)
    x, y, z = seen_point(terrace, COLUMN, ROW)
    rng = np.random.default_rng(4)
    sigma = np.full(z.shape, 2 * np.pi * 0.0021, np.float32)
    phase = RIG.phase(x, y, z, PITCH)
    shapes = [
        RIG.reconstruct((phase + sigma * rng.normal(size=z.shape)).astype(np.float32), PITCH, sigma) for _ in range(2)
    ]
    displacement = still.measured(0, 0)[2]
    displacement["displacement_x"][:] = 0.0
    displacement["displacement_y"][:] = 0.4
    measured = couple(*shapes, displacement, z_filter=z_filter)
    moved = seen_point(terrace, COLUMN, ROW + 0.4)[2] - z
    error = np.abs((measured.w - moved) / measured.sigma_w).values
    near = error[:, 110:130]
    assert np.nanmax(near) < 5.5
    assert np.isnan(measured.w.values[12:-12, 119:121]).all()
    assert np.isfinite(measured.w.values[12:-12, 124:236]).mean() > 0.999


def test_filter_keeps_slopes_beside_holes() -> None:
    """A filter that is narrowed symmetrically has no bias on a slope, however close the hole."""
    inclined = Case(lambda x, y: 0.4 * x + 0.2 * y, at_rest)
    shape, _, displacement = inclined.measured(0, 0)
    shape["z"][60:100, 90:140] = np.nan
    shape["z"][20, 30] = np.nan
    measured = couple(shape, shape, displacement, z_filter=2.0)
    error = 1e6 * float(np.abs(measured.z - inclined.z).max())
    assert error < 0.05
    assert np.array_equal(measured.z.isnull(), shape.z.isnull())


def test_filter_trusts_the_less_noisy_pixels() -> None:
    """Dark speckles, five times as noisy: less noise than after the Gaussian alone, and no bias."""
    inclined = Case(lambda x, y: 0.4 * x + 0.2 * y, at_rest)
    shape, _, displacement = inclined.measured(0, 0)
    rng = np.random.default_rng(8)
    sigma = np.where(rng.random(shape.z.shape) < 0.4, 25e-6, 5e-6)
    error = rng.normal(size=sigma.shape) * sigma
    shape["z"][:] = inclined.z + error
    shape["noise_z"][:] = sigma
    inner = np.s_[20:-20, 20:-20]
    remaining = (couple(shape, shape, displacement, z_filter=2.0).z - inclined.z).values[inner]
    plain = gaussian_filter(error, 2.0)[inner]
    best = (gaussian_filter(error / sigma**2, 2.0) / gaussian_filter(1 / sigma**2, 2.0))[inner]
    words = f"noise of z {1e6 * rms(remaining):.2f} µm, the Gaussian alone {1e6 * rms(plain):.2f} µm, the best weights "
    words += f"without regard to the slope {1e6 * rms(best):.2f} µm"
    assert rms(remaining) < 0.5 * rms(plain), words
    assert rms(remaining) < 1.15 * rms(best), words
    assert abs(remaining.mean()) < 0.1e-6, words
    after = shape.copy(deep=True)
    after["z"][:] = inclined.z + rng.normal(size=sigma.shape) * sigma
    displacement["displacement_x"][:] = 0.37
    displacement["displacement_y"][:] = -0.21
    measured = couple(shape, after, displacement, z_filter=2.0)
    moved = seen_point(lambda x, y: 0.4 * x + 0.2 * y, COLUMN + 0.37, ROW - 0.21)[2] - inclined.z
    score = rms(((measured.w - moved) / measured.sigma_w).values[inner])
    assert 0.9 < score < 1.1


def test_unknown_noise_leaves_unknown_sigmas(case: Case) -> None:
    shape, after, displacement = case.measured(0.002, 0.0026)
    known = couple(shape, after, displacement, z_filter=2.0)
    for each in (shape, after):
        each["noise_z"][:] = np.nan
    unknown = couple(shape, after, displacement, z_filter=2.0)
    assert bool(unknown.sigma_w.isnull().all())
    assert float(np.abs(unknown.w - known.w).max()) < 1e-6
    assert float(unknown.w.notnull().mean()) > 0.93


def test_points_on_a_coarser_grid_are_the_same_points(case: Case) -> None:
    shape, after, displacement = case.measured(0.0021, 0.0026)
    every = couple(shape, after, displacement)
    rows, columns = np.arange(15, 160, 7), np.arange(16, 200, 7)
    nodes = displacement.sel(row=rows, column=columns)
    xr.testing.assert_equal(couple(shape, after, nodes), every.sel(row=rows, column=columns))


def test_points_between_pixels(case: Case) -> None:
    shape, _, displacement = case.measured(0, 0)
    nodes = (displacement * 0).sel(row=slice(20, 150, 5), column=slice(20, 200, 5))
    nodes = nodes.assign_coords(row=nodes.row + 0.5, column=nodes.column + 0.25)
    measured = couple(shape, shape, nodes)
    x, y, z = seen_point(relief, *np.meshgrid(nodes.column, nodes.row))
    for name, truth in (("x", x), ("y", y), ("z", z)):
        assert rms(measured[name] - truth) < 5e-9
    for name in "uvw":
        assert not measured[name].any()


def test_crops_know_their_place(case: Case) -> None:
    shape, after, displacement = case.measured(0.0021, 0.0026)
    whole = couple(shape, after, displacement)
    window = {"row": slice(20, 150), "column": slice(30, 200)}
    part = couple(shape[window], after[window], displacement[window])
    kept = part.w.notnull()
    assert float(kept.mean()) > 0.9
    for name in ("x", "u", "v", "w", "sigma_w"):
        assert np.array_equal(part[name].values[kept], whole[name][window].values[kept])


def test_calibration_replaces_the_attributes(case: Case) -> None:
    shape, after, displacement = case.measured(0, 0)
    expected = couple(shape, after, displacement)
    bare = after.drop_attrs()
    with pytest.raises(SurfaceError, match="calibration"):
        couple(shape, bare, displacement)
    xr.testing.assert_equal(couple(shape, bare, displacement, calibration=RIG), expected)


def test_shapes_of_another_calibration_are_refused(case: Case) -> None:
    shape, after, displacement = case.measured(0, 0)
    with pytest.raises(CalibrationError, match=r"reference shape and deformed shape.*camera at"):
        couple(shape, after.assign_attrs(camera_distance=1.01 * RIG.camera_distance), displacement)
    named = [each.assign_attrs(calibration_identifier=name) for each, name in ((shape, "May"), (after, "June"))]
    with pytest.raises(CalibrationError, match=r"'May' .* and 'June'"):
        couple(*named, displacement)
    with pytest.raises(CalibrationError, match="given"):
        couple(shape, after, displacement, calibration=replace(RIG, camera_distance=0.9 * RIG.camera_distance))


def test_result_does_not_depend_on_the_number_of_threads(case: Case) -> None:
    inputs = case.measured(0.0021, 0.0026)
    before = get_num_threads()
    results = []
    try:
        for threads in (1, before):
            set_num_threads(threads)
            cloud = couple(*inputs, z_filter=2.0)
            results.append((cloud, to_local_frame(cloud), surface_strain(cloud, window=31)))
    finally:
        set_num_threads(before)
    for one, many in zip(*results, strict=True):
        xr.testing.assert_identical(one, many)


def test_nothing_measured_gives_nothing(case: Case) -> None:
    """No phase at all, or a displacement that leaves the image everywhere: NaN without warnings."""
    shape, after, displacement = case.measured(0.002, 0.0026)
    displacement.attrs.update(window_px=24, method="dense")
    away = displacement.copy(deep=True)
    away["displacement_x"] += 500
    nothing = xr.full_like(shape, np.nan)
    for inputs in ((shape, nothing, displacement), (nothing, after, displacement), (shape, after, away)):
        cloud = couple(*inputs, calibration=RIG, z_filter=2.0)
        assert bool(cloud.w.isnull().all())
        assert bool(cloud.sigma_w.isnull().all())
        strain, local = surface_strain(cloud, window=31), to_local_frame(cloud)
        assert bool(strain.e_11.isnull().all())
        assert bool(strain.sigma_e_11.isnull().all())
        assert bool(local.u_t.isnull().all())


def test_uncertainties_that_are_not_known_are_the_same_bits_with_every_compiler() -> None:
    """The sign of NaN that an operation returns is the compiler's: replays under another Python had other bits."""
    column, row = np.meshgrid(np.arange(40.0), np.arange(30.0))

    def plane(z: float) -> xr.Dataset:
        x, y = 1e-4 * (column - 20) * (1 - z / 0.5), -1e-4 * (row - 15) * (1 - z / 0.5)
        fields = {"x": x, "y": y, "z": z + 0 * x, "noise_z": 1e-6 + 0 * x}
        arrays = {name: (("row", "column"), values) for name, values in fields.items()}
        return xr.Dataset(arrays, attrs={"camera_distance": 0.5})

    unknown = {"displacement_x": 0.0, "displacement_y": 0.0, "sigma_x": np.inf, "sigma_y": np.inf}
    still = xr.Dataset({name: (("row", "column"), value + 0 * column) for name, value in unknown.items()})
    cloud = couple(plane(0.0), plane(1e-3), still)
    unmeasured = np.concatenate([each.values[np.isnan(each.values)] for each in cloud.data_vars.values()])
    assert unmeasured.size
    assert not np.signbit(unmeasured).any()


def test_bad_input_is_refused(case: Case) -> None:
    shape, after, displacement = case.measured(0, 0)
    with pytest.raises(ImageError, match="same pixels"):
        couple(shape, after[{"row": slice(0, 50)}], displacement)
    with pytest.raises(SurfaceError, match="z_filter"):
        couple(shape, after, displacement, z_filter=-1.0)
    with pytest.raises(SurfaceError, match="window of 2 px"):
        surface_strain(couple(shape, after, displacement), window=2)


def rigid(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, ...]:
    """Turn by about 30 degree about a skew axis, then shift."""
    axis = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    turn = np.eye(3) + np.sin(0.5) * cross + (1 - np.cos(0.5)) * cross @ cross
    points = np.stack([x, y, z], axis=-1)
    return tuple(np.moveaxis(points @ turn.T - points + (0.01, -0.02, 0.03), -1, 0))


def tilted(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 0.7 * x - 0.4 * y


def cylinder(x: np.ndarray, _: np.ndarray) -> np.ndarray:
    return np.sqrt(0.02**2 - x**2) - 0.02


@pytest.mark.parametrize("surface", [tilted, cylinder])
def test_rigid_motion_has_no_strain(surface: Field) -> None:
    strain = surface_strain(cloud_of(surface, rigid)[0], window=11)
    for name in ("e_11", "e_22", "e_12", "e_1", "e_2"):
        assert float(np.abs(strain[name]).max()) < 1e-9, name
    assert float(strain.e_11.notnull().mean()) > 0.98


def test_stretch_and_shear_in_the_plane() -> None:
    """A deformation gradient known by its numbers: E = (F^T F - 1)/2, its sign and its tensor shear."""
    gradient = np.array([[0.05, 0.03], [-0.01, -0.02]])
    cloud = cloud_of(
        flat,
        lambda x, y, _: (0.05 * x + 0.03 * y, -0.01 * x - 0.02 * y, 0 * x),
    )[0]
    strain = surface_strain(cloud, window=9)
    deformation = np.eye(2) + gradient
    expected = (deformation.T @ deformation - np.eye(2)) / 2
    assert expected[0, 1] > 0
    assert np.nanmax(np.abs(strain.e_11 - expected[0, 0])) < 1e-12
    assert np.nanmax(np.abs(strain.e_22 - expected[1, 1])) < 1e-12
    assert np.nanmax(np.abs(strain.e_12 - expected[0, 1])) < 1e-12
    values, vectors = np.linalg.eigh(expected)
    assert np.nanmax(np.abs(strain.e_1 - values[1])) < 1e-12
    assert np.nanmax(np.abs(strain.e_2 - values[0])) < 1e-12
    angle = np.arctan(vectors[1, 1] / vectors[0, 1])
    assert np.nanmax(np.abs(strain.direction - angle)) < 1e-9


def test_strain_in_a_tilted_plane_is_that_of_the_plane() -> None:
    """Stretch by 4 % along t1 and 1 % along t2 plus shear, done within a steep plane."""
    slope_x, slope_y = 0.7, -0.4
    t1 = np.array([1, 0, slope_x]) / np.hypot(1, slope_x)
    normal = np.array([-slope_x, -slope_y, 1]) / np.sqrt(1 + slope_x**2 + slope_y**2)
    t2 = np.cross(normal, t1)
    inside = np.array([[0.04, 0.02], [0.0, 0.01]])

    def moves(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, ...]:
        points = np.stack([x, y, z], axis=-1)
        along = np.stack([points @ t1, points @ t2], axis=-1) @ inside.T
        return tuple(np.moveaxis(along[..., :1] * t1 + along[..., 1:] * t2, -1, 0))

    strain = surface_strain(cloud_of(tilted, moves)[0], window=9)
    deformation = np.eye(2) + inside
    expected = (deformation.T @ deformation - np.eye(2)) / 2
    for name, value in (("e_11", expected[0, 0]), ("e_22", expected[1, 1]), ("e_12", expected[0, 1])):
        assert np.nanmax(np.abs(strain[name] - value)) < 1e-12


def test_growing_cylinder() -> None:
    """All lengths of a cylinder around y grow by 2 %, its height by 1 %: E_11 = .0202, E_22 = .01005."""
    cloud = cloud_of(cylinder, lambda x, y, z: (0.02 * x, 0.01 * y, 0.02 * (z + 0.02)))[0]
    strain = surface_strain(cloud, window=9)
    assert np.nanmax(np.abs(strain.e_11 - 0.0202)) < 1e-6
    assert np.nanmax(np.abs(strain.e_22 - 0.01005)) < 1e-12
    assert np.nanmax(np.abs(strain.e_12)) < 1e-9


def test_local_frame_on_a_tilted_plane() -> None:
    motion_of_all = np.array([3e-4, -2e-4, 5e-4])
    cloud = cloud_of(tilted, lambda x, *_: tuple(value + 0 * x for value in motion_of_all))[0]
    local = to_local_frame(cloud)
    t1 = np.array([1, 0, 0.7]) / np.hypot(1, 0.7)
    normal = np.array([-0.7, 0.4, 1]) / np.sqrt(1 + 0.7**2 + 0.4**2)
    for name, direction in (("u_t", t1), ("v_t", np.cross(normal, t1)), ("w_n", normal)):
        assert np.nanmax(np.abs(local[name] - motion_of_all @ direction)) < 1e-15
    assert np.nanmax(np.abs(local.dz_dx - 0.7)) < 1e-12
    assert np.nanmax(np.abs(local.dz_dy + 0.4)) < 1e-12
    assert local.attrs["window_px"] == 21


def test_strain_ignores_what_is_not_measured() -> None:
    cloud = cloud_of(tilted, rigid)[0]
    cloud["w"][20:23, 30:34] = np.nan
    cloud["u"][40, 50] = np.nan
    strain = surface_strain(cloud, window=11)
    assert np.isnan(strain.e_11.values[20:23, 30:34]).all()
    assert np.isnan(strain.e_11.values[40, 50])
    assert float(strain.e_11.notnull().mean()) > 0.98
    assert np.nanmax(np.abs(strain.e_11)) < 1e-9
    cloud["u"][:, 40:] = np.nan
    assert np.isnan(surface_strain(cloud, window=11).e_11.values[:, 40:]).all()


def test_window_counts_pixels_not_points() -> None:
    cloud, _, _ = cloud_of(flat, lambda x, *_: (x**3 * 1e4, 0 * x, 0 * x), 90, 90)
    fine = surface_strain(cloud, window=25)
    coarse = surface_strain(cloud.isel(row=slice(0, None, 3), column=slice(0, None, 3)), window=25)
    difference = (fine.e_11 - coarse.e_11).values[8:-8, 8:-8]
    assert np.nanmax(np.abs(difference)) < 0.1 * float(fine.e_11.max() - fine.e_11.min())
    with pytest.raises(SurfaceError, match="spacing of 3 px"):
        surface_strain(cloud.isel(row=slice(0, None, 3), column=slice(0, None, 3)), window=3)


def test_noise_of_the_strain(case: Case) -> None:
    """Over 85 px, what the noise of phase and displacement adds to the strain of the exact fields."""
    exact = surface_strain(couple(*case.measured(0, 0), z_filter=2.0), window=85)
    noisy = surface_strain(couple(*case.measured(0.002, 0.0026), z_filter=2.0), window=85)
    inner = {"row": slice(45, -55), "column": slice(45, -55)}
    for name, target in (("e_11", 42), ("e_22", 21), ("e_12", 28)):
        error = 1e6 * rms((noisy[name] - exact[name])[inner])
        assert error < target, name
