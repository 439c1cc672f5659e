"""Strain of a step of a dataset with another window than that of the experiment."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import xarray as xr

from fringedic.datasets.attributes import parameters_of
from fringedic.datasets.quantities import strain_measure_of
from fringedic.errors import DatasetError
from fringedic.evaluation.motion import motion_of
from fringedic.evaluation.step_maps import step_of
from fringedic.surface.flat import flat_strain
from fringedic.surface.strain import surface_strain
from fringedic.wording.arguments import check_arguments, several, text, whole
from fringedic.wording.arguments import dataset as dataset_of

_SIGMAS = ["sigma_e_11", "sigma_e_22", "sigma_e_12"]
_NOISE = ["noise_z", "noise_z_deformed"]
_OF_A_CLOUD = (*"xyzuvw", "sigma_u", "sigma_v", "sigma_w", *_NOISE)
_OF_A_CLOUD += ("displacement_sigma_x", "displacement_sigma_y", *_SIGMAS)
_OF_A_DISPLACEMENT = {"window_px": "window", "method": "method"}  # attribute of a displacement -> parameter of dic


@check_arguments(DatasetError, dataset=dataset_of(), step=whole(), measures=several(text))
def strain_of_step(dataset: xr.Dataset, window: int, *, step: int = -1, measures: Iterable[str] = ()) -> xr.Dataset:
    """Return the strain of a step with a window of one's own, as the run would have computed it.

    Uncertainties, discontinuities and virtual strain gauge are those of the run; for its window all maps are equal to
    the recorded ones, to the rounding of float32. The correlation of errors by a sparse texture is known for the window
    of the run only and is taken from its uncertainties: on skin sigmas of windows from 21 to 171 px differ by up to 9 %
    by that. Datasets of earlier versions do not contain the noise of the heights: the strain has no uncertainty and is
    not masked at discontinuities until they are processed again.

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
        As of `fringedic.surface_strain`; of images alone as of `fringedic.surface.flat_strain`, in the measure of the
        dataset.

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
    parameters = parameters_of(one)
    if motion_of(one).spatial:
        cloud = _with_noise_attributes(one, parameters)
        slope_noise = _slope_noise(cloud, int(parameters.get("coupling", {}).get("strain_window_px", 0)))
        strain = surface_strain(cloud, window=window, measures=measures, slope_noise=slope_noise)
        return _with_windows(strain, cloud.attrs)
    if measures:
        raise DatasetError(
            f"measures is {list(measures)}: images alone give the von Mises strain only, which needs no measure"
        )
    if "displacement_sigma_x" not in one:
        displacement = one
    else:
        dic = parameters.get("dic", {})
        attributes = {name: dic[key] for name, key in _OF_A_DISPLACEMENT.items() if key in dic}
        names = {"displacement_sigma_x": "sigma_x", "displacement_sigma_y": "sigma_y"}
        displacement = one[["displacement_x", "displacement_y", *names]].rename(names).assign_attrs(attributes)
    strain = flat_strain(
        displacement, window=window, pixel_size=one.attrs.get("pixel_size"), measure=strain_measure_of(one)
    )
    return _with_windows(strain, {f"displacement_{name}": displacement.attrs.get(name) for name in _OF_A_DISPLACEMENT})


def _with_windows(strain: xr.Dataset, attributes: Mapping[str, Any]) -> xr.Dataset:
    """Add the windows of strain and displacement, which the uncertainty of a mean depends on."""
    names = [f"displacement_{name}" for name in _OF_A_DISPLACEMENT]
    known = {name: attributes[name] for name in names if attributes.get(name) is not None}
    return strain.assign_attrs(strain_window_px=strain.attrs["window_px"], **known)


def _with_noise_attributes(step: xr.Dataset, parameters: Mapping[str, Mapping[str, Any]]) -> xr.Dataset:
    """Return the maps of a step that its strain follows from, with the attributes that `couple` gives a cloud."""
    cloud = step[[name for name in _OF_A_CLOUD if name in step]].transpose("row", "column").load()
    dic, coupling = parameters.get("dic", {}), parameters.get("coupling", {})
    calibration = json.loads(step.attrs.get("calibration", "{}"))
    known = {f"displacement_{name}": dic.get(key) for name, key in _OF_A_DISPLACEMENT.items()}
    known |= {"z_filter_px": coupling.get("z_filter_px"), "camera_distance": calibration.get("camera_distance")}
    cloud = cloud.assign_attrs({name: value for name, value in known.items() if value is not None})
    if "z_filter_px" in cloud.attrs and "camera_distance" in cloud.attrs:
        return cloud
    return cloud.drop_vars(_NOISE, errors="ignore")  # without these values its effect is not known


def _slope_noise(cloud: xr.Dataset, window: int) -> float:
    """Return the slope noise of the texture, see `surface_strain`, from the standard deviations that the run stated.

    Their squares are a sum of the noise of the heights and of that of the displacement, which alone is multiplied by
    the slope noise. 1 where no strain was measured, or where the noise of the heights is not known.
    """
    if not window or not all(name in cloud for name in (*_NOISE, *_SIGMAS)):
        return 1.0
    heights, both = (
        surface_strain(cloud, window=window, slope_noise=slope_noise)[_SIGMAS].to_array().to_numpy().astype(float) ** 2
        for slope_noise in (0.0, 1.0)
    )
    ratio = (cloud[_SIGMAS].to_array().to_numpy().astype(float) ** 2 - heights) / (both - heights)
    known = np.isfinite(ratio)
    return float(np.median(ratio[known])) if known.any() else 1.0
