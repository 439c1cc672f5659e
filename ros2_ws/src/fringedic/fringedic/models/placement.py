"""Alignment of a model with the measured surface: a rigid transformation with its covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fringedic.errors import ModelError
from fringedic.evaluation.correlated import correlated_points
from fringedic.models.model import Model
from fringedic.models.sampling import distances, facing, node_normals

_MOST_POINTS = 20_000  # of the measured surface; more do not change the result within its uncertainty
_ITERATIONS = 50
_MIRROR_ITERATIONS = 8  # a mirrored model that fits converges in a few; others need no exact residual
_TUKEY = 4.685  # width of the biweight in standard deviations: 95 % efficiency for normal errors
_SMALLEST_SCALE = 1e-7  # computed data leave this residual over the size of the surface
_TURNING = 0.1  # a free motion with a larger singular value contains a rotation
_SINGULAR = 1e-5  # with a smaller ratio of eigenvalues a direction is not determined, whatever the noise
_FEWEST = 50  # the surface needs so many points
_FEWEST_PAIRS = 3  # so many pairs determine a position
_UNDETERMINED = 1e-3  # information [1/spacing^2] below which pairs and shape determine no motion
_TURN_STEP = 30  # [degree] between starts of a surface that is as long as wide
_ROUND = 0.8  # ratio of its two longer axes from which their directions are uncertain
_COVERED = 0.9  # an alternative has at least this part of the points of the best placement on the model
_AS_GOOD = 1.3  # an alternative has at most this residual over that of the best placement
_SAME_TURN = 0.05  # [rad]
_MISFIT = 10.0  # a clicked point fits within so many of its standard deviations
_MIRRORED = 0.3  # a model is mirrored if its mirror image leaves less than this part of its residual
_SHAPES = {  # number of free translations and rotations (slippage analysis)
    (2, 1): "a plane",
    (1, 1): "a cylinder",
    (0, 3): "a sphere",
    (0, 1): "a surface of revolution",
    (1, 0): "an extruded profile",
}


class PointPair(NamedTuple):
    """A point on the measured surface and the same point of the model, both [m].

    Attributes
    ----------
    measured
        (x, y, z) in the rig frame.
    model
        (x, y, z) in the frame of the model.
    sigma
        Standard deviation of each coordinate [m]; None for that of clicked points.
    along
        Direction of a straight edge in the frame of the model: both points lie on the edge, and are the same only
        across it. None for one point.
    """

    measured: tuple[float, float, float]
    model: tuple[float, float, float]
    sigma: float | None = None
    along: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class FreeDirections:
    """Motions of the model that the shape does not determine.

    Attributes
    ----------
    shape
        What the surface resembles, such as ``a plane``.
    translations, rotations
        Unit vectors in the rig frame: directions of free translations, axes of free rotations.
    """

    shape: str
    translations: tuple[tuple[float, float, float], ...]
    rotations: tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Placement:
    """Where a model is in the rig frame: X = rotation x + translation.

    Attributes
    ----------
    rotation : (3, 3)
        Of the frame of the model.
    translation : (3,)
        In the rig frame [m].
    centre : (3,)
        Point of the rig frame that errors of the rotation turn about [m].
    covariance : (6, 6)
        Of the errors of translation [m] and rotation vector [rad] about the centre. It is 0 for directions that neither
        the shape nor point pairs determine: the model stays there where it was given.
    residual
        Robust standard deviation of the distances between measured points and model [m].
    used
        Number of measured points that lie on the model.
    free
        What the shape does not determine; None if it determines everything.
    undetermined : (6, number)
        Motions (translation, rotation about the centre) that neither the shape nor point pairs determine.
    alternatives
        Number of other orientations, of those by principal axes, that fit the surface as well.
    """

    rotation: np.ndarray
    translation: np.ndarray
    centre: np.ndarray
    covariance: np.ndarray
    residual: float = 0.0
    used: int = 0
    free: FreeDirections | None = None
    undetermined: np.ndarray = field(default_factory=lambda: np.empty((6, 0)))
    alternatives: int = 0

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Return points (point, 3) of the model in the rig frame [m]."""
        return np.asarray(points @ self.rotation.T + self.translation)

    def moved(self, motion: np.ndarray) -> Placement:
        """Return the placement after a further translation [m] and rotation [rad] about the centre, shape (6,)."""
        turn = Rotation.from_rotvec(motion[3:]).as_matrix()
        shift = turn @ (self.translation - self.centre) + self.centre + motion[:3]
        return replace(self, rotation=turn @ self.rotation, translation=shift)

    def deviations(self) -> np.ndarray:
        """Return independent errors of one standard deviation (number, 6), whose products sum up to the covariance."""
        values, vectors = np.linalg.eigh(self.covariance)
        kept = values > 1e-12 * max(values.max(), 1e-30)
        return np.asarray((vectors[:, kept] * np.sqrt(values[kept])).T)


