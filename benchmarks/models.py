"""Time and memory of a comparison with a model: a million measured points beside a mesh of 100 000 nodes."""

from __future__ import annotations

import json
import resource
import time

import numpy as np
import xarray as xr

from fringedic.models import Model, compare_model
from fringedic.surface import surface_strain

SIDE = 1000  # points of the measured surface along each axis
NODES = 317  # of the mesh along each axis
STRAIN_WINDOW = 41  # [px]
SPACING = 20e-6  # of the points [m]
SIGMA = {"u": 0.1e-6, "v": 0.1e-6, "w": 2e-6}


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return a surface that determines all six parameters of the alignment [m]."""
    return 3 * x**2 + 2 * x * y + 0.3e-3 * np.sin(300 * x) * np.cos(250 * y)


def motion(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return a displacement (3, ...) [m]."""
    return np.stack([2e-3 * x, -0.6e-3 * y, 0.05 * x * (x + y)])


def model() -> Model:
    """Return a sheet that is larger than the measured surface."""
    x, y = (each.ravel() for each in np.meshgrid(*2 * [np.linspace(-0.6, 0.6, NODES) * SIDE * SPACING], indexing="ij"))
    first = (np.arange(NODES - 1)[:, None] * NODES + np.arange(NODES - 1)).ravel()
    quads = np.stack([first, first + NODES, first + NODES + 1, first + 1], axis=1)
    triangles = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    displacement = np.stack([np.zeros((len(x), 3)), motion(x, y).T])
    nodes = np.column_stack([x, y, height(x, y)])
    return Model("sheet", nodes, triangles, False, np.array([0.0, 1000.0]), displacement)


def experiment(strain: bool) -> xr.Dataset:
    """Return a reference and one step with white noise."""
    random = np.random.default_rng(1)
    column, row = np.meshgrid(np.arange(SIDE), np.arange(SIDE))
    x, y = SPACING * (column - SIDE / 2), SPACING * (SIDE / 2 - row)
    true = dict(zip("xyz", (x, y, height(x, y)), strict=True)) | dict(zip("uvw", motion(x, y), strict=True))
    noise = SIGMA | {"z": 2e-6}
    maps = {name: each + noise.get(name, 0) * random.standard_normal(x.shape) for name, each in true.items()}
    maps |= {f"sigma_{name}": np.full(x.shape, sigma) for name, sigma in SIGMA.items()}
    if strain:
        cloud = xr.Dataset(
            {name: (("row", "column"), each) for name, each in true.items()},
            {"row": np.arange(0, 4 * SIDE, 4), "column": np.arange(0, 4 * SIDE, 4)},
        )
        exact = surface_strain(cloud, window=STRAIN_WINDOW)
        for name in ("e_11", "e_22", "e_12"):
            noisy = exact[name].values + 20e-6 * random.standard_normal(x.shape)
            maps |= {name: noisy, f"sigma_{name}": np.full(x.shape, 20e-6)}
    fields = {name: (("step", "row", "column"), np.stack(2 * [each.astype(np.float32)])) for name, each in maps.items()}
    parameters = {
        "dic": {"window": 32, "method": "dense"},
        "coupling": {"z_filter_px": 2.0, "strain_window_px": STRAIN_WINDOW * strain},
    }
    return xr.Dataset(
        {**fields, "force": ("step", [0.0, 1000.0]), "reference_step": ("step", [0, 0])},
        {"step": [0, 1], "row": np.arange(0, 4 * SIDE, 4), "column": np.arange(0, 4 * SIDE, 4)},
        {"parameters": json.dumps([{"parameters": parameters}])},
    )


def main() -> None:
    """Print time and memory with and without strain."""
    sheet = model()
    for strain in (False, True):
        data = experiment(strain)
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        start, cpu = time.perf_counter(), time.process_time()
        found = compare_model(data, sheet)
        wall, cpu = time.perf_counter() - start, time.process_time() - cpu
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        ratios = ", ".join(
            f"{name} {float(ratio):.2f}"
            for name, ratio in zip(found["quantity"].values, found["normalized_rms"][0], strict=True)
        )
        print(
            f"strain {strain}: {wall:.1f} s, processor time {cpu:.1f} s, memory {before:.1f} -> {peak:.1f} GB; {ratios}"
        )


if __name__ == "__main__":
    main()
