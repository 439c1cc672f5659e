"""Measured displacement and strain beside those of a model: differences in units of their standard uncertainty."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import xarray as xr

from fringedic.datasets.quantities import MAP_DIMENSIONS
from fringedic.datasets.signals import signal_names
from fringedic.errors import ModelError
from fringedic.evaluation.motion import in_space
from fringedic.models.agreement import AGREEMENT, Agreement, assess, assess_curve
from fringedic.models.levelling import Levelling, levelling_of
from fringedic.models.model import Model
from fringedic.models.observed import FEATURE_CHECKS, Edge, Features, Pair, place_on_step, placement_text
from fringedic.models.placement import Placement
from fringedic.models.rendering import measure_rendered
from fringedic.models.rigid_motion import RIGID_MOTION, RigidMotion, fit_rigid_motion
from fringedic.models.sampling import facing, sample
from fringedic.models.sensitivity import Sensitivity, image_jacobian, surface_gradient, tangent_components
from fringedic.models.shift import SHIFT, Shift, estimate_shift, fit_changes
from fringedic.surface.strain_measures import GREEN_LAGRANGE, strain_attributes
from fringedic.wording.arguments import (
    array,
    check_arguments,
    dataset,
    number,
    of_type,
    optional,
    several,
    text,
    whole,
)

_POSITION, _DISPLACEMENT = ("x", "y", "z"), ("u", "v", "w")
_STRAINS = (("e_11", "e_22", "e_12"), ("e_xx", "e_yy", "e_xy"))
_DISPLACEMENT_ITERATIONS = 4
_FITTED_POINTS = 100_000  # of the fit by displacement
_THREADS = 2  # each needs the memory of one set of maps
KEPT = (
    *("experiment", "software", "commit", "parameters", "calibration", "facts", "pixel_size"),
    *strain_attributes(GREEN_LAGRANGE),
)


class _Fields(NamedTuple):
    """Maps of the compared quantities (quantity, row, column), with their names."""

    names: tuple[str, ...]
    values: np.ndarray


def _load_of_each_step(value: object) -> dict[int, float]:
    if not isinstance(value, Mapping):
        raise ValueError("a load for each step by its number, such as {1: 250.0}")
    return {whole()(step): number()(load) for step, load in value.items()}


@check_arguments(
    ModelError,
    experiment=dataset(over=("step", "row", "column")),
    model=of_type(Model),
    reference_image=optional(array(2)),
    **FEATURE_CHECKS,
    steps=optional(several(whole(), least=1)),
    by=text,
    load_table=optional(_load_of_each_step),
)
def compare_model(  # noqa: PLR0913 (options of a public function, all by keyword)
    experiment: xr.Dataset,
    model: Model,
    *,
    pairs: Sequence[Pair] = (),
    pair_sigma: float | None = None,
    holes: Sequence[Pair] = (),
    edges: Sequence[Edge] = (),
    principal_axes: bool = False,
    by_displacement: bool = False,
    remove_rigid_motion: bool = False,
    reference_image: np.ndarray | None = None,
    steps: Iterable[int] | None = None,
    by: str = "force",
    load_table: Mapping[int, float] | None = None,
) -> xr.Dataset:
    """Compare the measured displacement and strain of each step with those of a model.

    The model is aligned with the measured reference surface (`place_model`), its displacement since the load of the
    reference step is interpolated at the load of each step, sampled at the measured points, and filtered as the
    measurement filters that of the surface. The variance of the difference is that of the measurement plus that of the
    alignment: the change of the model's fields when it moves by the six errors of its placement.

    Parameters
    ----------
    experiment
        From `fringedic.open_experiment`, with uncertainties; images alone need a scale.
    model
        From `read_model`, with displacement.
    pairs
        Points ((column, row), (x, y, z)): where they are in the reference image [px], and in the model [m]. Three or
        more are the coarse start. The placement in directions that neither the shape nor features determine counts as
        exact.
    pair_sigma
        Standard uncertainty of each coordinate of a pair [m]; by default one point spacing, as for clicked points.
    holes
        Round holes ((column, row), (x, y, z)): a pixel in the hole, and the centre of the hole in the model [m]. The
        centre in space is that of a circle through the points around the hole.
    edges
        Straight edges (((column, row), (column, row)), ((x, y, z), (x, y, z))): two pixels on the edge, and any two
        points of it in the model.
    principal_axes
        Without three pairs: the principal axes of model and surface are the same, see `place_model`; by default the
        model is in the rig frame already.
    by_displacement
        Move the model in directions that remain so that its displacement at the last step fits best. It hides a feature
        in the wrong place.
    remove_rigid_motion
        Take the rigid motion that fits measured minus model best away from the measured displacement: a machine or a
        holder that moves is not in the model.
    reference_image
        Image (row, column) of the reference step without fringes, NaN beside the surface. With it the model's in-plane
        displacement is rendered with the texture of the surface and measured as the test was (full levelling), instead
        of filtered.
    steps
        Numbers of the steps; by default all with a displacement and a load within those of the model.
    by
        Which signal the loads of the model are values of, in its unit: ``"force"`` [N], ``"position"`` of the
        crosshead [m], or another one of the dataset.
    load_table
        Load of the model for each step by number, instead of the recorded value.

    Returns
    -------
    Dataset
        Over (step, row, column), float32, for u, v, w [m] and the strain components [1]: the measured map with
        ``sigma_``, ``model_``, ``difference_`` (measured minus model), ``sigma_difference_`` and ``normalized_``, the
        difference over its standard uncertainty. ``x``, ``y``, ``z`` and ``distance`` of the reference surface from the
        model along z [m]. Over (step, quantity) the values of `fringedic.models.agreement`; over step those of
        `fringedic.models.shift` and `fringedic.models.rigid_motion`, the ``load_of_model`` and the
        ``load_of_reference``. Over quantity those of all steps together, ``curve_factor`` and others.
        The attribute ``placement`` (JSON) contains the rigid transformation with its standard uncertainties,
        ``left_out`` (JSON) the loads of the model and of the displaced steps outside them, which are not compared, and
        ``rigid_motion`` whether it was removed.

    Raises
    ------
    ModelError
        The model has no displacement or does not cover the load of any step, the dataset has no displacement,
        uncertainty or load, or as of `place_model`.

    Examples
    --------
    >>> experiment = fringedic.open_experiment("recordings/plate-7/bag")  # doctest: +SKIP
    >>> model = read_model("plate.vtu", unit="mm", loads=[1000.0])  # doctest: +SKIP
    >>> comparison = compare_model(experiment, model)  # doctest: +SKIP
    >>> float(comparison.within_2_sigma.sel(step=3, quantity="u"))  # doctest: +SKIP
    0.951
    """
    if not len(model.loads):
        raise ModelError(f"{model.name}: has no displacement; export it at the nodes, or name its field(s)")
    levelling = levelling_of(experiment)
    if reference_image is not None:
        _require_image(reference_image, experiment)
    of_step = _loads(experiment, model, by, load_table)
    chosen, left_out = _choose(experiment, model, of_step, steps)
    features = Features(pairs, pair_sigma, holes, edges, principal_axes)
    placement: Placement | None = None
    compared: list[xr.Dataset] = []
    for number_of_step in chosen:
        step = in_space(experiment.sel(step=number_of_step)).transpose(..., "row", "column", missing_dims="ignore")
        _require_maps(step)
        loads_of_step = _load_range(step, of_step)
        if placement is None:
            placement = place_on_step(step, _POSITION, model, features, loads_of_step[0])
            if by_displacement:
                last = in_space(experiment.sel(step=chosen[-1])).transpose(..., "row", "column", missing_dims="ignore")
                _require_maps(last)
                placement = _Comparison(
                    last, model, placement, levelling, _load_range(last, of_step)
                ).placed_by_displacement()
        comparison = _Comparison(step, model, placement, levelling, loads_of_step, reference_image, remove_rigid_motion)
        compared.append(comparison.result().assign_coords(step=number_of_step))
    assert placement is not None
    joined = xr.concat(compared, "step", coords="minimal", compat="override", join="override")
    joined = joined.merge(assess_curve(joined))
    kept = {name: experiment.attrs[name] for name in KEPT if name in experiment.attrs}
    return joined.assign_attrs(
        **kept,
        model=model.name,
        load=by,
        placement=placement_text(placement),
        left_out=json.dumps({"model": model.loads[[0, -1]].tolist(), "steps": left_out}),
        rigid_motion="removed" if remove_rigid_motion else "contained",
    )


def _loads(experiment: xr.Dataset, model: Model, by: str, load_table: Mapping[int, float] | None) -> dict[int, float]:
    """Return the load of each step that has one."""
    if load_table is not None:
        return dict(load_table)
    if by not in experiment or experiment[by].dtype.kind != "f" or not np.isfinite(experiment[by].values).any():
        raise ModelError(
            f"the dataset has no {by}, by which the load steps of {model.name} are found: give the load of each step "
            "(--load-table; in Python load_table={1: 250.0})"
        )
    values = zip(experiment["step"].values.tolist(), experiment[by].values.tolist(), strict=True)
    return {step: value for step, value in values if np.isfinite(value)}


def _load_range(step: xr.Dataset, of_step: Mapping[int, float]) -> tuple[float, float]:
    """Return the loads between which a step was displaced: that of its reference step, 0 if not known, and its own."""
    return of_step.get(int(step["reference_step"]), 0.0), of_step[int(step["step"])]


def _choose(
    experiment: xr.Dataset, model: Model, of_step: Mapping[int, float], steps: Iterable[int] | None
) -> tuple[list[int], dict[int, float]]:
    """Return the steps to compare, displaced with a load within those of the model, and the loads of the others."""
    references = dict(
        zip(experiment["step"].values.tolist(), experiment["reference_step"].values.tolist(), strict=True)
    )
    wanted = list(references) if steps is None else list(steps)
    displaced = [step for step in wanted if references.get(step, -1) not in (-1, step) and step in of_step]
    if not displaced:
        raise ModelError(f"none of the steps {wanted} has both a displacement and a load; choose other steps")
    covered = [step for step in displaced if model.covers(of_step[step])]
    if not covered or (steps is not None and len(covered) < len(wanted)):
        first, last = (extreme(of_step[step] for step in displaced) for extreme in (min, max))
        raise ModelError(
            f"{model.name}: its loads, {model.loads[0]:g} to {model.loads[-1]:g}, and those of the steps, {first:g} to "
            f"{last:g}, do not overlap: check the unit (N, m) and the sign, compute further load steps, or "
            "choose steps (--step)"
        )
    return covered, {step: of_step[step] for step in displaced if step not in covered}


def _require_image(image: np.ndarray, experiment: xr.Dataset) -> None:
    last = int(experiment["row"][-1]), int(experiment["column"][-1])
    if image.shape[0] <= last[0] or image.shape[1] <= last[1]:
        raise ModelError(
            f"the reference image has {image.shape[1]}x{image.shape[0]} px, the last measured point is at column "
            f"{last[1]}, row {last[0]}: give the image that the test was measured with"
        )


def _require_maps(step: xr.Dataset) -> None:
    needed = (*_POSITION, *_DISPLACEMENT, "sigma_u", "sigma_v")
    missing = [name for name in needed if name not in step or step[name].dtype.kind != "f"]
    if missing:
        raise ModelError(
            f"step {int(step.step)} has no {', '.join(missing)}: a comparison needs positions, displacement and their "
            "uncertainty in metres; images alone need a scale (--pixel-size-mm)"
        )


class _Comparison:
    """One step beside the model at its load."""

    def __init__(
        self,
        step: xr.Dataset,
        model: Model,
        placement: Placement,
        levelling: Levelling,
        loads: tuple[float, float],
        image: np.ndarray | None = None,
        remove_rigid_motion: bool = False,
    ) -> None:
        self._image = image
        self._step, self._placement, self._levelling, self._loads = step, placement, levelling, loads
        self._positions = np.stack([step[name].values.astype(float) for name in _POSITION])
        self._known = np.isfinite(self._positions).all(axis=0) & np.isfinite(step["u"].values)
        before, after = (model.displacement_at(load) for load in loads)
        self._nodes, self._motion, self._model = model.nodes + before, after - before, model
        self._remove_rigid_motion = remove_rigid_motion
        self._nodal_strain = model.strain_at(loads[1]) - model.strain_at(loads[0]) if len(model.strain) else None

    def result(self) -> xr.Dataset:
        """Return the maps of the step and its agreement."""
        measured, sigma = self._measured()
        sampled, height, strain = self._sample()
        levelled = self._level(sampled)
        modelled = self._fields(levelled, strain)
        spatial = [place for place, name in enumerate(measured.names) if name in _DISPLACEMENT]
        axes = [_DISPLACEMENT.index(measured.names[place]) for place in spatial]
        displacement = np.stack([self._step[name].values.astype(float) for name in _DISPLACEMENT])
        rigid = fit_rigid_motion(self._positions, axes, displacement, modelled.values[spatial], sigma.values[spatial])
        if self._remove_rigid_motion:
            measured.values[spatial] = rigid.removed(self._positions, displacement)[axes]
        moved = self._changes(levelled, height)
        deviation = np.sqrt(sum((change**2 for change in moved), sigma.values**2))
        difference = measured.values - modelled.values
        maps: dict[str, np.ndarray] = dict(zip(_POSITION, self._positions, strict=True))
        maps["distance"] = self._positions[2] - height
        for place, name in enumerate(measured.names):
            maps[name], maps[f"sigma_{name}"] = measured.values[place], sigma.values[place]
            maps[f"model_{name}"], maps[f"difference_{name}"] = modelled.values[place], difference[place]
            maps[f"sigma_difference_{name}"] = deviation[place]
            maps[f"normalized_{name}"] = difference[place] / deviation[place]

        def agreement(place: int) -> Agreement:
            changes = [each[place] for each in moved]
            return assess(measured.values[place], sigma.values[place], modelled.values[place], changes)

        with ThreadPoolExecutor(_THREADS) as pool:
            agreements = list(pool.map(agreement, range(len(measured.names))))
        fields = (modelled.values[spatial], difference[spatial], sigma.values[spatial])
        return self._dataset(maps, measured.names, agreements, estimate_shift(self._positions, axes, *fields), rigid)

    def placed_by_displacement(self) -> Placement:
        """Return the placement whose undetermined motions fit the displacement best (Gauss-Newton)."""
        placement, covariance = self._placement, self._placement.covariance
        free = placement.undetermined
        measured, sigma = (np.stack(self._spatial_measured(prefix)) for prefix in ("", "sigma_"))
        axes = [axis for axis, name in enumerate(_DISPLACEMENT) if f"sigma_{name}" in self._step]
        thin = (..., slice(None, None, self._thinning()), slice(None, None, self._thinning()))
        for _ in range(_DISPLACEMENT_ITERATIONS if free.size else 0):
            sampled, height, _ = self._sample()
            modelled = self._level(sampled)
            positions = np.stack([*self._positions[:2], height])
            sensitivity = Sensitivity(positions, modelled, placement.centre)
            changes = np.stack([sensitivity.displacement(motion)[axes][thin] for motion in free.T]).astype(float)
            maps = [each[thin].astype(float) for each in (modelled[axes], measured - modelled[axes], sigma)]
            found = fit_changes(changes, positions[thin], axes, *maps)
            if found is None:
                raise ModelError(
                    f"{self._model.name}: the displacement of step {int(self._step.step)} does not determine the "
                    "placement; give point pairs, holes or edges"
                )
            self._placement = self._placement.moved(free @ found[0])
            covariance = placement.covariance + free @ found[1] @ free.T
        if free.size:
            self._placement = replace(self._placement, covariance=covariance, undetermined=np.empty((6, 0)))
        return self._placement

    def _level(self, sampled: np.ndarray) -> np.ndarray:
        """Return a displacement of the model (3, row, column) as it would be measured.

        With a reference image the in-plane error that its rendered displacement shows is added, by the derivative of
        the position by the pixel. A displacement along the line of sight moves nothing in the image.
        """
        if self._image is None:
            return self._levelling.displacement(sampled)
        *_, w = self._levelling.displacement(sampled)
        calibration = json.loads(self._step.attrs.get("calibration", "null")) or {}
        away = float(calibration.get("camera_distance", math.inf)) - self._positions[2]
        seen = sampled[:2] + sampled[2] * self._positions[:2] / away
        spacing = self._levelling.spacing
        jacobian = np.moveaxis(image_jacobian(self._positions), (0, 1), (-2, -1)) / spacing
        known = np.isfinite(jacobian).all(axis=(-2, -1)) & np.isfinite(seen).all(axis=0)
        moved = np.full((2, *known.shape), np.nan)
        moved[:, known] = np.linalg.solve(jacobian[known], seen[:, known].T[..., np.newaxis])[..., 0].T
        points = self._step["row"].values, self._step["column"].values
        found = measure_rendered(
            self._image, points, moved, window=self._levelling.window, method=self._levelling.method
        )
        error = np.einsum("rcij,jrc->irc", jacobian, found - moved)
        return np.stack([*(sampled[:2] + error), w]).astype(np.float32)

    def _thinning(self) -> int:
        return max(1, math.ceil(math.sqrt(self._positions[0].size / _FITTED_POINTS)))

    def _spatial_measured(self, prefix: str) -> list[np.ndarray]:
        names = [name for name in _DISPLACEMENT if f"sigma_{name}" in self._step]
        return [self._step[f"{prefix}{name}"].values.astype(np.float32) for name in names]

    def _changes(self, displacement: np.ndarray, height: np.ndarray) -> list[np.ndarray]:
        """Return the change of the fields by each independent error of the placement, one standard deviation each."""
        sensitivity = Sensitivity(np.stack([*self._positions[:2], height]), displacement, self._placement.centre)

        def change(deviation: np.ndarray) -> np.ndarray:
            moved = sensitivity.displacement(deviation)
            strain = sensitivity.strain(moved) if self._strain_names() else ()
            return np.stack([*self._spatial(moved), *strain])

        with ThreadPoolExecutor(_THREADS) as pool:
            return list(pool.map(change, self._placement.deviations()))

    def _measured(self) -> tuple[_Fields, _Fields]:
        names = [*(name for name in _DISPLACEMENT if f"sigma_{name}" in self._step), *self._strain_names()]
        values, sigmas = (
            np.stack([self._step[f"{prefix}{name}"].values.astype(np.float32) for name in names])
            for prefix in ("", "sigma_")
        )
        return _Fields(tuple(names), values), _Fields(tuple(names), sigmas)

    def _strain_names(self) -> tuple[str, ...]:
        for names in _STRAINS:
            if self._levelling.strain_window and all(f"sigma_{name}" in self._step for name in names):
                return names
        return ()

    def _sample(self) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Return displacement (3, row, column), z and nodal strain of the model in the rig frame at the points."""
        nodes = self._placement.apply(self._nodes)
        triangles = facing(nodes, self._model.triangles) if self._model.closed else self._model.triangles
        samples = sample(nodes, triangles, self._positions[:, self._known].T)
        values = [self._motion @ self._placement.rotation.T, nodes[:, 2:]]
        if self._nodal_strain is not None:
            values.append(_turn_tensors(self._nodal_strain, self._placement.rotation))
        together = np.hstack(values)
        maps = np.full((together.shape[1], *self._known.shape), np.nan, np.float32)
        maps[:, self._known] = samples.interpolate(together).T
        if self._nodal_strain is None:
            return maps[:3], maps[3], None
        slopes = surface_gradient(np.stack([*self._positions[:2], maps[3]]), maps[3])
        return maps[:3], maps[3], tangent_components(_metric(maps[4:], *slopes), *slopes)

    def _fields(self, displacement: np.ndarray, nodal_strain: np.ndarray | None) -> _Fields:
        """Return the compared quantities of a filtered displacement and perhaps nodal strain (3, row, column)."""
        strains: tuple[str, ...] = self._strain_names()
        found: Iterable[np.ndarray] = ()
        if strains and nodal_strain is not None:
            found = self._levelling.nodal_strain(nodal_strain)
        elif strains:
            found = self._levelling.strain(self._positions, displacement, self._step)
        names = [name for name in _DISPLACEMENT if f"sigma_{name}" in self._step]
        return _Fields((*names, *strains), np.stack([*self._spatial(displacement), *found]))

    def _spatial(self, displacement: np.ndarray) -> list[np.ndarray]:
        """Return the components of a displacement (3, row, column) that are compared."""
        return [
            values for name, values in zip(_DISPLACEMENT, displacement, strict=True) if f"sigma_{name}" in self._step
        ]

    def _dataset(
        self,
        maps: Mapping[str, np.ndarray],
        names: tuple[str, ...],
        agreements: Sequence[Agreement],
        shift: Shift,
        rigid: RigidMotion,
    ) -> xr.Dataset:
        shape = MAP_DIMENSIONS[1:]
        fields: dict[str, object] = {}
        for name, values in maps.items():
            strain = re.search("(^|_)e_", name) is not None
            units = "sigma" if name.startswith("normalized") else "1" if strain else "m"
            fields[name] = (shape, values.astype(np.float32), {"units": units})
        for name, (units, long_name) in AGREEMENT.items():
            values = np.array([getattr(each, name) for each in agreements], float)
            fields[name] = ("quantity", values, {"units": units, "long_name": long_name})
        for name, long_name in SHIFT.items():
            fields[name] = ((), getattr(shift, name), {"units": "m", "long_name": long_name})
        for (name, (units, long_name)), value in zip(RIGID_MOTION.items(), rigid.parts, strict=True):
            fields[name] = ((), value, {"units": units, "long_name": long_name})
        fields["load_of_reference"] = ((), self._loads[0], {"long_name": "load of the model at the reference step"})
        fields["load_of_model"] = ((), self._loads[1], {"long_name": "load that the model was interpolated at"})
        for name in (*signal_names(self._step), "reference_step", "time"):
            if name in self._step:
                fields[name] = self._step[name].variable
        coordinates = {
            name: self._step[name] for name in ("row", "column", "x_mm", "y_mm") if name in self._step.coords
        }
        return xr.Dataset(fields, {**coordinates, "quantity": list(names)})


def _turn_tensors(tensors: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return symmetric tensors (node, 6), in the order xx, yy, zz, xy, yz, xz, in a rotated frame."""
    xx, yy, zz, xy, yz, xz = tensors.T
    full = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    turned = np.einsum("ij,jkn,lk->iln", rotation, full, rotation)
    return np.stack([turned[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))], axis=-1)


def _metric(strain: np.ndarray, z_x: np.ndarray, z_y: np.ndarray) -> np.ndarray:
    """Return A_x . E A_x, A_y . E A_y and A_x . E A_y of tensors (6, row, column), as of `tangent_components`."""
    xx, yy, zz, xy, yz, xz = strain
    return np.stack(
        [xx + 2 * z_x * xz + z_x**2 * zz, yy + 2 * z_y * yz + z_y**2 * zz, xy + z_y * xz + z_x * yz + z_x * z_y * zz]
    )
