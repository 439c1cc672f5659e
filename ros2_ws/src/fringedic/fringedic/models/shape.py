"""Measured shape beside a nominal one: deviation along the normal with its standard uncertainty."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np
import xarray as xr

from fringedic.datasets.quantities import MAP_DIMENSIONS
from fringedic.errors import ModelError
from fringedic.models.agreement import AGREEMENT, assess
from fringedic.models.comparison import KEPT
from fringedic.models.model import Model
from fringedic.models.observed import FEATURE_CHECKS, Edge, Features, Pair, place_on_step, placement_text
from fringedic.models.placement import Placement, seen_side
from fringedic.models.sampling import Distances, distances
from fringedic.wording.arguments import check_arguments, dataset, of_type, optional, whole

_SHAPE = ("shape_x", "shape_y", "shape_z")
_FIGURES = {name: AGREEMENT[name] for name in AGREEMENT if not name.endswith("factor")} | {
    "peak_to_valley": ("m", "largest minus smallest deviation; of a nominal plane the flatness (ISO 12781)"),
    "sigma_peak_to_valley": ("m", "standard uncertainty of peak_to_valley"),
    "noise_peak_to_valley": ("m", "peak_to_valley that noise alone is expected to give"),
}


@check_arguments(
    ModelError,
    experiment=dataset(over=("step", "row", "column")),
    model=of_type(Model),
    step=optional(whole()),
    **FEATURE_CHECKS,
)
def compare_shape(
    experiment: xr.Dataset,
    model: Model,
    *,
    pairs: Sequence[Pair] = (),
    pair_sigma: float | None = None,
    holes: Sequence[Pair] = (),
    edges: Sequence[Edge] = (),
    principal_axes: bool = False,
    step: int | None = None,
) -> xr.Dataset:
    """Compare the measured shape of a step with that of a mesh, such as an STL of the nominal part.

    The model is aligned with the shape (`place_model`). The deviation is the distance of each measured point from the
    model along the model's normal. Its variance is that of the height, which moves a point along its line of sight,
    plus that of the alignment.

    Parameters
    ----------
    experiment
        From `fringedic.open_experiment`, with shape and its uncertainty.
    model
        From `read_model`; a displacement is not used.
    pairs, pair_sigma, holes, edges, principal_axes
        As in `compare_model`.
    step
        Number of the step; by default the first one with a shape.

    Returns
    -------
    Dataset
        Over (step, row, column) with one step, float32: ``x``, ``y``, ``z`` [m], ``deviation`` [m], positive outside
        the model, with ``sigma_deviation`` and ``normalized_deviation``. Over step the figures of
        `fringedic.models.agreement` for the deviation, and ``peak_to_valley`` with its uncertainty and the value that
        noise alone gives. The attribute ``placement`` is that of `compare_model`.

    Raises
    ------
    ModelError
        The dataset has no shape with uncertainty, or as of `place_model`.

    Examples
    --------
    >>> experiment = fringedic.open_experiment("recordings/cover-2/bag")  # doctest: +SKIP
    >>> nominal = read_model("cover.stl", unit="mm")  # doctest: +SKIP
    >>> float(compare_shape(experiment, nominal).peak_to_valley)  # doctest: +SKIP
    4.1e-05
    """
    chosen = _step_with_shape(experiment, step)
    placement = place_on_step(chosen, _SHAPE, model, Features(pairs, pair_sigma, holes, edges, principal_axes), None)
    points = np.stack([chosen[name].values.astype(float) for name in _SHAPE])
    side = seen_side(model, placement)
    found = distances(
        placement.apply(model.nodes), side.triangles, side.normals @ placement.rotation.T, points.reshape(3, -1).T
    )
    shape = points.shape[1:]
    deviation = found.along_normal.reshape(shape)
    # An error of 1 m of z moves a point along its line of sight.
    calibration = json.loads(experiment.attrs.get("calibration", "null")) or {}
    height = float(calibration.get("camera_distance", math.inf))
    x, y, z = points.reshape(3, -1)
    sight = np.stack([x / (z - height), y / (z - height), np.ones(len(z))])
    along_sight = np.asarray(np.einsum("pi,ip->p", found.normals, sight)).reshape(shape)
    sigma = np.abs(along_sight) * chosen["shape_sigma_z"].values
    changes = [each.reshape(shape) for each in _changes(placement, found)]
    total = np.sqrt(sum((change**2 for change in changes), sigma.astype(float) ** 2))
    maps = dict(zip("xyz", points, strict=True))
    maps |= {"deviation": deviation, "sigma_deviation": total, "normalized_deviation": deviation / total}
    # The range of n normal errors is 2 sqrt(2 ln n) sigma (Cramer 1946). The alignment, which the two ends share, is
    # not part of its uncertainty.
    known = np.isfinite(deviation) & np.isfinite(sigma)
    if not known.any():
        peak_to_valley = dict.fromkeys(("peak_to_valley", "sigma_peak_to_valley", "noise_peak_to_valley"), math.nan)
    else:
        d, s = deviation[known], sigma[known]
        ends = s[[int(np.argmax(d)), int(np.argmin(d))]]
        expected = 2 * math.sqrt(2 * math.log(len(d))) * float(np.sqrt(np.mean(s**2)))
        peak_to_valley = {
            "peak_to_valley": float(np.ptp(d)),
            "sigma_peak_to_valley": float(np.hypot(*ends)),
            "noise_peak_to_valley": expected,
        }
    figures = asdict(assess(deviation, sigma, np.zeros(shape), changes)) | peak_to_valley
    fields: dict[str, object] = {
        name: (MAP_DIMENSIONS[1:], values.astype(np.float32), {"units": "sigma" if "normalized" in name else "m"})
        for name, values in maps.items()
    }
    for name, (units, long_name) in _FIGURES.items():
        fields[name] = ((), figures[name], {"units": units or "m", "long_name": long_name})
    if "time" in chosen:
        fields["time"] = chosen["time"].variable
    coordinates = {name: chosen[name] for name in ("row", "column", "x_mm", "y_mm") if name in chosen.coords}
    kept = {name: experiment.attrs[name] for name in KEPT if name in experiment.attrs}
    return (
        xr.Dataset(fields, coordinates, kept)
        .assign_coords(step=int(chosen["step"]))
        .expand_dims("step")
        .assign_attrs(model=model.name, placement=placement_text(placement))
    )


def _step_with_shape(experiment: xr.Dataset, step: int | None) -> xr.Dataset:
    """Return a step, by default the first one with a shape."""
    needed = (*_SHAPE, "shape_sigma_z")
    missing = [name for name in needed if name not in experiment or experiment[name].dtype.kind != "f"]
    if missing:
        raise ModelError(
            f"the dataset has no {', '.join(missing)}: a shape is compared where a rig has measured it with its "
            "uncertainty; open the dataset of a recording"
        )
    numbers = experiment["step"].values.tolist()
    if step is not None and step not in numbers:
        raise ModelError(f"the dataset has no step {step}; it has {', '.join(map(str, numbers))}")
    for number_of_step in numbers if step is None else [step]:
        chosen = experiment.sel(step=number_of_step).transpose(..., "row", "column", missing_dims="ignore")
        if np.isfinite(chosen["shape_z"].values + chosen["shape_sigma_z"].values).any():
            return chosen
    where = "any step" if step is None else f"step {step}"
    raise ModelError(f"the dataset has no measured shape in {where}; choose another step or recording")


def _changes(placement: Placement, found: Distances) -> list[np.ndarray]:
    """Return the change of the deviation by each independent error of the placement, one standard deviation each."""
    derivatives = np.hstack([found.normals, np.cross(found.foot - placement.centre, found.normals)])
    return [-derivatives @ deviation for deviation in placement.deviations()]