class Side(NamedTuple):
    """Triangles of a model that face the camera, and normals of its nodes (node, 3) in its own frame."""

    triangles: np.ndarray
    normals: np.ndarray


def seen_side(model: Model, placed: Placement) -> Side:
    """Return the side of a model that faces the camera.

    Raises
    ------
    ModelError
        No triangle faces the camera.
    """
    nodes = placed.apply(model.nodes)
    triangles = facing(nodes, model.triangles) if model.closed else model.triangles
    if not len(triangles):
        raise ModelError(f"{model.name}: no side of the model faces the camera; check the point pairs")
    return Side(triangles, node_normals(nodes, triangles) @ placed.rotation)


def place_model(
    surface: np.ndarray,
    model: Model,
    pairs: Sequence[PointPair] = (),
    *,
    spacing: float,
    pair_sigma: float | None = None,
    load: float | None = None,
    start: str = "given",
) -> Placement:
    """Align a model with a measured surface by point-to-plane least squares (Chen and Medioni 1992).

    The distances of measured points to the model along its normals, weighted by Tukey's biweight so that parts which
    only one of both contains have no influence, and the distances of the point pairs are minimised (Gauss-Newton).
    Their covariance is that of the residuals, with the correlation of neighbouring points.

    Parameters
    ----------
    surface : (3, row, column)
        Measured x, y, z [m] in the rig frame, NaN where not measured.
    model
        To be aligned.
    pairs
        They determine directions that the shape does not. Three or more that do not lie on a line are also the coarse
        start.
    spacing
        Distance of measured points [m]: standard deviation of a direction that counts as not determined.
    pair_sigma
        Standard deviation of each coordinate of a point pair [m]; by default `spacing`.
    load
        At which the surface was measured; by default without load.
    start
        Coarse position without three pairs: ``"given"``, the model is in the rig frame already, up to a few points, or
        ``"principal axes"``, those of model and surface are the same; of the orientations that this leaves the one with
        the least residual is taken, and others that fit as well are counted. Both have to show the same part.

    Returns
    -------
    Placement
        With its covariance.

    Raises
    ------
    ModelError
        The pairs do not fit together, the model misses the measured surface, or it is mirrored.

    References
    ----------
    Y. Chen, G. Medioni (1992), Object modelling by registration of multiple range images, Image and Vision Computing
    10, 145-155.
    N. Gelfand, L. Guibas (2004), Shape segmentation using local slippage analysis, Symposium on Geometry Processing.
    """
    nodes = model.nodes if load is None else model.nodes + model.displacement_at(load)
    step = max(1, int(np.ceil(np.sqrt(surface[0].size / _MOST_POINTS))))
    thinned = surface[:, ::step, ::step]
    alignment = _Alignment(thinned, replace(model, nodes=nodes), list(pairs), spacing, pair_sigma or spacing)
    placed = alignment.from_axes() if start == "principal axes" else alignment.run(alignment.start())
    mirror = alignment.mirrored(placed)
    if mirror < _MIRRORED * placed.residual:
        raise ModelError(
            f"{model.name}: mirrored, it fits the surface to {1e6 * mirror:.0f} µm, as it is to "
            f"{1e6 * placed.residual:.0f} µm: the mesh is mirrored or shows the other side; mirror it"
        )
    return placed


