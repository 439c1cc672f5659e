"""Share of the points that an independent check confirms."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from fringedic.datasets.quantities import CLOSURES

LIMIT = 3.0  # standard deviations


def confirmed_fraction(maps: Mapping[str, np.ndarray], spacing: int) -> float:
    """Return the part of the checked points of a step whose closures are all within 3 standard deviations.

    Parameters
    ----------
    maps
        Of the step by their names in a dataset; the phase at every pixel, the displacement at its points.
    spacing
        Distance of the points of the displacement [px].

    Returns
    -------
    float
        NaN where nothing was checked.

    Examples
    --------
    >>> phase = np.full((4, 4), 9.0)
    >>> phase[::2, ::2] = [[0.5, -4.0], [np.nan, 0.1]]
    >>> moved = np.array([[0.2, 0.1], [np.nan, 3.5]])
    >>> confirmed_fraction({"phase_closure": phase, "displacement_closure_x": moved}, 2)
    0.3333333333333333
    """
    closures = [maps[name] for name in CLOSURES if name in maps]
    if not closures:
        return float("nan")
    smallest = min((each.shape for each in closures), key=np.prod)
    points = np.stack([each if each.shape == smallest else each[::spacing, ::spacing] for each in closures])
    checked = np.isfinite(points).any(axis=0)
    if not checked.any():
        return float("nan")
    return float(np.mean((np.abs(points) > LIMIT).any(axis=0)[checked] == 0))


def confirmed_share(dataset: xr.Dataset) -> float:
    """Return the mean of the confirmed parts of the steps of an experiment; NaN where no step was checked.

    Parameters
    ----------
    dataset
        Of `fringedic.open_experiment`.
    """
    if "confirmed_fraction" not in dataset:
        return float("nan")
    fractions = dataset["confirmed_fraction"].values
    return float(np.mean(fractions[np.isfinite(fractions)])) if np.isfinite(fractions).any() else float("nan")
