"""Sentences about two experiments, or the specimens of a group, that are compared point by point."""

from __future__ import annotations

import numpy as np
import xarray as xr

from fringedic.errors import DatasetError

NOT_IN_BOTH = "no point is measured in both experiments: their specimens are at other places in the image"
NOT_OF_ALL = "no point is measured of all specimens: they are at other places in the image"


def comparison_sentences(found: xr.Dataset) -> list[str]:
    """Return one sentence for each quantity of the last compared step, before them one on different reference steps.

    Parameters
    ----------
    found
        From `compare_experiments`.
    """
    last = found.sel(step=last_compared(found, NOT_IN_BOTH))
    return _references(found) + [
        f"{name}: {100 * float(each['within_2_sigma']):.1f} % of {int(each['points'])} points differ by less than "
        f"2 sigma (95 % expected of independent noise), RMS over sigma {float(each['normalized_rms']):.2f}"
        for name in last["quantity"].values.tolist()
        if int((each := last.sel(quantity=name))["points"])
    ]


def specimen_sentences(found: xr.Dataset) -> list[str]:
    """Return one sentence for each quantity of the last compared step, before them one on different reference steps.

    Parameters
    ----------
    found
        From `fringedic.evaluation.compare_specimens`.
    """
    last = found.sel(step=last_compared(found, NOT_OF_ALL))
    return _references(found) + [
        f"{name}: the spread of the specimens at a point is {float(each['spread_over_uncertainty']):.2f} times the "
        f"uncertainty of one measurement ({int(each['points'])} points)"
        for name in last["quantity"].values.tolist()
        if int((each := last.sel(quantity=name))["points"])
    ]


def last_compared(found: xr.Dataset, nowhere: str) -> int:
    """Return the last step at which points are compared.

    Raises
    ------
    DatasetError
        With the sentence `nowhere`: there is none.
    """
    compared = found["step"].values[(found["points"].values > 0).any(axis=1)]
    if not compared.size:
        raise DatasetError(nowhere)
    return int(compared[-1])


def _references(found: xr.Dataset) -> list[str]:
    """Return a sentence if the compared experiments have different reference steps, else none.

    Parameters
    ----------
    found
        From `compare_experiments` or `compare_specimens`.
    """
    differ = found["references_differ"].values
    if not differ.any():
        return []
    return [
        f"at {np.count_nonzero(differ)} of {differ.size} steps the experiments have different reference steps: "
        "their displacement and strain are relative to different states of the specimen and are not comparable; "
        "process them with the same --reference"
    ]
