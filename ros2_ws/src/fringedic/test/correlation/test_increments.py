"""Increments composed in the initial configuration: exactness, noise, holes, the mesh's bias, bad input."""

from functools import cache

import numpy as np
import pytest
import xarray as xr

from fringedic.correlation.increments import accumulate
from fringedic.errors import CorrelationError

STEPS = 20
ROWS, COLUMNS = np.arange(0.0, 480, 4), np.arange(0.0, 640, 4)
ROW, COLUMN = np.meshgrid(ROWS, COLUMNS, indexing="ij")
INNER = {"row": slice(20, 100), "column": slice(20, 130)}


def motion(row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """Displacement (d_x, d_y) at the end: 10 % along columns, -3 % along rows, and waves."""
    waves_x = 6 * np.sin(2 * np.pi * column / 500) * np.cos(2 * np.pi * row / 430)
    waves_y = 4 * np.sin(2 * np.pi * (column + row) / 610 + 1)
    return np.stack([0.10 * (column - 200) + waves_x, -0.03 * (row - 240) + waves_y])


def origin(step: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the initial positions of the points that an image shows at the grid."""
    row, column = ROW.copy(), COLUMN.copy()
    for _ in range(40):
        d_x, d_y = motion(row, column) * step / STEPS
        change = max(np.abs(ROW - d_y - row).max(), np.abs(COLUMN - d_x - column).max())
        row, column = ROW - d_y, COLUMN - d_x
        if change < 1e-11:
            return row, column
    raise ArithmeticError("the motion cannot be inverted by iteration")


@cache
def exact(step: int) -> np.ndarray:
    """Increment of a step at the grid of its image."""
    return motion(*origin(step)) / STEPS


def increments(noise: float = 0.0, seed: int = 0, window: int | None = None) -> list[xr.Dataset]:
    rng = np.random.default_rng(seed)
    found = []
    for step in range(STEPS):
        d_x, d_y = exact(step) + noise * rng.normal(size=(2, *ROW.shape))
        sigma = np.full(ROW.shape, noise)
        fields = {"displacement_x": d_x, "displacement_y": d_y, "sigma_x": sigma, "sigma_y": sigma}
        found.append(
            xr.Dataset(
                {name: (("row", "column"), values) for name, values in fields.items()},
                {"row": ROWS, "column": COLUMNS},
                {} if window is None else {"window_px": window},
            )
        )
    return found


def error(total: xr.Dataset) -> np.ndarray:
    return np.stack([total.displacement_x.values, total.displacement_y.values]) - motion(ROW, COLUMN)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


@pytest.fixture(scope="module")
def total() -> xr.Dataset:
    """Composition of the exact increments."""
    return accumulate(increments())


def test_without_noise_the_spline_is_exact_where_sums_are_not(total: xr.Dataset) -> None:
    naive = sum(each.displacement_x.values for each in increments()) - motion(ROW, COLUMN)[0]
    assert rms(naive) > 0.5
    assert rms(error(total)) < 1e-4
    assert float(total.valid.mean()) > 0.85


@pytest.mark.parametrize("method", ["spline", "mesh"])
def test_noise_and_its_uncertainty(method: str) -> None:
    total = accumulate(increments(0.01, seed=5), method=method)
    wrong = error(total)
    scores = [
        rms(each[20:100, 20:130] / total[f"sigma_{name}"][INNER].values) for name, each in zip("xy", wrong, strict=True)
    ]
    assert rms(wrong) < 0.045
    if method == "spline":
        assert all(0.9 < score < 1.1 for score in scores)


def test_uncertainty_grows_with_every_increment() -> None:
    parts = increments(0.01)
    sigmas = [float(accumulate(parts[:n]).sigma_x[INNER].mean()) for n in (1, 4, 16)]
    assert 1.8 < sigmas[1] / sigmas[0] < 2.4
    assert 1.8 < sigmas[2] / sigmas[1] < 2.4


def test_errors_that_agree_over_a_window_are_not_averaged_away() -> None:
    independent, agreeing = (
        accumulate(increments(0.01, window=window)[:5], method="mesh").sigma_x[INNER].mean() for window in (None, 32)
    )
    assert 2 * independent < agreeing < 0.01 * np.sqrt(5) * 1.1


def test_bias_of_a_mesh_is_that_of_its_elements() -> None:
    """The curvature c of a field leaves c h^2/8 at most per increment: sixteen times as much for elements of 80 px."""
    fine, coarse = (accumulate(increments(), method="mesh", element=element) for element in (20.0, 80.0))
    assert rms(error(fine)) < 0.01
    assert 8 < rms(error(coarse)) / rms(error(fine)) < 32
    assert coarse.attrs["misfit_px"] > 8 * fine.attrs["misfit_px"]


def test_a_hole_stays_where_its_material_is(total: xr.Dataset) -> None:
    """Where a patch of the image is not measured in one increment, the points that are there are lost."""
    parts = increments()
    for name in ("displacement_x", "displacement_y"):
        parts[10][name][40:50, 60:75] = np.nan
    interrupted = accumulate(parts)
    lost = interrupted.displacement_x.isnull().values & total.displacement_x.notnull().values
    then = motion(ROW, COLUMN) * 10 / STEPS
    row, column = ROW + then[1], COLUMN + then[0]
    near = (row > ROWS[39] - 1) & (row < ROWS[50] + 1) & (column > COLUMNS[59] - 1) & (column < COLUMNS[75] + 1)
    inside = (row > ROWS[40]) & (row < ROWS[49]) & (column > COLUMNS[60]) & (column < COLUMNS[74])
    assert lost[inside].all()
    assert not lost[~near].any()
    assert float(np.abs(interrupted.displacement_x - total.displacement_x).max()) < 0.01


def test_bad_input_is_refused() -> None:
    part = increments()[0]
    with pytest.raises(CorrelationError, match="no increment"):
        accumulate([])
    with pytest.raises(CorrelationError, match="'spline' or 'mesh'"):
        accumulate([part], method="sum")
    with pytest.raises(CorrelationError, match="above 0 px"):
        accumulate([part], method="mesh", element=0.0)
    with pytest.raises(CorrelationError, match="equidistant"):
        accumulate([part.assign_coords(column=COLUMNS**1.1)])
