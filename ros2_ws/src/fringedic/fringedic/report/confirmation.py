"""The verdict of the independent check in words."""

from __future__ import annotations

import math

import xarray as xr

from fringedic.datasets.confirmation import LIMIT, confirmed_share


def confirmation_sentence(dataset: xr.Dataset) -> str:
    """Return the verdict of the independent check of a run; empty where no step was checked.

    Parameters
    ----------
    dataset
        Of `fringedic.open_experiment`.

    Examples
    --------
    >>> confirmation_sentence(xr.Dataset({"confirmed_fraction": ("step", [float("nan"), 0.99149])}))
    '99.1 % of the points are confirmed within 3 sigma by an independent check'
    """
    share = confirmed_share(dataset)
    if math.isnan(share):
        return ""
    # rounded down: 100.0 % means all of them
    return (
        f"{math.floor(1000 * share) / 10:.1f} % of the points are confirmed within {LIMIT:g} sigma by an independent "
        "check"
    )
