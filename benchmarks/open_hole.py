"""A real tensile test of a carbon-fibre plate with a hole beside an orthotropic model fitted by its constants.

Images of the DIC Challenge 1.0 (sample 12). The model is a plate in plane stress, solved by finite elements, whose ends
move as measured. Displacements determine the constants up to a common factor. They are fitted at one step and
compared at all. ``--page docs/validation/open_hole.md`` writes figures and picture.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from scipy.optimize import least_squares
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu
from scipy.spatial import Delaunay

import fringedic
from fringedic.figures.maps import maps_figure
from fringedic.figures.panels import Panel
from fringedic.models import Model

PIXEL = 0.1e-3  # size is unknown; constants and ratios do not depend on it [m]
CENTRE, RADIUS = (193.0, 542.0), 52.0  # of the hole: column, row [px]
SIDES = ((37.0, 352.5), (40.0, 355.5))  # columns of the plate's edges at the first and at the last row
WIDTH, HEIGHT = 400, 1040  # [px]
ENDS = (48, 992)  # rows whose measured displacement is that of the model
MARGIN = 5.0  # between edges and measured points [px]
FITTED = (5, 8, 11)  # steps
TABLE = (3, 7, 11)  # steps
FIGURES = "<!-- figures -->\n"


@dataclass(frozen=True)
class Constants:
    """Elastic constants over the modulus along the load: E_x, major Poisson's ratio nu_yx, G_xy."""

    across: float
    poisson: float
    shear: float

    def stiffness(self) -> np.ndarray:
        """Return the plane-stress stiffness (3, 3) of (e_xx, e_yy, gamma_xy); E_y is 1."""
        compliance = np.array([[1 / self.across, -self.poisson, 0], [-self.poisson, 1, 0], [0, 0, 1 / self.shear]])
        return np.linalg.inv(compliance)


