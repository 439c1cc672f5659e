"""Sentences about a dataset: its independent check and its reference steps."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
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


def missing_settings_sentence(nodes: Sequence[str]) -> str:
    """Return that the settings of nodes were not recorded; empty if they were.

    Examples
    --------
    >>> missing_settings_sentence(["dic"])
    'the settings of dic are not in the recording, defaults are used: put all files of the recording into its folder, \
or give them (--set)'
    """
    if not nodes:
        return ""
    return (
        f"the settings of {', '.join(nodes)} are not in the recording, defaults are used: put all files of the "
        "recording into its folder, or give them (--set)"
    )


def references_sentence(dataset: xr.Dataset) -> str:
    """Return which steps the displacements are relative to when there are several; empty when there is one.

    Parameters
    ----------
    dataset
        Of `fringedic.open_experiment`.

    Examples
    --------
    >>> references_sentence(xr.Dataset({"reference_step": ("step", [0, 0, 2, -1])}))
    "displacements are relative to steps 0, 2: 'fringedic process --reference 0' measures all steps against step 0"
    """
    references = [int(step) for step in np.unique(dataset["reference_step"].values) if step >= 0]
    if len(references) < 2:
        return ""
    listed = ", ".join(map(str, references))
    return (
        f"displacements are relative to steps {listed}: 'fringedic process --reference {references[0]}' measures all "
        f"steps against step {references[0]}"
    )
