"""Real and reference images, compared with the results of other programs."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.io import loadmat

from fringedic.correlation import Reference, measure_displacement


def images(name: str) -> Path:
    root = Path(__file__).resolve().parents[5]
    folder = Path(os.environ.get("FRINGEDIC_DATA", root.parent / "shared" / "data")) / name
    if not folder.is_dir():
        pytest.skip(f"no images in {folder}: set FRINGEDIC_DATA to the folder that holds {name}")
    return folder


def grey(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert image is not None, path
    return image


@pytest.mark.slow
def test_sample_14():
    """RMSE of the column means of every eighth row and column against the exact answer, and the uncertainty."""
    folder = images("challenge_sample14")
    exact = loadmat(folder / "Sample14Exact.mat")["Sample14Exact"]
    reference = Reference(grey(folder / "reference.tif"), window=56, spacing=8)
    pyvale = {"L1": 0.0031, "L3": 0.0037, "L5": 0.0066}  # RMSE of the column means [px]
    for column, (load, target) in zip((1, 3, 5), pyvale.items(), strict=True):
        field = measure_displacement(reference, grey(folder / f"{load}.tif"))
        e = field.displacement_x.to_numpy() - np.interp(field.column, exact[:, 0], exact[:, column])
        means = np.sqrt(np.nanmean(np.nanmean(e[3:-3, 3:-3], axis=0) ** 2))
        z = float(np.nanstd(e / field.sigma_x.to_numpy()))
        assert means < target, load
        assert 0.9 <= z <= 1.1, load


def test_open_hole_tension():
    """A real tensile test: the far end moves away from the near one, step by step."""
    folder = images("open_hole_tension")
    reference = Reference(grey(folder / "oht_cfrp_00.tiff"), spacing=4)
    stretch = []
    for step in (1, 6, 11):
        field = measure_displacement(reference, grey(folder / f"oht_cfrp_{step:02d}.tiff"))
        assert field.valid.mean() > 0.5
        rows = field.displacement_y.mean("column")
        stretch.append(float(rows.dropna("row")[-10:].mean() - rows.dropna("row")[:10].mean()))
    assert abs(stretch[0]) < abs(stretch[1]) < abs(stretch[2])
