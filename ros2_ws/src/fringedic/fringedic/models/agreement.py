"""Agreement of one measured map with that of a model, in figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.ndimage import label

from fringedic.evaluation.correlated import correlated_points

AGREEMENT = {
    "points": ("1", "number of compared points"),
    "within_2_sigma": ("1", "share of the points whose difference is within two standard uncertainties"),
    "normalized_rms": ("1", "RMS of difference over standard uncertainty: 1 for noise alone"),
    "rms_difference": ("", "RMS difference, in the unit of the quantity"),
    "rms_sigma": ("", "RMS standard uncertainty of the difference, in the unit of the quantity"),
    "systematic": ("", "RMS of the difference beyond its uncertainty, in the unit of the quantity"),
    "relative_error": ("1", "RMS difference over the RMS of the measured map or its uncertainty, the larger one"),
    "correlated_points": ("1", "number of neighbouring points that share one independent difference"),
    "largest_region": ("1", "points of the largest region beyond two standard uncertainties of one sign"),
    "mean_error": ("", "comparison error: mean of model minus measured, in the unit of the quantity"),
    "sigma_mean_error": ("", "validation uncertainty of the mean error (ASME V&V 20), in the unit of the quantity"),
    "factor": ("1", "factor on the model's map with the least squared differences"),
    "sigma_factor": ("1", "standard uncertainty of the factor"),
}

CURVE = {
    "curve_within_2_sigma": "share of the points of all steps whose difference is within two standard uncertainties",
    "curve_normalized_rms": "RMS of difference over standard uncertainty, of the points of all steps",
    "curve_relative_error": "RMS difference of all steps over the RMS of their measured maps or uncertainties",
    "curve_factor": "factor on the model's maps of all steps: mean of those of the steps by their uncertainty",
    "curve_sigma_factor": "standard uncertainty of curve_factor, for errors that the steps share: an upper limit",
}


@dataclass(frozen=True)
class Agreement:
    """Figures of one quantity at one step; units and meanings in `AGREEMENT`, NaN without points."""

    points: int
    within_2_sigma: float
    normalized_rms: float
    rms_difference: float
    rms_sigma: float
    systematic: float
    relative_error: float
    correlated_points: float
    largest_region: int
    mean_error: float
    sigma_mean_error: float
    factor: float
    sigma_factor: float


_NOTHING = Agreement(**{**dict.fromkeys(AGREEMENT, math.nan), "points": 0, "largest_region": 0})  # type: ignore[arg-type]


def assess(
    measured: np.ndarray, sigma: np.ndarray, modelled: np.ndarray, changes: Sequence[np.ndarray] = ()
) -> Agreement:
    """Compare a measured map with that of a model.

    Parameters
    ----------
    measured, sigma, modelled : (row, column)
        In one unit, NaN where not known.
    changes
        Change of the model's map by each independent error of its placement, one standard deviation each.

    Returns
    -------
    Agreement
        The noise of neighbouring points is taken to be as correlated as the differences are, so that uncertainties of
        mean and factor are too large rather than too small where the model is wrong.

    References
    ----------
    ASME V&V 20-2009, Standard for verification and validation in computational fluid dynamics and heat transfer.

    Examples
    --------
    >>> generator = np.random.default_rng(1)
    >>> true = np.linspace(1, 2, 4000).reshape(50, 80)
    >>> found = assess(1.02 * true + generator.normal(0, 0.1, true.shape), np.full(true.shape, 0.1), true)
    >>> round(found.factor, 2), round(found.sigma_factor, 3)
    (1.02, 0.001)
    >>> assess(true, np.full(true.shape, 0.1), 0 * true).factor
    nan
    """
    variance = sigma**2 + sum((change**2 for change in changes), np.zeros(sigma.shape))
    difference = measured - modelled
    known = np.isfinite(difference) & np.isfinite(variance) & (sigma > 0)
    points = int(np.count_nonzero(known))
    if not points:
        return _NOTHING
    d, s2, m = difference[known], variance[known], modelled[known]
    moved = [change[known] for change in changes]
    noise = 1 / sigma[known] ** 2
    power = float(np.sum(m**2 * noise))
    factor = float(np.sum(m * measured[known] * noise) / power) if power > 0 else 0.0
    rest = np.where(known, (measured - factor * modelled) / np.sqrt(variance), np.nan)
    together = correlated_points(rest)
    mean_square = float(np.mean(d**2))
    mean_variance = together * float(np.mean(sigma[known] ** 2)) / points + sum(
        float(np.mean(each)) ** 2 for each in moved
    )
    aligned = sum(float(np.sum(m * each * noise)) ** 2 for each in moved)
    normalized = np.where(known, difference / np.sqrt(variance), 0.0)
    sizes = [np.bincount(label(sign * normalized > 2)[0].ravel())[1:] for sign in (1, -1)]
    return Agreement(
        points=points,
        within_2_sigma=float(np.mean(d**2 <= 4 * s2)),
        normalized_rms=float(np.sqrt(np.mean(d**2 / s2))),
        rms_difference=float(np.sqrt(mean_square)),
        rms_sigma=float(np.sqrt(np.mean(s2))),
        systematic=float(np.sqrt(max(0.0, mean_square - float(np.mean(s2))))),
        relative_error=float(np.sqrt(mean_square / max(float(np.mean(measured[known] ** 2)), float(np.mean(s2))))),
        correlated_points=together,
        largest_region=int(max((each.max() for each in sizes if each.size), default=0)),
        mean_error=-float(np.mean(d)),
        sigma_mean_error=float(np.sqrt(mean_variance)),
        factor=factor if power > 0 else math.nan,
        sigma_factor=math.sqrt(together / power + aligned / power**2) if power > 0 else math.nan,
    )


def assess_curve(steps: xr.Dataset) -> xr.Dataset:
    """Return the figures `CURVE` over quantity, from those of each step over (step, quantity).

    The steps share the reference image and the alignment, so that their errors do not average out.
    """
    points = steps["points"]
    total = points.sum("step")
    scale = (steps["rms_difference"] / steps["relative_error"]) ** 2
    weights = 1 / steps["sigma_factor"] ** 2
    weights = weights.where(np.isfinite(weights) & steps["factor"].notnull(), 0.0)
    found: dict[str, xr.DataArray] = {
        "curve_within_2_sigma": (points * steps["within_2_sigma"]).sum("step") / total,
        "curve_normalized_rms": ((points * steps["normalized_rms"] ** 2).sum("step") / total) ** 0.5,
        "curve_relative_error": ((points * steps["rms_difference"] ** 2).sum("step") / (points * scale).sum("step"))
        ** 0.5,
        "curve_factor": (weights * steps["factor"]).sum("step") / weights.sum("step"),
        "curve_sigma_factor": (weights * steps["sigma_factor"]).sum("step") / weights.sum("step"),
    }
    return xr.Dataset({name: each.assign_attrs(units="1", long_name=CURVE[name]) for name, each in found.items()})
