"""Standard deviations of strain, slopes and local components against Monte-Carlo; measures that follow from strain."""

import dataclasses

import numpy as np
import pytest
import xarray as xr
from surface_case import COLUMN, HEIGHT, PITCH, RIG, ROW, WIDTH, Case, cloud_of, flat, pixel_of, seen_point

from fringedic.camera.distortion import DistortionMap
from fringedic.correlation.transfer import error_correlation
from fringedic.errors import SurfaceError
from fringedic.rig.geometry import parameter_values, with_parameters
from fringedic.surface import couple, surface_strain, to_local_frame

WINDOW = 24
STRAIN_WINDOW = 41
SEEDS = range(100, 104)
INNER = {"row": slice(26, -34), "column": slice(26, -34)}
FRINGE, PIXEL = 0.002, 0.003


def correlated(rng: np.random.Generator) -> np.ndarray:
    """Noise of unit variance that agrees over the displacement's window, by its spectrum."""
    size = 512
    lags = error_correlation(WINDOW, "dense", size // 2)
    around = np.abs(np.fft.fftfreq(size, 1 / size)).astype(int)
    spectrum = np.maximum(np.fft.fft2(lags[np.ix_(around, around)]).real, 0)
    field = np.fft.ifft2(np.fft.fft2(rng.normal(size=(size, size))) * np.sqrt(spectrum)).real
    return field[:HEIGHT, :WIDTH]


def deformation(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    u = 0.15e-3 + 0.03 * x + 0.02 * z - 0.01 * y
    return u, -0.21e-3 + 0.01 * x - 0.02 * y, 0.12e-3 + 0.05 * x - 0.02 * y


def slope(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 1e-3 * np.cos(2 * np.pi * x / 0.03 + 1) * np.cos(2 * np.pi * y / 0.04) + 0.25 * x - 0.15 * y


@pytest.fixture(scope="module")
def case() -> Case:
    return Case(slope, deformation)


def noisy(case: Case, seed: int, z_filter: float, fringe: float, pixel: float) -> xr.Dataset:
    rng = np.random.default_rng(seed)
    before, after, displacement = case.measured(fringe, 0.0, seed)
    for axis in "xy":
        displacement[f"displacement_{axis}"] += (pixel * correlated(rng)).astype(np.float32)
        displacement[f"sigma_{axis}"][:] = pixel
    displacement.attrs.update(window_px=WINDOW, method="dense")
    return couple(before, after, displacement, z_filter=z_filter)


@pytest.mark.parametrize(
    ("z_filter", "fringe", "pixel"), [(2.0, FRINGE, PIXEL), (0.0, FRINGE, 1e-6), (2.0, 1e-6, PIXEL)]
)
def test_z_scores_of_the_strain(case: Case, z_filter: float, fringe: float, pixel: float) -> None:
    """Each source alone and both together, on a slope that stretches, shears and turns."""
    exact = surface_strain(couple(*case.measured(0, 0), z_filter=z_filter), window=STRAIN_WINDOW)
    scores: dict[str, list[float]] = {"e_11": [], "e_22": [], "e_12": []}
    for seed in SEEDS:
        found = surface_strain(noisy(case, seed, z_filter, fringe, pixel), window=STRAIN_WINDOW)
        for name, squares in scores.items():
            score = ((found[name] - exact[name]) / found[f"sigma_{name}"])[INNER]
            squares.append(float((score**2).mean()))
    for name, squares in scores.items():
        assert 0.9 < np.sqrt(np.mean(squares)) < 1.1, name


def test_the_slope_noise_of_the_texture_enters_the_sigma_of_the_strain(case: Case) -> None:
    cloud = noisy(case, 1, 2.0, 1e-6, PIXEL)  # the noise of the height is negligible
    plain, more = (surface_strain(cloud, window=STRAIN_WINDOW, slope_noise=each) for each in (1.0, 1.44))
    for name in ("sigma_e_11", "sigma_e_22", "sigma_e_12"):
        np.testing.assert_allclose(more[name][INNER], 1.2 * plain[name][INNER], rtol=1e-3)


def test_spacing_of_the_points_hardly_changes_the_strain_and_its_sigma(case: Case) -> None:
    cloud = noisy(case, 1, 2.0, FRINGE, PIXEL)
    every = surface_strain(cloud, window=STRAIN_WINDOW)
    coarse = surface_strain(cloud.isel(row=slice(2, None, 4), column=slice(2, None, 4)), window=STRAIN_WINDOW)
    for name in ("sigma_e_11", "sigma_e_22", "sigma_e_12"):
        same = every[name].sel(row=coarse.row, column=coarse.column)
        ratio = float((coarse[name] / same)[5:-6, 5:-6].mean())
        assert 0.85 < ratio < 1.1, "its 11 points stand for 44 px, not 41"
    assert every.attrs["virtual_strain_gauge_px"] == 40 + WINDOW
    assert every.attrs["virtual_strain_gauge_mm"] == pytest.approx((40 + WINDOW) * 0.0495, rel=0.03)


def test_correlation_of_errors_increases_the_sigma(case: Case) -> None:
    """With the correlation of a narrow window the sigma would be several times too small."""
    cloud = noisy(case, 1, 2.0, 1e-6, PIXEL)
    honest = surface_strain(cloud, window=STRAIN_WINDOW).sigma_e_11[INNER].mean()
    independent = surface_strain(cloud.assign_attrs(displacement_window_px=8), window=STRAIN_WINDOW)
    assert float(honest / independent.sigma_e_11[INNER].mean()) > 2


def test_unknown_errors_give_no_sigma(case: Case) -> None:
    cloud = couple(*case.measured(FRINGE, PIXEL))
    assert "sigma_e_11" not in surface_strain(cloud, window=STRAIN_WINDOW), "the window is not known"
    bare = cloud[["x", "y", "z", "u", "v", "w"]]
    assert "sigma_e_11" not in surface_strain(bare, window=STRAIN_WINDOW)
    assert "sigma_u_t" not in to_local_frame(bare)


def test_noise_of_the_local_frame(case: Case) -> None:
    """Noise after the low-pass filter of the slopes: z-scores, and less noise in a wider window."""
    gains = []
    for window in (9, 21):
        exact = to_local_frame(couple(*case.measured(0, 0), z_filter=2.0), window=window)
        found = to_local_frame(noisy(case, 3, 2.0, FRINGE, PIXEL), window=window)
        gains.append(found.attrs["slope_noise_gain"])
        for name in ("u_t", "v_t", "w_n", "dz_dx", "dz_dy"):
            score = float((((found[name] - exact[name]) / found[f"sigma_{name}"])[INNER] ** 2).mean()) ** 0.5
            assert 0.9 < score < 1.1, f"window {window} px: {name}"
    assert gains[1] < 0.5 * gains[0] < 0.5


def test_calibration_adds_its_own_error(case: Case) -> None:
    """One uncertain parameter: the effect of its shift by one sigma is the sigma, at every point."""
    names = ("projector_focal_length",)
    sigma = 30.0
    rig = dataclasses.replace(RIG, parameter_names=names, covariance=(sigma**2,))
    values = parameter_values(RIG, names)
    displacement = case.measured(0, 0)[2]

    def measured(model: object, **keywords: object) -> xr.Dataset:
        shapes = [
            model.reconstruct(phase, PITCH, np.zeros(phase.shape))  # type: ignore[attr-defined]
            for phase in (case.phase, case.phase_after)
        ]
        return couple(*shapes, displacement, **keywords)  # type: ignore[arg-type]

    certain, uncertain = measured(RIG), measured(rig, calibration=rig)
    shifted = measured(with_parameters(RIG, names, values + sigma))
    for name in "uvw":
        ratio = np.abs(shifted[name] - certain[name]) / uncertain[f"sigma_{name}"]
        ratio = ratio.where(np.abs(shifted[name] - certain[name]) > 2e-8)
        assert 0.97 < float(ratio.median()) < 1.03, name
    # one cause moves all three components together
    correlation = uncertain.cov_uw / (uncertain.sigma_u * uncertain.sigma_w)
    assert float(np.abs(correlation).median()) > 0.99


def test_lines_of_sight_of_a_distorted_camera() -> None:
    """The displacement follows the true lines of sight, here those of a lens with distortion."""
    bend = np.zeros((4, 4))
    bend[0, 3], bend[2, 1] = 0.8, 0.5
    lens = DistortionMap(WIDTH, HEIGHT, columns=bend, rows=-0.7 * bend.T)
    rig = dataclasses.replace(RIG, camera_distortion=lens)
    # the distorted camera sees at its pixels the points that the ideal one sees at the ideal pixels
    seen_column, seen_row = lens.ideal(COLUMN, ROW)
    inside = (slice(8, -8), slice(8, -8))
    x, y, z = seen_point(slope, seen_column, seen_row)
    u, v, w = deformation(x, y, z)
    there = lens.seen(*pixel_of(x + u, y + v, z + w))
    origin_column, origin_row = COLUMN.copy(), ROW.copy()
    for _ in range(30):
        at = seen_point(slope, *lens.ideal(origin_column, origin_row))
        moved = deformation(*at)
        seen = lens.seen(*pixel_of(*(a + b for a, b in zip(at, moved, strict=True))))
        origin_column += COLUMN - seen[0]
        origin_row += ROW - seen[1]
        if max(np.abs(COLUMN - seen[0]).max(), np.abs(ROW - seen[1]).max()) < 1e-9:
            break
    shapes = [
        rig.reconstruct(rig.phase(*points, PITCH).astype(np.float32), PITCH, np.full(x.shape, 1e-3, np.float32))
        for points in ((x, y, z), tuple(a + b for a, b in zip(at, moved, strict=True)))
    ]
    fields = {"displacement_x": there[0] - COLUMN, "displacement_y": there[1] - ROW}
    fields |= {"sigma_x": np.full(x.shape, 1e-3), "sigma_y": np.full(x.shape, 1e-3)}
    displacement = xr.Dataset(
        {name: (("row", "column"), each.astype(np.float32)) for name, each in fields.items()},
        {"row": np.arange(HEIGHT), "column": np.arange(WIDTH)},
    )
    cloud = couple(*shapes, displacement, calibration=rig)
    for name, truth in (("u", u), ("v", v), ("w", w)):
        wrong = 1e9 * float(np.sqrt(np.nanmean((cloud[name].values - truth)[inside] ** 2)))
        assert wrong < 20, f"{name}: {wrong:.1f} nm RMS"
    assert float(cloud.w.notnull().mean()) > 0.85


def test_measures_of_a_known_stretch_and_shear() -> None:
    """F = [[1.2, 0.1], [0, 0.9]]: every measure from its own definition."""
    gradient = np.array([[0.2, 0.1], [0.0, -0.1]])
    cloud = cloud_of(flat, lambda x, y, _: (0.2 * x + 0.1 * y, -0.1 * y, 0 * x), rows=30, columns=30)[0]
    names = ("von_mises", "area_change", "hencky", "engineering")
    strain = surface_strain(cloud, window=9, measures=names)
    deformation_gradient = np.eye(2) + gradient
    stretch_squared = deformation_gradient.T @ deformation_gradient
    values, vectors = np.linalg.eigh(stretch_squared)
    logarithmic = vectors @ np.diag(np.log(values) / 2) @ vectors.T
    e_2, e_1 = (values - 1) / 2
    deviator = np.diag([e_1, e_2, -(e_1 + e_2)])
    expected = {
        "e_von_mises": np.sqrt(2 / 3 * np.sum(deviator**2)),
        "area_change": np.linalg.det(deformation_gradient) - 1,
        "h_11": logarithmic[0, 0],
        "h_22": logarithmic[1, 1],
        "h_12": logarithmic[0, 1],
        "h_1": np.log(values[1]) / 2,
        "h_2": np.log(values[0]) / 2,
        "elongation_1": np.linalg.norm(deformation_gradient[:, 0]) - 1,
        "elongation_2": np.linalg.norm(deformation_gradient[:, 1]) - 1,
        "shear_angle": np.pi / 2
        - np.arccos(
            deformation_gradient[:, 0]
            @ deformation_gradient[:, 1]
            / np.prod(np.linalg.norm(deformation_gradient, axis=0))
        ),
    }
    for name, value in expected.items():
        assert float(np.abs(strain[name] - value).max()) < 1e-12, name
    with pytest.raises(SurfaceError, match="measure biot is unknown; there are von_mises"):
        surface_strain(cloud, window=9, measures=["biot"])