class _Fit(NamedTuple):
    """Residuals of the measured points (NaN beside the model) with derivatives and weights.

    `scale` is their robust standard deviation, `variance` its square times the number of correlated points.
    """

    residuals: np.ndarray
    derivatives: np.ndarray
    weights: np.ndarray
    scale: float
    variance: float


class _System(NamedTuple):
    """Normal equations at a placement: gradient, covariance of the solution, and what the shape leaves free."""

    fit: _Fit
    gradient: np.ndarray
    covariance: np.ndarray
    lengths: np.ndarray
    free: FreeDirections | None
    undetermined: np.ndarray


class _Alignment:
    """Gauss-Newton iterations of one model on one surface."""

    def __init__(
        self, surface: np.ndarray, model: Model, pairs: list[PointPair], spacing: float, pair_sigma: float
    ) -> None:
        self._shape = surface.shape[1:]
        self._points = surface.reshape(3, -1).T.astype(float)
        self._model, self._spacing, self._pair_sigma = model, spacing, pair_sigma
        self._pairs = np.array([pair[:2] for pair in pairs], float).reshape(-1, 2, 3)
        self._pair_sigmas = np.array([pair.sigma or pair_sigma for pair in pairs], float)
        self._along = np.array([pair.along or (0.0, 0.0, 0.0) for pair in pairs], float).reshape(-1, 3)
        measured = self._points[np.isfinite(self._points).all(axis=1)]
        if len(measured) < _FEWEST:
            raise ModelError(f"only {len(measured)} points of the surface are measured; choose another reference step")
        if not (spacing > 0 and np.ptp(measured[:, 0]) > 0 and np.ptp(measured[:, 1]) > 0):
            raise ModelError("the measured points lie on a line or at one place; choose another reference step")
        self._centre = measured.mean(axis=0)
        self._side = Side(np.empty((0, 3), np.int64), np.empty((0, 3)))
        self._length = float(np.sqrt(np.mean(np.sum((measured - self._centre) ** 2, axis=1))))

    def start(self) -> Placement:
        """Return the transformation of the point pairs (Kabsch 1976); without them that of a model in the rig frame."""
        zero = np.zeros((6, 6))
        measured, modelled = np.moveaxis(self._pairs[~self._along.any(axis=1)], 1, 0)
        if len(measured) < _FEWEST_PAIRS:
            return Placement(np.eye(3), np.zeros(3), self._centre, zero)
        spread = np.linalg.svd(modelled - modelled.mean(axis=0), compute_uv=False)
        if spread[1] < 2 * self._spacing:
            raise ModelError("the point pairs do not determine a position: give at least three that are not on a line")
        turn, _ = Rotation.align_vectors(measured - measured.mean(axis=0), modelled - modelled.mean(axis=0))
        rotation = turn.as_matrix()
        placed = Placement(rotation, measured.mean(axis=0) - rotation @ modelled.mean(axis=0), self._centre, zero)
        misfit = float(np.sqrt(np.mean(np.sum((placed.apply(modelled) - measured) ** 2, axis=1))))
        if misfit > _MISFIT * self._spacing:
            raise ModelError(
                f"{self._model.name}: the point pairs miss each other by {1e3 * misfit:.2f} mm: check their order and "
                "the unit of the mesh, and whether the mesh is mirrored"
            )
        return placed

    def from_axes(self) -> Placement:
        """Return the best placement of those that give surface and model the same principal axes."""
        measured = self._points[np.isfinite(self._points).all(axis=1)]
        axes, lengths = _principal_axes(measured)
        middle = self._model.nodes[self._model.triangles].mean(axis=1)  # triangles count with their areas
        first, second, third = (self._model.nodes[self._model.triangles[:, corner]] for corner in range(3))
        areas = np.linalg.norm(np.cross(second - first, third - first), axis=1)
        own, _ = _principal_axes(middle, areas)
        centre = np.average(middle, axis=0, weights=areas)
        turns = np.arange(0, 180, _TURN_STEP) if lengths[1] > _ROUND * lengths[0] else np.zeros(1)
        found = []
        for turn in Rotation.from_euler("z", turns[:, np.newaxis], degrees=True).as_matrix():
            for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
                rotation = axes @ np.diag(signs) @ turn @ own.T
                start = Placement(rotation, self._centre - rotation @ centre, self._centre, np.zeros((6, 6)))
                try:
                    found.append(self.run(start))
                except ModelError:  # misses the surface, or shows its other side
                    continue
        if not found:
            raise ModelError(
                f"{self._model.name}: does not fit the surface by their principal axes; both have to show the same "
                "part in the same unit: give three point pairs"
            )
        most = max(each.used for each in found)
        best = min((each for each in found if each.used > _COVERED * most), key=lambda each: each.residual)
        others: list[Placement] = []
        for each in found:
            as_good = each.used > _COVERED * best.used and each.residual < _AS_GOOD * best.residual
            if as_good and all(
                Rotation.from_matrix(each.rotation.T @ other.rotation).magnitude() > _SAME_TURN
                for other in (best, *others)
            ):
                others.append(each)
        return replace(best, alternatives=len(others))

    def run(self, placed: Placement) -> Placement:
        """Return the placement with the least residual, and its covariance.

        What the shape determines depends on the residual, which is known after a first fit.
        """
        placed, fit = self._iterate(placed, None)
        variance = fit.variance
        placed, _ = self._iterate(placed, variance)
        system = self._system(placed, variance)
        return replace(
            placed,
            covariance=system.covariance,
            residual=system.fit.scale,
            used=int(np.count_nonzero(np.isfinite(system.fit.residuals))),
            free=system.free,
            undetermined=system.undetermined,
        )

    def _iterate(self, placed: Placement, variance: float | None, most: int = _ITERATIONS) -> tuple[Placement, _Fit]:
        """Return the placement after Gauss-Newton steps, and the fit there."""
        self._side = seen_side(self._model, placed)
        for _ in range(most):
            system = self._system(placed, variance)
            step = system.covariance @ system.gradient
            placed = placed.moved(step)
            if np.abs(step * system.lengths).max() < 1e-4 * self._spacing:
                break
        return placed, self._fit(placed)

    def mirrored(self, placed: Placement) -> float:
        """Return the residual of the mirrored model, infinite where it misses the surface."""
        among = (
            self._pairs[:, 1] if len(self._pairs) else (self._centre - placed.translation)[np.newaxis] @ placed.rotation
        )
        centre = among.mean(axis=0)
        normal = np.linalg.svd(among - centre)[2][2] if len(among) > 2 else placed.rotation[2]
        nodes = self._model.nodes - 2 * np.outer((self._model.nodes - centre) @ normal, normal)
        other = replace(self._model, nodes=nodes, triangles=np.ascontiguousarray(self._model.triangles[:, ::-1]))
        alignment = _Alignment(self._points.T.reshape(3, *self._shape), other, [], self._spacing, self._pair_sigma)
        alignment._pairs, alignment._pair_sigmas, alignment._along = self._pairs, self._pair_sigmas, self._along
        try:
            return alignment._iterate(placed, None, _MIRROR_ITERATIONS)[1].scale
        except ModelError:
            return np.inf

    def _system(self, placed: Placement, variance: float | None) -> _System:
        """Return the normal equations of a Gauss-Newton step.

        The model moves by (t, r), a measured point at the distance d along the normal n of the model point q gives
        d - n . t - ((q - c) x n) . r, a pair with the difference e gives e - t - r x (m - c).
        """
        fit = self._fit(placed)
        lengths = np.array([1, 1, 1, *3 * [self._length]])  # rotations count as the displacement that they cause
        found = np.isfinite(fit.residuals)
        weighted = fit.derivatives[found] * (fit.weights[found] / (variance or fit.variance))[:, np.newaxis]
        information, gradient = weighted.T @ fit.derivatives[found], weighted.T @ fit.residuals[found]
        values, vectors = np.linalg.eigh(information / np.outer(lengths, lengths))
        free = values < _SINGULAR * values.max()
        if variance is not None:
            free |= values < 1 / self._spacing**2
        kept = vectors[:, ~free] / lengths[:, np.newaxis]
        covariance = (kept / values[~free]) @ kept.T
        undetermined = vectors[:, free]
        if len(self._pairs):
            along = self._along @ placed.rotation.T  # 0 for points
            apart = self._pairs[:, 0] - placed.apply(self._pairs[:, 1])
            apart -= along * np.sum(along * apart, axis=1, keepdims=True)  # from the nearest point of an edge
            rows = []
            for (x, y, z), direction in zip(self._pairs[:, 0] - apart - self._centre, along, strict=True):
                across = np.eye(3) - np.outer(direction, direction)
                rows.append(across @ np.hstack([np.eye(3), [[0, z, -y], [-z, 0, x], [y, -x, 0]]]))
            derivatives, differences = np.vstack(rows), np.concatenate(list(apart))
            sigmas = np.repeat(self._pair_sigmas, 3)
            information = information + (derivatives.T / sigmas**2) @ derivatives
            gradient = gradient + (derivatives.T / sigmas**2) @ differences
            totals, motions = np.linalg.eigh(information / np.outer(lengths, lengths))
            open_ = totals < _UNDETERMINED / self._spacing**2
            kept = motions[:, ~open_] / lengths[:, np.newaxis]
            covariance, undetermined = (kept / totals[~open_]) @ kept.T, motions[:, open_]
            if not open_.any():  # more exact where the shape is known much better than the pairs
                covariance = np.linalg.inv(information / np.outer(lengths, lengths)) / np.outer(lengths, lengths)
        directions = vectors[:, free]
        number = directions.shape[1]
        names = None
        if number:
            _, strength, mixing = np.linalg.svd(directions[3:])
            turning = int(np.count_nonzero(strength > _TURNING))
            motions = directions @ mixing.T
            rotations, translations = motions[3:, :turning], motions[:3, turning:]
            names = FreeDirections(
                _SHAPES.get((number - turning, turning), "a surface with symmetry"),
                _unit(translations),
                _unit(rotations),
            )
        return _System(fit, gradient, covariance, lengths, names, undetermined / lengths[:, np.newaxis])

    def _fit(self, placed: Placement) -> _Fit:
        nodes = placed.apply(self._model.nodes)
        found = distances(nodes, self._side.triangles, self._side.normals @ placed.rotation.T, self._points)
        residuals = found.along_normal
        known = residuals[np.isfinite(residuals)]
        if len(known) < _FEWEST:
            raise ModelError(
                f"{self._model.name}: misses the measured surface, {len(known)} of its points lie on the "
                "model: check the unit of the mesh, and give point pairs"
            )
        derivatives = np.hstack([found.normals, np.cross(found.foot - self._centre, found.normals)])
        scale = max(1.4826 * float(np.median(np.abs(known))), _SMALLEST_SCALE * self._length)
        weights = np.clip(1 - (residuals / (_TUKEY * scale)) ** 2, 0, None) ** 2
        kept = np.where(weights > 0, residuals, np.nan).reshape(self._shape)
        return _Fit(residuals, derivatives, weights, scale, scale**2 * correlated_points(kept))


def _unit(vectors: np.ndarray) -> tuple[tuple[float, float, float], ...]:
    """Return unit vectors of columns (3, number) whose largest component is positive."""
    columns = (column / np.linalg.norm(column) * np.sign(column[np.argmax(np.abs(column))]) for column in vectors.T)
    return tuple((float(x), float(y), float(z)) for x, y, z in columns)


def _principal_axes(points: np.ndarray, weights: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return right-handed principal axes (3, axis) of points and their standard deviations, longest first."""
    offsets = points - np.average(points, axis=0, weights=weights)
    values, vectors = np.linalg.eigh(np.cov(offsets.T, aweights=weights))
    axes = vectors[:, ::-1]
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return axes, np.sqrt(np.clip(values[::-1], 0, None))