def sides(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns of the left and of the right edge at rows."""
    part = rows / HEIGHT
    left, right = (first + part * (last - first) for first, last in zip(*SIDES, strict=True))
    return left, right


def measure(folder: Path, images: Sequence[Path], *, spacing: int = 8) -> xr.Dataset:
    """Measure the images; the first is the reference."""
    row, column = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    left, right = sides(row)
    mask = (column > left + MARGIN) & (column < right - MARGIN)
    mask &= np.hypot(column - CENTRE[0], row - CENTRE[1]) > RADIUS + MARGIN
    fringedic.measure_images(
        images, folder / "plate.nc", window=32, spacing=spacing, strain_window=41, pixel_size=PIXEL, mask=mask
    )
    return fringedic.open_experiment(folder / "plate.nc")


def make_mesh(step: float = 12.0) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes (node, 2) [px, column and row] and triangles between the ends, finer at the hole."""
    rings = RADIUS * np.exp(np.arange(0, 11) * 2 * np.pi / 80)
    angles = np.arange(80) * 2 * np.pi / 80
    around = [
        np.array(CENTRE) + radius * np.column_stack([np.cos(angles + k % 2 * 0.039), np.sin(angles + k % 2 * 0.039)])
        for k, radius in enumerate(rings)
    ]
    rows = np.linspace(*ENDS, round((ENDS[1] - ENDS[0]) / step) + 1)
    left, right = sides(rows)
    across = np.linspace(0, 1, round((right[0] - left[0]) / step) + 1)
    grid = np.column_stack([(left[:, None] + across * (right - left)[:, None]).ravel(), np.repeat(rows, len(across))])
    away = np.hypot(*(grid - CENTRE).T) > rings[-1] + 0.5 * step
    nodes = np.vstack([*around, grid[away]])
    triangles = Delaunay(nodes).simplices
    middle = nodes[triangles].mean(axis=1)
    return nodes, triangles[np.hypot(*(middle - CENTRE).T) > RADIUS * np.cos(np.pi / 80)]


class Plate:
    """Linear triangles in plane stress with prescribed displacement at both ends."""

    def __init__(self, nodes: np.ndarray, triangles: np.ndarray) -> None:
        self.nodes, self.triangles = nodes * [1, -1], triangles  # x right, y up
        x, y = np.moveaxis(self.nodes[triangles], -1, 0)
        self._double_area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
        self._strain = np.zeros((len(triangles), 3, 6))
        for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
            b, c = (y[:, j] - y[:, k]) / self._double_area, (x[:, k] - x[:, j]) / self._double_area
            self._strain[:, 0, 2 * i] = self._strain[:, 2, 2 * i + 1] = b
            self._strain[:, 1, 2 * i + 1] = self._strain[:, 2, 2 * i] = c
        self.ends = np.isin(nodes[:, 1], ENDS)

    def solve(self, constants: Constants, ends: np.ndarray) -> np.ndarray:
        """Return the displacement (node, 2, case) for displacements of the ends (end node, 2, case)."""
        element = np.einsum(
            "tai,ab,tbj,t->tij", self._strain, constants.stiffness(), self._strain, np.abs(self._double_area) / 2
        )
        numbers = (2 * self.triangles[:, :, None] + np.arange(2)).reshape(-1, 6)
        rows, columns = np.repeat(numbers, 6, axis=1).ravel(), np.tile(numbers, (1, 6)).ravel()
        size = 2 * len(self.nodes)
        stiffness = coo_array((element.ravel(), (rows, columns)), shape=(size, size)).tocsr()
        fixed = np.repeat(self.ends, 2)
        moved = np.zeros((size, ends.shape[-1]))
        moved[fixed] = ends.reshape(-1, ends.shape[-1])
        load = -(stiffness[~fixed][:, fixed] @ moved[fixed])
        moved[~fixed] = splu(stiffness[~fixed][:, ~fixed].tocsc()).solve(load)
        return moved.reshape(-1, 2, ends.shape[-1])


def measured_ends(data: xr.Dataset, plate: Plate) -> np.ndarray:
    """Return the displacement (end node, 2, step) [m] of the ends: a parabola through the measured points near them."""
    found = np.empty((np.count_nonzero(plate.ends), 2, data.sizes["step"]))
    x, y = plate.nodes[plate.ends].T
    for row in ENDS:
        near = data[["u", "v"]].sel(row=slice(row - 24, row + 24))
        down, right = np.meshgrid(near.row, near.column, indexing="ij")
        for axis, name in enumerate("uv"):
            for step in range(data.sizes["step"]):
                values = near[name].values[step]
                known = np.isfinite(values)
                across, along = (right[known] - CENTRE[0]) / 160, (down[known] - row) / 24
                basis = np.column_stack([np.ones(len(across)), across, across**2, along])
                fit = np.linalg.lstsq(basis, values[known], rcond=None)[0]
                here = -y == row
                place = (x[here] - CENTRE[0]) / 160
                found[here, axis, step] = fit[0] + fit[1] * place + fit[2] * place**2
    return found


def model_of(plate: Plate, constants: Constants, ends: np.ndarray) -> Model:
    """Return the model whose loads are the numbers of the steps."""
    moved = np.moveaxis(plate.solve(constants, ends), -1, 0)
    middle = 0.5 * np.array([WIDTH - 1, 1 - HEIGHT])  # of the image, the origin of the measured surface
    nodes = np.pad(PIXEL * (plate.nodes - middle), ((0, 0), (0, 1)))
    loads = np.arange(ends.shape[-1], dtype=float)
    return Model("plate", nodes, plate.triangles, False, loads, np.pad(moved, ((0, 0), (0, 0), (0, 1))))


def fit(data: xr.Dataset, plate: Plate, ends: np.ndarray, step: int) -> tuple[Constants, np.ndarray]:
    """Return the constants with the least squared difference of the displacement at a step, and their covariance.

    The covariance counts every 16th point: neighbours share the noise of their windows.
    """
    one = np.stack([0 * ends[..., step], ends[..., step]], axis=-1)
    loads = {0: 0.0, step: 1.0}

    def differences(values: np.ndarray) -> np.ndarray:
        found = fringedic.compare_model(data, model_of(plate, Constants(*values), one), load_table=loads, steps=[step])
        maps = np.stack([found[f"normalized_{name}"].values for name in "uv"])
        return np.nan_to_num(maps.ravel().astype(float))

    solution = least_squares(differences, [0.3, 0.3, 0.1], diff_step=0.02, xtol=1e-3, ftol=1e-4, bounds=(0.01, 5.0))
    spread = float(np.mean(solution.fun[solution.fun != 0] ** 2))
    return Constants(*solution.x.tolist()), 16 * spread * np.linalg.inv(solution.jac.T @ solution.jac)


def isotropic(poisson: float = 0.3) -> Constants:
    """Return the constants of an isotropic plate."""
    return Constants(1.0, poisson, 1 / (2 * (1 + poisson)))


def figures(data: xr.Dataset, plate: Plate, ends: np.ndarray, picture: Path) -> str:
    """Return tables of the constants and of the agreement as Markdown, and write the picture."""
    steps = {step: float(step) for step in range(data.sizes["step"])}
    lines = ["| fitted at step | E_x/E_y | nu_yx | G_xy/E_y |", "|---:|---:|---:|---:|"]
    fits = {}
    for step in FITTED:
        constants, covariance = fit(data, plate, ends, step)
        cells = zip(vars(constants).values(), np.sqrt(np.diag(covariance)), strict=True)
        lines.append(f"| {step} | {' | '.join(f'{value:.3f} ± {2 * sigma:.3f}' for value, sigma in cells)} |")
        fits[step] = fringedic.compare_model(data, model_of(plate, constants, ends), load_table=steps)
    plain = fringedic.compare_model(data, model_of(plate, isotropic(), ends), load_table=steps)
    best = fits[FITTED[-1]]
    lines += [
        "",
        "| step | quantity | RMS difference over sigma | relative error | factor | isotropic: RMS over sigma |",
    ]
    lines.append("|---:|---|---:|---:|---:|---:|")
    for step in TABLE:
        for name in ("u", "v", "e_xx", "e_yy", "e_xy"):
            found, other = (each.sel(step=step, quantity=name) for each in (best, plain))
            lines.append(
                f"| {step} | {name} | {float(found.normalized_rms):.1f} | {100 * float(found.relative_error):.1f} % | "
                f"{float(found.factor):.3f} ± {2 * float(found.sigma_factor):.3f} | {float(other.normalized_rms):.1f} |"
            )
    _draw(best.sel(step=FITTED[-1]), picture)
    return "\n".join(lines) + "\n"


def _draw(step: xr.Dataset, picture: Path) -> None:
    panels = (
        Panel("e_yy", "measured e_yy", like="model_e_yy"),
        Panel("model_e_yy", "model e_yy", like="e_yy"),
        Panel("normalized_e_yy", "difference over sigma", symmetric=True),
        Panel("difference_v", "v: difference", symmetric=True),
    )
    maps_figure(step, panels, title=f"step {int(step.step)}").savefig(picture, dpi=60)


def main() -> None:
    """Print the constants and the agreement, or write them to the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("images", type=Path, help="folder with oht_cfrp_00.tiff to oht_cfrp_11.tiff")
    parser.add_argument("--page", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        data = measure(Path(folder), sorted(arguments.images.glob("oht_cfrp_*.tiff")))
        plate = Plate(*make_mesh())
        picture = arguments.page.with_suffix(".png") if arguments.page else Path(folder) / "open_hole.png"
        text = figures(data, plate, measured_ends(data, plate), picture)
    if arguments.page is None:
        print(text)
        return
    before, _, after = arguments.page.read_text(encoding="utf-8").split(FIGURES)
    arguments.page.write_text(f"{before}{FIGURES}{text}{FIGURES}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
