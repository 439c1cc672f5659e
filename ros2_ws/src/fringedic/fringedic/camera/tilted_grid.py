"""The printed grid on the tilted plane: position of the camera's pin-hole.

One image of a plane gives the point in which every line of sight meets the plane, but not its direction: a tilted
camera and a lens whose elements are off their axis distort the image in the same way. Images of the plane tilted to
either side give a second and a third point of every line of sight; all lines meet in the pin-hole (a bundle adjustment
of the pin-hole, the axis of rotation and the homography).
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
from fringedic.camera.distortion import DistortionMap
from fringedic.camera.findings import Finding, GridFinding
from fringedic.camera.grid import OUTLIER, OVERLAP, TO_SIGMA, GridMeasurement, checked_grid
from fringedic.camera.grid_phases import grid_phases
from fringedic.camera.homography import apply_homography, fit_homography
from fringedic.camera.plane_homography import PinHole, PlaneHomography
from fringedic.errors import GridError, ImageError
from fringedic.patterns.pattern import Orientation

# test_tilted_grid.py contains angles on both sides of the thresholds that refuse images or warn.
SMALLEST_TURN = math.radians(2.0)  # to either side: a smaller tilt locates the pin-hole no better than a ruler
_BLOCKS = (12, 16)
_LEAST_POINTS = 3  # of a block
_ALIKE = 2.0  # factor between the distances of the pin-hole by single images
_SUSPICIOUS = 3.0  # chi square per degree of freedom above which images contradict each other
_ANY_ANGLE = math.radians(10)  # standard uncertainty of the angles in the search for the wrong one
_WRONG_ANGLE, _WRONG = math.radians(0.5), 0.5  # error of an angle, and RMS [px], above which the images are refused
_ROUNDS = 3  # tilts of a degree converge to rounding errors in two
_AXIS_ANGLE, _TURN, _VIEW = 1e-2, 1e-3, 1e-5  # [rad] scales of the parameters: about the size of their deviations
_VIEW_ERRORS, _ANGLES = 7, 15  # first index of these among the parameters


@dataclass(frozen=True, eq=False)
class TiltedGrid:
    """One image of the grid on the tilted plane, as means over blocks of the image.

    Attributes
    ----------
    angle
        Of the plane [rad]; a positive one raises the +x side towards the camera (with horizontal fringes, the +y side).
    pixels : (blocks, 2)
        Ideal column and row of the blocks [px].
    grid : (blocks, 2)
        Point of the grid seen there [m]: x to the right and y upwards along the lines, from any of their crossings.
    sigma : (blocks,)
        Standard deviation of each component of `grid` [m].
    residual
        Root mean square residual of the blocks after a homography [px]: whether the lens is that of the image at 0
        degree.
    """

    angle: float
    pixels: np.ndarray
    grid: np.ndarray
    sigma: np.ndarray
    residual: float


def measure_tilted_grid(
    image: ArrayLike, grid: GridMeasurement, angle: float, *, mask: ArrayLike | None = None
) -> TiltedGrid:
    """Find the grid in an image of the tilted plane.

    Parameters
    ----------
    image : (row, column)
        As for `fringedic.measure_distortion`.
    grid
        Result of the image at angle 0, taken through the same lens.
    angle
        Of the plane [rad].
    mask : (row, column) bool
        False where the image is not used.

    Raises
    ------
    GridError
        The image does not show the grid well enough.
    ImageError
        The image or the mask has another size.
    """
    values, usable, _ = checked_grid(image, mask)
    if values.shape != (grid.distortion.height, grid.distortion.width):
        raise ImageError(
            f"grid on the tilted plane: {values.shape[1]} x {values.shape[0]} px, at 0 degree "
            f"{grid.distortion.width} x {grid.distortion.height} px"
        )
    found = grid_phases(values, usable, find_carriers(np.where(usable, values, np.mean(values[usable]))))
    seen, weights = np.stack(grid.distortion.ideal(*found.points.T), axis=1), found.weights
    points = grid.pitch * found.phases / (2 * np.pi) * (1, -1)
    size = np.abs(points - apply_homography(fit_homography(seen, points, weights), seen)).max(axis=1)
    kept = size <= OUTLIER * TO_SIGMA * np.median(size)
    seen = seen[kept]
    points = points[kept]
    weights = weights[kept]
    shape = (grid.distortion.height, grid.distortion.width)
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
    return TiltedGrid(
        angle=angle,
        pixels=centres,
        grid=apply_homography(to_grid, centres) + means,
        sigma=OVERLAP * scatter / np.sqrt(total),
        residual=float(np.sqrt(np.mean(np.sum(means**2, axis=1)))) / grid.plane.pixel_size,
    )


def locate_pin_hole(
    grid: GridMeasurement,
    tilted: Sequence[TiltedGrid],
    *,
    sigma_angle: float = 0.0,
    orientation: Orientation = Orientation.VERTICAL,
) -> GridMeasurement:
    """Return the measurement of a grid with the pin-hole in which the camera's lines of sight meet.

    Unknown are the pin-hole and the axis of the plane's rotation (position and direction); the position of the grid on
    the plane does not matter. Least squares of the distances on the grid, each divided by its standard deviation. The
    perspective of this pin-hole then goes into the homography of the plane, and the remainder into the distortion. The
    points in which lines of sight meet the plane stay as measured.

    Parameters
    ----------
    grid
        Of the plane at angle 0.
    tilted
        Of the tilted plane, on both sides of 0. With equal angles on both sides the noise of the image at 0, which both
        share, cancels in the position of the pin-hole.
    sigma_angle
        Standard uncertainty of single angles [rad].
    orientation
        Of the fringes, to which the axis is parallel.

    Returns
    -------
    GridMeasurement
        With `PlaneHomography.pin_hole`; its covariance follows from the noise, or is larger when the images contradict
        each other by more than noise.

    Raises
    ------
    GridError
        Angles are on one side only or have the wrong sign, or the images contradict each other.
    """
    # The perspective of a tilted grid gives the height of the pin-hole: tan(angle) / growth.
    plane = grid.plane
    angles = [each.angle for each in tilted]
    if not angles or not min(angles) < -SMALLEST_TURN < SMALLEST_TURN < max(angles):
        raise GridError(
            "the grid is needed with the plane tilted to both sides by 2 degree or more; given are "
            f"{[round(math.degrees(angle), 3) for angle in angles]} degree"
        )
    along = 0 if orientation == Orientation.VERTICAL else 1
    growth = np.array(
        [fit_homography(np.stack(plane.on_plane(*each.pixels.T), axis=1), each.grid)[2, along] for each in tilted]
    )
    inverse = growth / np.tan(angles)
    if np.all(inverse < 0):
        raise GridError(
            "the perspective of the grid shows that the plane was tilted the other way: a positive angle raises the "
            "side of +x, right in the image (that of +y, up in the image, with horizontal fringes), towards the camera"
        )
    worst = int(np.argmin(inverse))
    if inverse[worst] * _ALIKE < inverse.max():
        seems = math.degrees(math.atan(growth[worst] / inverse.max()))
        raise GridError(
            f"the grid at {math.degrees(angles[worst]):+g} degree is seen as if the plane were at "
            f"{seems:+.1f}: tilt the plane, with the grid on it, to the angle asked for"
        )
    distance = float(1 / np.mean(inverse))
    bundle = _Bundle(grid, tuple(tilted), orientation, sigma_angle)
    solution = bundle.fit(distance)
    warnings = list(grid.warnings)
    if solution.chi_square > _SUSPICIOUS:
        free = dataclasses.replace(bundle, sigma_angle=max(bundle.sigma_angle, _ANY_ANGLE))
        errors = free.fit(distance).values[_ANGLES:]
        residual, stated = max(solution.left), [each.angle for each in bundle.tilted]
        apparent = [angle + float(error) for angle, error in zip(stated, errors, strict=True)]
        if np.abs(errors).max() > _WRONG_ANGLE or not residual < _WRONG:
            raise GridError(contradiction_text(stated, apparent, residual))
        values = {"residual": residual}
        for number, (angle, seen) in enumerate(zip(stated, apparent, strict=True), start=1):
            values |= {f"stated_{number}": angle, f"apparent_{number}": seen}
        warnings.append(Finding(GridFinding.CONTRADICTION, values=values))
    covariance = max(1.0, solution.chi_square) * solution.covariance[:3, :3]
    distortion, plane = _with_pin_hole(grid, solution.values[:3], covariance)
    return dataclasses.replace(grid, distortion=distortion, plane=plane, warnings=tuple(warnings))


def contradiction_text(stated: Sequence[float], apparent: Sequence[float], residual: float) -> str:
    """Return the words about tilted grids that contradict each other.

    Parameters
    ----------
    stated, apparent
        Angles of the plane as entered, and as the images show it [rad].
    residual
        Largest residual of an image [px].
    """
    named = " and ".join(f"{math.degrees(each):+g}" for each in stated)
    seems = " and ".join(f"{math.degrees(each):+.2f}" for each in apparent)
    return (
        f"the grids at {named} degree contradict each other by {residual:.3f} px, as if the plane had been at {seems} "
        "degree: were these the angles, is the sheet flat, and did it stay in place?"
    )


@dataclass(frozen=True, eq=False)
class _Solution:
    """A fitted bundle: parameters, covariance, chi square per degree of freedom, RMS residual of each image [px]."""

    values: np.ndarray
    covariance: np.ndarray
    chi_square: float
    left: list[float]


@dataclass(frozen=True, eq=False)
class _Bundle:
    """Lines of sight through a pin-hole, and the tilted planes that they meet."""

    grid: GridMeasurement
    tilted: tuple[TiltedGrid, ...]
    orientation: Orientation
    sigma_angle: float

    def fit(self, distance: float) -> _Solution:
        """Fit the bundle, starting at a distance of the pin-hole [m]."""
        errors = len(self.tilted) if self.sigma_angle > 0 else 0
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
        # besides the parameters, each image is aligned by a translation and a rotation
        freedom = len(found.fun) - len(values) - 3 * len(self.tilted)
        return _Solution(values, covariance, float(2 * found.cost) / freedom, left)

    def residuals(self, values: np.ndarray) -> np.ndarray:
        """Return the residuals of images and angles in standard deviations.

        Parameters
        ----------
        values
            Height of the pin-hole and its foot on the plane (x, y), a point of the axis (across the fringes, height)
            [m], the axis relative to the fringes and to the plane, eight errors of the homography of the plane at 0
            degree (lengths in units of `_reach`), and those of the angles, if any [rad].
        """
        parts = [(apart / each.sigma[:, None]).ravel() for each, apart in self._apart(values)]
        known = values[_ANGLES:] / self.sigma_angle if len(values) > _ANGLES else values[_ANGLES:]
        return np.concatenate([*parts, self._view_root @ values[_VIEW_ERRORS:_ANGLES], known])

    def _apart(self, values: np.ndarray) -> Iterator[tuple[TiltedGrid, np.ndarray]]:
        errors = values[_ANGLES:] if len(values) > _ANGLES else np.zeros(len(self.tilted))
        for each, error in zip(self.tilted, errors, strict=True):
            yield each, each.grid - _align(self._intersect(values, each, float(error)), each)

    @cached_property
    def _reach(self) -> float:
        """Half of the field [m]."""
        return 0.5 * self.grid.plane.pixel_size * self.grid.distortion.width

    @cached_property
    def _view_root(self) -> np.ndarray:
        """Root of the inverse covariance (8, 8) of the errors of the homography due to the noise of the image at 0."""
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

    def _intersect(self, values: np.ndarray, each: TiltedGrid, error: float) -> np.ndarray:
        """Return the points in which the lines of sight meet a tilted plane, in coordinates that turn with it [m]."""
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
        # the point of the axis keeps its distance from the plane, which is its height at angle 0
        reach = (normal @ (point - pin_hole) - up) / (rays @ normal)
        seen: np.ndarray = (pin_hole - point + reach[:, None] * rays) @ np.stack([right, upward], axis=1)
        return seen


def _align(points: np.ndarray, each: TiltedGrid) -> np.ndarray:
    """Return points (n, 2) after the translation and rotation that align them best with those of the grid."""
    weights = each.sigma**-2 / np.sum(each.sigma**-2)
    middle = weights @ each.grid
    source, target = points - weights @ points, each.grid - middle
    cos = np.sum(weights[:, None] * source * target)
    sin = np.sum(weights * (source[:, 0] * target[:, 1] - source[:, 1] * target[:, 0]))
    turn = np.array([[cos, sin], [-sin, cos]]) / math.hypot(cos, sin)
    aligned: np.ndarray = middle + source @ turn
    return aligned


def _with_pin_hole(
    grid: GridMeasurement, place: np.ndarray, covariance: np.ndarray
) -> tuple[DistortionMap, PlaneHomography]:
    """Return distortion and homography of the plane of a camera with its pin-hole at `place` (distance, foot x, y) [m].

    The ideal camera is turned so that its axis is the line of sight of the image's centre and its rows are those of the
    image. Neither changes the line of sight of a pixel.
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
        PlaneHomography(homography / (homography[2] @ middle), view.principal_column, view.principal_row, pin_hole),
    )
