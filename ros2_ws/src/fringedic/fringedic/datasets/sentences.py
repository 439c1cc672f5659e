"""Sentences about a dataset: its independent check and its reference steps."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from fringedic.datasets.confirmation import LIMIT, confirmed_share
from fringedic.datasets.quantities import LATER_REFERENCES


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


def lost_references_sentence(replaced: Mapping[int, int], path: str | os.PathLike[str]) -> str:
    """Return why the results of the nodes are refused: after a loss they count from another step than before.

    Parameters
    ----------
    replaced
        Step that the nodes measured against instead of the reference that they had lost -> this reference.
    path
        The recording.

    Examples
    --------
    >>> lost_references_sentence({4: 0}, "bag")
    "the results of the nodes count from step 4 instead of step 0, whose data a node that was started again or a \
continued run had lost: 'fringedic process bag' measures all steps from the recorded frames"
    """
    counted = ", ".join(f"step {step} instead of step {reference}" for step, reference in replaced.items())
    return (
        f"the results of the nodes count from {counted}, whose data a node that was started again or a continued run "
        f"had lost: 'fringedic process {path}' measures all steps from the recorded frames"
    )


def references_sentence(dataset: xr.Dataset) -> str:
    """Return which steps the displacements are relative to when there are several, or when the first is not recorded.

    Empty when there is one, which is the first of its experiment or the one that was asked for.

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
    later = [step for step in json.loads(dataset.attrs.get(LATER_REFERENCES, "[]")) if step in references]
    if later:
        return (
            f"displacements are relative to step {later[0]}, at the load of that step, because the recording lacks the "
            "reference before it: process the recording of all parts of the run"
        )
    if len(references) < 2:
        return ""
    listed = ", ".join(map(str, references))
    return (
        f"displacements are relative to steps {listed}: 'fringedic process --reference {references[0]}' measures all "
        f"steps against step {references[0]}"
    )
