"""The printed grid on the turned plane: where the camera's pin-hole stands.

One picture of a plane tells where every line of sight meets that plane, and not from where it comes: a camera that is
tilted and a lens whose elements are off their axis bend the picture alike. Seen once more with the plane turned to
either side, every line of sight is known at a second and a third point, and all of them meet in the pin-hole.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fringedic.camera.carriers import find_carriers
from fringedic.camera.demodulation import grid_phases
from fringedic.camera.distortion import DistortionMap
from fringedic.camera.grid import OUTLIER, OVERLAP, GridMeasurement, checked_grid
from fringedic.camera.homography import apply_homography, fit_homography
from fringedic.camera.plane_view import PinHole, PlaneView
from fringedic.errors import GridAngleError, ShapeMismatchError
from fringedic.sequence import Orientation

SMALLEST_TURN = math.radians(2.0)  # to either side: less tells the pin-hole's place no better than a ruler
_BLOCKS = (12, 16)
_LEAST_POINTS = 3  # of a block
_ALIKE = 2.0  # factor between the distances of the pin-hole that single pictures tell
_SUSPICIOUS = 3.0  # chi square per degree of freedom from which pictures contradict each other
_ANY_ANGLE = math.radians(10)  # errors of angles that are looked for then
_WRONG_ANGLE, _WRONG = math.radians(0.5), 0.5  # error of an angle, and rms [px], before the pictures are refused
_ROUNDS = 3  # tilts of a degree settle to rounding errors in two
_AXIS_ANGLE, _TURN, _VIEW = 1e-2, 1e-3, 1e-5  # [rad] how far these may sensibly change at once
_VIEW_ERRORS, _ANGLES = 7, 15  # where these begin among the parameters


@dataclass(frozen=True, eq=False)
class TurnedGrid:
    """What one picture of the grid on the turned plane shows, as means over blocks of the image.

    Attributes
    ----------
    angle
        Of the plane [rad]; above 0 the +x side is nearer to the camera (with horizontal fringes, the +y side).
    pixels : (blocks, 2)
        Ideal column and row of the blocks [px].
    grid : (blocks, 2)
        Point of the grid seen there [m]: x to the right and y upwards along the lines, from any of their crossings.
    sigma : (blocks,)
        Standard deviation of each component of `grid` [m].
    residual
        Root mean square of what a homography leaves of the blocks [px]: the lens is that of the plane at 0 degree.
    """

    angle: float
    pixels: np.ndarray
    grid: np.ndarray
    sigma: np.ndarray
    residual: float


def measure_turned_grid(
    image: ArrayLike, grid: GridMeasurement, angle: float, *, mask: ArrayLike | None = None
) -> TurnedGrid:
    """Find the grid in a picture of the turned plane.

    Parameters
    ----------
    image : (row, column)
        As for `fringedic.measure_distortion`.
    grid
        What the picture at angle 0 told, through the same lens.
    angle
        Of the plane [rad].
    mask : (row, column) bool
        False where the image shall not be used.

    Raises
    ------
    GridError
        When the picture does not show the grid well enough.
    ImageSizeError, ShapeMismatchError
        When the image or the mask has another size.
    """
    values, usable, _ = checked_grid(image, mask)
    if values.shape != (grid.distortion.height, grid.distortion.width):
        raise ShapeMismatchError(
            f"grid on the turned plane: {values.shape[1]} x {values.shape[0]} px, at 0 degree "
            f"{grid.distortion.width} x {grid.distortion.height} px"
        )
    found = grid_phases(values, usable, find_carriers(np.where(usable, values, np.mean(values[usable]))))
    seen, weights = np.stack(grid.distortion.ideal(*found.points.T), axis=1), found.weights
    points = grid.pitch * found.phases / (2 * np.pi) * (1, -1)
    size = np.abs(points - apply_homography(fit_homography(seen, points, weights), seen)).max(axis=1)
    kept = size <= OUTLIER * 1.4826 * np.median(size)
    return _in_blocks(seen[kept], points[kept], weights[kept], values.shape, angle, grid.plane.pixel_size)


def _in_blocks(
    seen: np.ndarray,
    points: np.ndarray,
    weights: np.ndarray,
    shape: tuple[int, int],
    angle: float,
    pixel_size: float,
) -> TurnedGrid:
    to_grid = fit_homography(seen, points, weights)
    left = points - apply_homography(to_grid, seen)
    scatter = float(np.sqrt(np.average(np.mean(left**2, axis=1), weights=weights)))
    row, column = ((seen[:, 1 - k] * n / shape[k]).astype(int).clip(0, n - 1) for k, n in enumerate(_BLOCKS))
    block, cells = row * _BLOCKS[1] + column, math.prod(_BLOCKS)
    used = np.bincount(block, minlength=cells) >= _LEAST_POINTS
    total = np.bincount(block, weights, cells)[used]
    centres, means = (
        np.stack([np.bincount(block, weights * each[:, k], cells)[used] / total for k in (0, 1)], axis=1)
        for each in (seen, left)
    )
    return TurnedGrid(
        angle=angle,
        pixels=centres,
        grid=apply_homography(to_grid, centres) + means,
        sigma=OVERLAP * scatter / np.sqrt(total),
        residual=float(np.sqrt(np.mean(np.sum(means**2, axis=1)))) / pixel_size,
    )


def locate_pin_hole(
    grid: GridMeasurement,
    turned: Sequence[TurnedGrid],
    *,
    sigma_angle: float = 0.0,
    orientation: Orientation = Orientation.VERTICAL,
) -> GridMeasurement:
    """Return the measurement of a grid with the camera's pin-hole where its lines of sight meet.

    Unknown are the pin-hole and the axis that the plane turns about (position and direction); how the grid lies on the
    plane does not matter. Least squares of the distances on the grid, each divided by its standard deviation. The
    perspective that belongs to the pin-hole then goes into the view of the plane and what is left of it into the
    distortion; where lines of sight meet the plane stays as measured.

    Parameters
    ----------
    grid
        Of the plane at angle 0.
    turned
        Of the turned plane, on both sides of 0. At the same angle on either side the noise of the picture at 0, which
        both share, does not reach the pin-hole.
    sigma_angle
        Standard deviation of the errors of single angles [rad].
    orientation
        Of the fringes, along which the axis runs.

    Returns
    -------
    GridMeasurement
        With `PlaneView.pin_hole`; its covariance is that of the noise, or more where the pictures contradict each other
        by more than noise.

    Raises
    ------
    GridAngleError
        When angles are on one side only or have the wrong sign, or the pictures contradict each other.
    """
    distance = _rough_distance(grid.plane, turned, orientation)
    values, covariance, contradiction, left = _Bundle(grid, tuple(turned), orientation, sigma_angle).fit(distance)
    warnings = list(grid.warnings)
    if contradiction > _SUSPICIOUS:
        errors = _Bundle(grid, tuple(turned), orientation, max(sigma_angle, _ANY_ANGLE)).fit(distance)[0][_ANGLES:]
        named = " and ".join(f"{math.degrees(each.angle):+g}" for each in turned)
        seems = " and ".join(
            f"{math.degrees(each.angle + error):+.2f}" for each, error in zip(turned, errors, strict=True)
        )
        text = (
            f"the grids at {named} degree contradict each other by {max(left):.3f} px, as if the plane had stood at "
            f"{seems} degree: were these the angles, is the sheet flat, and did it stay where it was?"
        )
        if np.abs(errors).max() > _WRONG_ANGLE or not max(left) < _WRONG:
            raise GridAngleError(text)
        warnings.append(f"{text} Say how exact the stage is by sigma_angle_degree, if it was only that.")
    distortion, plane = _with_pin_hole(grid, values[:3], max(1.0, contradiction) * covariance[:3, :3])
    return dataclasses.replace(grid, distortion=distortion, plane=plane, warnings=tuple(warnings))


def _rough_distance(plane: PlaneView, turned: Sequence[TurnedGrid], orientation: Orientation) -> float:
    """Return the height of the pin-hole that the perspective of the turned grids tells: tan(angle) / growth.

    Raises
    ------
    GridAngleError
        When angles are on one side only or have the wrong sign, or a plane was not turned.
    """
    angles = [each.angle for each in turned]
    if not angles or not min(angles) < -SMALLEST_TURN < SMALLEST_TURN < max(angles):
        raise GridAngleError(
            "the grid is needed with the plane turned to both sides by 2 degree or more; given are "
            f"{[round(math.degrees(angle), 3) for angle in angles]} degree"
        )
    along = 0 if orientation == Orientation.VERTICAL else 1
    growth = np.array(
        [fit_homography(np.stack(plane.on_plane(*each.pixels.T), axis=1), each.grid)[2, along] for each in turned]
    )
    inverse = growth / np.tan(angles)
    if np.all(inverse < 0):
        raise GridAngleError(
            "the grid's perspective says that the plane was turned the other way: a positive angle raises the side of "
            "+x, right in the image (that of +y, up in the image, with horizontal fringes), towards the camera"
        )
    worst = int(np.argmin(inverse))
    if inverse[worst] * _ALIKE < inverse.max():
        seems = math.degrees(math.atan(growth[worst] / inverse.max()))
        raise GridAngleError(
            f"the grid at {math.degrees(angles[worst]):+g} degree is seen as if the plane stood at {seems:+.1f}: "
            "turn the plane, with the grid on it, to the angle asked for"
        )
    return float(1 / np.mean(inverse))


@dataclass(frozen=True, eq=False)
class _Bundle:
    """Lines of sight through a pin-hole, and the turned planes that they meet."""

    grid: GridMeasurement
    turned: tuple[TurnedGrid, ...]
    orientation: Orientation
    sigma_angle: float

    def fit(self, distance: float) -> tuple[np.ndarray, np.ndarray, float, list[float]]:
        """Return parameters, their covariance, chi square per degree of freedom, and what each picture keeps [px]."""
        errors = len(self.turned) if self.sigma_angle > 0 else 0
        scale = np.array([*[distance] * 5, _AXIS_ANGLE, _AXIS_ANGLE, *[_VIEW] * 8, *[_TURN] * errors])
        start = np.array([1.0, *[0.0] * (len(scale) - 1)])

        def scaled(part: np.ndarray) -> np.ndarray:
            return self.residuals(part * scale)

        found = least_squares(scaled, start, method="lm", x_scale="jac")
        slopes, values = np.asarray(found.jac), np.asarray(found.x) * scale
        covariance = np.linalg.inv(slopes.T @ slopes) * np.outer(scale, scale)
        left = [
            math.sqrt(float(np.mean(np.sum(apart**2, axis=1)))) / self.grid.plane.pixel_size
            for _, apart in self._apart(values)
        ]
        # besides the parameters, each picture is laid on by a shift and a turn
        freedom = len(found.fun) - len(values) - 3 * len(self.turned)
        return values, covariance, float(2 * found.cost) / freedom, left

    def residuals(self, values: np.ndarray) -> np.ndarray:
        """Return what pictures and angles differ from the parameters by, in standard deviations.

        Parameters
        ----------
        values
            Height of the pin-hole and its foot on the plane (x, y), a point of the axis (across the fringes, height)
            [m], the axis against the fringes and against the plane, eight errors of the view of the plane at 0 degree
            (homography, lengths in units of `_reach`), and those of the angles, if any [rad].
        """
        parts = [(apart / each.sigma[:, None]).ravel() for each, apart in self._apart(values)]
        known = values[_ANGLES:] / self.sigma_angle if len(values) > _ANGLES else values[_ANGLES:]
        return np.concatenate([*parts, self._view_root @ values[_VIEW_ERRORS:_ANGLES], known])

    def _apart(self, values: np.ndarray) -> Iterator[tuple[TurnedGrid, np.ndarray]]:
        errors = values[_ANGLES:] if len(values) > _ANGLES else np.zeros(len(self.turned))
        for each, error in zip(self.turned, errors, strict=True):
            yield each, each.grid - _laid_on(self._seen(values, each, float(error)), each)

    @cached_property
    def _reach(self) -> float:
        """Half of the field [m]."""
        return 0.5 * self.grid.plane.pixel_size * self.grid.distortion.width

    @cached_property
    def _view_root(self) -> np.ndarray:
        """Root of the inverse covariance (8, 8) of the errors of the view by the noise of the picture at 0 degree."""
        x, y = np.stack(self.grid.plane.on_plane(self.grid.columns, self.grid.rows)) / self._reach
        one, zero = np.ones_like(x), np.zeros_like(x)
        slopes = np.concatenate(
            [
                np.stack([x, y, one, zero, zero, zero, -x * x, -x * y], axis=1),
                np.stack([zero, zero, zero, x, y, one, -x * y, -y * y], axis=1),
            ]
        )
        noise = OVERLAP * self.grid.residual / math.sqrt(2) * self.grid.plane.pixel_size / self._reach
        return np.linalg.cholesky(slopes.T @ slopes / noise**2).T

    def _seen(self, values: np.ndarray, each: TurnedGrid, error: float) -> np.ndarray:
        """Return where the lines of sight meet a turned plane, in coordinates that turn with it [m]."""
        across, up, skew, slope = values[3:_VIEW_ERRORS]
        if self.orientation == Orientation.VERTICAL:
            axis, point, angle = np.array([skew, 1.0, slope]), np.array([across, 0.0, up]), -(each.angle + error)
        else:
            axis, point, angle = np.array([1.0, skew, slope]), np.array([0.0, across, up]), each.angle + error
        right, upward, normal = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix().T
        pin_hole = np.array([*values[1:3], values[0]])
        on_plane = np.stack(self.grid.plane.on_plane(*each.pixels.T), axis=1)
        error_of_view = np.eye(3) + np.append(values[_VIEW_ERRORS:_ANGLES], 0.0).reshape(3, 3)
        on_plane = self._reach * apply_homography(error_of_view, on_plane / self._reach)
        rays = np.column_stack([on_plane, np.zeros(len(on_plane))]) - pin_hole
        # the point of the axis keeps its distance from the plane, which was its height
        reach = (normal @ (point - pin_hole) - up) / (rays @ normal)
        return (pin_hole - point + reach[:, None] * rays) @ np.stack([right, upward], axis=1)


def _laid_on(points: np.ndarray, each: TurnedGrid) -> np.ndarray:
    """Return points (n, 2) shifted and turned so that they lie on those of the grid as well as they can."""
    weights = each.sigma**-2 / np.sum(each.sigma**-2)
    middle = weights @ each.grid
    source, target = points - weights @ points, each.grid - middle
    cos = np.sum(weights[:, None] * source * target)
    sin = np.sum(weights * (source[:, 0] * target[:, 1] - source[:, 1] * target[:, 0]))
    turn = np.array([[cos, sin], [-sin, cos]]) / math.hypot(cos, sin)
    return middle + source @ turn


def _with_pin_hole(grid: GridMeasurement, place: np.ndarray, covariance: np.ndarray) -> tuple[DistortionMap, PlaneView]:
    """Return distortion and view of the plane of a camera whose pin-hole is at `place` (distance, foot x, foot y) [m].

    The ideal camera is turned so that its axis is the line of sight of the image's centre and its rows are those of the
    image. Neither changes where a pixel looks.
    """
    view = grid.plane
    middle = np.array([view.principal_column, view.principal_row, 1.0])
    turn = np.eye(3)
    for _ in range(_ROUNDS):
        foot = turn[:2, :2] @ place[1:]
        # directions (X - foot, -distance) of ideal pixels, and in the camera's own frame (u, v, -1)
        rays = np.array([[1, 0, -foot[0]], [0, 1, -foot[1]], [0, 0, -place[0]]]) @ turn @ view.homography
        tilts = math.atan2(-foot[1], place[0]), math.asin(foot[0] / math.hypot(*foot, place[0]))
        own = Rotation.from_euler("XY", tilts).as_matrix().T @ rays
        slopes = -own[:2, :2] / (own[2] @ middle)
        turn = Rotation.from_euler("z", -math.atan2(slopes[1, 0], slopes[0, 0])).as_matrix() @ turn
    to_ideal = np.diag([1 / slopes[0, 0], 1 / slopes[1, 1], -1.0]) @ own
    to_ideal[:2] += np.outer(middle[:2], to_ideal[2])
    homography = turn @ view.homography @ np.linalg.inv(to_ideal)
    around = np.eye(3)
    around[1:, 1:] = turn[:2, :2]
    pin_hole = PinHole(float(place[0]), float(foot[0]), float(foot[1]), around @ covariance @ around.T)
    return (
        grid.distortion.followed_by(to_ideal),
        PlaneView(homography / (homography[2] @ middle), view.principal_column, view.principal_row, pin_hole),
    )
