"""Reference steps of a dataset in words."""

from __future__ import annotations

import numpy as np
import xarray as xr


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
