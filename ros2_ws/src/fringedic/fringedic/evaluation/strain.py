"""Strain of a step of a dataset with another window than that of the experiment."""

from __future__ import annotations

import json
from collections.abc import Iterable

import xarray as xr

from fringedic.errors import DatasetError
from fringedic.evaluation.motion import motion_of
from fringedic.evaluation.step_maps import step_of
from fringedic.surface.flat import flat_strain
from fringedic.surface.strain import surface_strain
from fringedic.wording.arguments import check_arguments, several, text, whole
from fringedic.wording.arguments import dataset as dataset_of


@check_arguments(DatasetError, dataset=dataset_of(), step=whole(), measures=several(text))
def strain_of_step(dataset: xr.Dataset, window: int, *, step: int = -1, measures: Iterable[str] = ()) -> xr.Dataset:
    """Return the strain of a step with a window of one's own.

    Parameters
    ----------
    dataset
        Of `fringedic.open_experiment`, or of a single step.
    window
        Width of the window [px of the reference image].
    step
        Number of the step; negative numbers count from the last one.
    measures
        Of `fringedic.surface_strain`, such as ``"von_mises"``.

    Returns
    -------
    Dataset
        As of `fringedic.surface_strain`; of images alone as of `fringedic.surface.flat_strain`.

    Raises
    ------
    DatasetError
        There is no such step.
    SurfaceError
        The dataset has no displacement, the window contains fewer than 3 x 3 points, or a measure is unknown.

    Examples
    --------
    >>> import fringedic
    >>> experiment = fringedic.open_experiment("recordings/plate-7/bag")
    >>> strain = strain_of_step(experiment, window=21, measures=["von_mises"])
    >>> round(1e3 * float(strain.e_von_mises.median()))  # [1e-3]
    6
    """
    one = step_of(dataset, step)
    if motion_of(one).spatial:
        return surface_strain(one, window=window, measures=measures)
    if measures:
        raise DatasetError(
            f"measures is {list(measures)}: images alone give the von Mises strain only, which needs no measure"
        )
    if "displacement_sigma_x" not in one:
        displacement = one
    else:
        parameters = json.loads(one.attrs.get("parameters", "[]"))
        attributes = {"window_px": parameters[-1]["parameters"]["dic"]["window"]} if parameters else {}
        names = {"displacement_sigma_x": "sigma_x", "displacement_sigma_y": "sigma_y"}
        displacement = one[["displacement_x", "displacement_y", *names]].rename(names).assign_attrs(attributes)
    return flat_strain(displacement, window=window, pixel_size=one.attrs.get("pixel_size"))
