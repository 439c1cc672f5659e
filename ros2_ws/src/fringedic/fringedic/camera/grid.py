"""Distortion of a camera from one image of a printed grid: windowed Fourier phase, no lens model (2.4).

The phases of the two directions tell at every pixel which point of the grid it sees. A homography, the view of an ideal
camera, brings the grid into the image's pixels; what it cannot explain is the distortion, a pair of polynomials whose
order cross-validation chooses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from fringedic.camera.carriers import check_aliasing, find_carriers
from fringedic.camera.demodulation import grid_phases
from fringedic.camera.distortion import DistortionMap
from fringedic.camera.homography import apply_homography, fit_homography
from fringedic.camera.plane_view import PlaneView
from fringedic.camera.polynomials import Basis, choose_order, square
from fringedic.errors import (
    GridContrastError,
    GridCoveredError,
    GridPitchError,
    ImageSizeError,
    InvalidDistortionError,
    ShapeMismatchError,
)

SMALLEST_IMAGE = 64  # [px]
OUTLIER = 6.0  # robust standard deviations
_SMALLEST_SCATTER = 1e-4  # [px]: images without noise have no outliers
_BLOCK = 5.0  # periods
# Points one period apart share noise: the sum over its correlations along one direction, for both.
OVERLAP = 315 / 151
_NOISIEST = 0.1  # [px] scatter of the points
_FULL_SCALES = (255, 1023, 4095, 16383, 65535)
_SATURATED_WARNING, _SATURATED_ERROR = 0.005, 0.1
_SCALE, _ASPECT, _SKEW = 1.2, 0.02, 0.01


@dataclass(frozen=True, eq=False)
class GridMeasurement:
    """What one image of a grid tells about its camera.

    Attributes
    ----------
    distortion
        Field from the pixels of the image to those of an ideal camera; at the image's centre neither the field nor its
        first derivatives differ from zero.
    plane
        How that ideal camera sees the plane of the grid, scaled by the grid's pitch.
    pitch
        Pitch of the grid [m], as it was given.
    period, turn
        Period of the grid [px] and its turn on the plane, counter-clockwise in the image [rad].
    order
        Order of the polynomials, chosen by cross-validation unless it was given.
    orders, cross_validation
        Orders tried, and the root mean square of what each leaves at points that it was not fitted to [px].
    magnitude
        Root mean square of the distortion over the image after the best homography [px].
    residual
        Root mean square of what the polynomials leave at the points of the fit [px].
    sigma
        Standard deviation of the field that this scatter causes, root mean square over the image [px].
    columns, rows, residual_columns, residual_rows : (points,)
        Where the points are and what is left there, ideal minus seen [px].
    valid_fraction
        Part of the image that shows the grid.
    warnings
        What should be better, in words.
    """

    distortion: DistortionMap
    plane: PlaneView
    pitch: float
    period: float
    turn: float
    order: int
    orders: tuple[int, ...]
    cross_validation: tuple[float, ...]
    magnitude: float
    residual: float
    sigma: float
    columns: np.ndarray
    rows: np.ndarray
    residual_columns: np.ndarray
    residual_rows: np.ndarray
    valid_fraction: float
    warnings: tuple[str, ...]


def measure_distortion(
    grid_image: ArrayLike,
    *,
    pitch: float,
    mask: ArrayLike | None = None,
    order: int | None = None,
    pixel_size: float | None = None,
) -> GridMeasurement:
    """Measure the distortion of a camera from one image of a flat printed grid.

    The windowed Fourier phases of both directions (cubic B-spline windows of four periods that follow the phase found
    so far) are the grid's coordinates of the points seen. With the homography G from these to pixels that fits best,
    U = G(phases) - p at each point; equations 6 and 7 are -D = U with P the period. A polynomial of the lowest order
    that predicts left-out points as well as the best does is fitted to each component of U.

    Parameters
    ----------
    grid_image : (row, column)
        Crossed lines or crossed cosines on a flat surface, 6 to 15 px per period, turned by 1 to 3 degrees against the
        pixels (more on images of less than 500 rows), filling the image.
    pitch
        Period of the grid [m]; it gives the scale of `GridMeasurement.plane`.
    mask : (row, column) bool
        False where the image shall not be used.
    order
        Order of the polynomials; None chooses by cross-validation.
    pixel_size
        Length of a pixel on the plane as far as it is known [m]; a pitch that contradicts it by a factor above 1.2 is
        refused.

    Raises
    ------
    GridError
        When the image cannot tell the distortion; the classes derived from it say why: no grid, one direction only, too
        coarse or too fine, in step with the pixels, saturated or without contrast, covered, wrong pitch.
    ImageSizeError, ShapeMismatchError, InvalidDistortionError
        When the image is too small or no image, the mask of another size, or pitch or order not positive.
    """
    if not pitch > 0 or not np.isfinite(pitch):
        raise InvalidDistortionError(f"the grid's pitch is {pitch} m: it has to be above 0")
    if order is not None and order < 1:
        raise InvalidDistortionError(f"order {order}: it has to be 1 or more")
    image, usable, warnings = checked_grid(grid_image, mask)
    carriers = find_carriers(np.where(usable, image, np.mean(image[usable])))
    warnings += check_aliasing(carriers, image.shape)
    period = float(np.mean(1 / np.hypot(*carriers.T)))
    found = grid_phases(image, usable, carriers)
    warnings += found.warnings
    turns, seen, weights = found.phases / (2 * np.pi), found.points, found.weights

    kept = np.ones(len(seen), bool)
    for again in (True, False):
        to_pixels = fit_homography(turns[kept], seen[kept], weights[kept])
        shift = apply_homography(to_pixels, turns) - seen
        basis = Basis(seen[kept], image.shape)
        best, orders, errors = choose_order(basis, shift[kept], weights[kept], _BLOCK * period)
        chosen = best if order is None else min(order, basis.highest)
        coefficients = basis.fit(shift[kept], chosen, weights[kept])
        if again:
            left = np.abs(shift - basis.evaluate(coefficients)).max(axis=1)
            kept = left < max(OUTLIER * 1.4826 * float(np.median(left)), _SMALLEST_SCATTER)
    seen, shift, weights = seen[kept], shift[kept], weights[kept]
    left = shift - basis.evaluate(coefficients)
    residual = float(np.sqrt(np.average(np.sum(left**2, axis=1), weights=weights)))
    if min(errors) > _NOISIEST:
        raise GridContrastError(
            f"the points of the grid scatter by {min(errors):.2f} px: too much noise or blur, or a surface that is not "
            "flat"
        )

    field = np.stack([square(each, chosen) for each in coefficients.T])
    magnitude = float(np.sqrt(np.average(np.sum(shift**2, axis=1), weights=weights)))
    distortion, plane, turn = _at_rest_in_the_centre(field, to_pixels, image.shape, pitch)
    _check_scale(plane, pixel_size, warnings)
    return GridMeasurement(
        distortion=distortion,
        plane=plane,
        pitch=pitch,
        period=period,
        turn=turn,
        order=chosen,
        orders=orders,
        cross_validation=errors,
        magnitude=magnitude,
        residual=residual,
        sigma=OVERLAP * residual * basis.uncertainty(chosen, weights),
        columns=seen[:, 0],
        rows=seen[:, 1],
        residual_columns=left[:, 0],
        residual_rows=left[:, 1],
        valid_fraction=float(found.valid.mean()),
        warnings=tuple(warnings),
    )


def checked_grid(grid_image: ArrayLike, mask: ArrayLike | None) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Return the image as float64, where it may be used, and warnings.

    Raises
    ------
    ImageSizeError, ShapeMismatchError
        When the image is too small or no image, or the mask has another size.
    GridCoveredError, GridContrastError
        When no pixel may be used, or too many are saturated.
    """
    given = np.asarray(grid_image)
    if given.ndim != 2 or min(given.shape) < SMALLEST_IMAGE:
        raise ImageSizeError(f"an image (row, column) of at least {SMALLEST_IMAGE} px is needed, not {given.shape}")
    image = given.astype(float)
    usable = np.isfinite(image)
    if mask is not None:
        if np.shape(mask) != image.shape:
            raise ShapeMismatchError(f"mask of shape {np.shape(mask)} for an image of shape {image.shape}")
        usable &= np.asarray(mask, bool)
    if not usable.any():
        raise GridCoveredError("no pixel of the image may be used")
    warnings = []
    brightest = float(image[usable].max())
    # means of several frames count too: a pixel that is saturated in all of them is exactly so in the mean
    if brightest in _FULL_SCALES:
        saturated = float(np.mean(image[usable] == brightest))
        text = f"{saturated:.0%} of the grid image is saturated: expose less"
        if saturated > _SATURATED_ERROR:
            raise GridContrastError(text)
        if saturated > _SATURATED_WARNING:
            warnings.append(text)
    return np.where(usable, image, image[usable].mean()), usable, warnings


def _at_rest_in_the_centre(
    field: np.ndarray, to_pixels: np.ndarray, shape: tuple[int, int], pitch: float
) -> tuple[DistortionMap, PlaneView, float]:
    """Return the field whose value and slopes vanish at the image's centre, the plane's view with it, the grid's turn.

    An affine map of the ideal pixels does it, and its inverse goes into the homography: the plane stays seen as it was.
    """
    rows, columns = shape
    half = np.array([0.5 * (columns - 1), 0.5 * (rows - 1)])
    ideal = half + np.array([chebyshev.chebval2d(0.0, 0.0, each) for each in field])
    slopes = (
        np.eye(2)
        + np.array(
            [[chebyshev.chebval2d(0.0, 0.0, chebyshev.chebder(each, axis=axis)) for axis in (1, 0)] for each in field]
        )
        / half
    )
    # p_u = c + slopes^-1 (p + U - ideal centre)
    moved = field.copy()
    moved[:, 0, 0] += half - ideal
    moved[0, 0, 1] += half[0]
    moved[1, 1, 0] += half[1]
    moved = np.tensordot(np.linalg.inv(slopes), moved, axes=1)
    moved[0, 0, 1] -= half[0]
    moved[1, 1, 0] -= half[1]

    back = np.eye(3)
    back[:2, :2], back[:2, 2] = slopes, ideal - slopes @ half
    to_plane = np.diag([pitch, -pitch, 1.0]) @ np.linalg.inv(to_pixels) @ back
    x, y, w = to_plane @ np.append(half, 1.0)
    to_plane = np.array([[1, 0, -x / w], [0, 1, -y / w], [0, 0, 1]]) @ to_plane / w
    turned = float(np.arctan2(to_plane[1, 0], to_plane[0, 0]))  # of the image's rows in the grid
    c, s = np.cos(turned), np.sin(turned)
    to_plane = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ to_plane
    return (
        DistortionMap(columns, rows, moved[0], moved[1]),
        PlaneView(to_plane, float(half[0]), float(half[1])),
        -turned,
    )


def _check_scale(plane: PlaneView, pixel_size: float | None, warnings: list[str]) -> None:
    if pixel_size is not None and not 1 / _SCALE < plane.pixel_size / pixel_size < _SCALE:
        raise GridPitchError(
            f"with this pitch a pixel is {1e6 * plane.pixel_size:.1f} µm on the plane and not about "
            f"{1e6 * pixel_size:.1f} µm: is the pitch given in metre, and the one of this grid?"
        )
    if abs(plane.pixel_aspect - 1) > _ASPECT:
        warnings.append(
            f"the grid's periods differ by {abs(plane.pixel_aspect - 1):.1%} along rows and columns: check the "
            "printer's scale along both edges of the sheet, unless the camera's pixels are not square"
        )
    if abs(plane.skew) > _SKEW:
        warnings.append(
            f"the grid's directions are {90 - np.degrees(plane.skew):.2f} degree apart and not 90: is the sheet flat?"
        )
