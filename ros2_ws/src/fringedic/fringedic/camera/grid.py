"""Distortion of a camera from one image of a printed grid: windowed Fourier phase, no lens model (2.4).

The phases of the two directions are the grid's coordinates of every pixel. A homography, the image that an ideal camera
takes of a plane, maps the grid to the pixels of the image. Its residual is the distortion, a pair of polynomials whose
order is chosen by cross-validation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from fringedic.camera.carriers import check_aliasing, find_carriers
from fringedic.camera.distortion import DistortionMap
from fringedic.camera.findings import Finding, GridFinding
from fringedic.camera.grid_phases import GridPhases, grid_phases
from fringedic.camera.homography import apply_homography, fit_homography
from fringedic.camera.plane_homography import PlaneHomography
from fringedic.camera.polynomials import Basis, choose_order, square
from fringedic.errors import GridError, ImageError
from fringedic.wording.arguments import check_arguments, number, optional, whole

# test_grid.py contains images on both sides of the thresholds that refuse an image or warn.
SMALLEST_IMAGE = 64  # [px]
OUTLIER = 6.0  # a point that deviates by more robust standard deviations is rejected
TO_SIGMA = 1.4826  # from the median absolute deviation to the standard deviation of a normal distribution
_SMALLEST_SCATTER = 1e-4  # [px]: images without noise have no outliers
_BLOCK = 5.0  # periods
# The windows of points one period apart overlap. The sum of the autocorrelation of the cubic B-spline over whole
# periods, along one direction, is 315 / 151; with both directions it is the ratio of standard deviations.
OVERLAP = 315 / 151
_NOISIEST = 0.1  # [px]: points that scatter more show noise, blur or a surface that is not flat
_FULL_SCALES = (255, 1023, 4095, 16383, 65535)
_SATURATED_WARNING, _SATURATED_ERROR = 0.005, 0.1
_SCALE = 1.2  # the pixel sizes by the grid and by the user differ by less than this factor
_ASPECT = 0.02  # the scales along rows and columns of a good print differ by less
_SKEW = 0.01  # [rad]


@dataclass(frozen=True, eq=False)
class GridMeasurement:
    """Result of one image of a grid: the distortion of the camera and the homography of the plane.

    Attributes
    ----------
    distortion
        Field from the pixels of the image to those of an ideal camera; at the image's centre neither the field nor its
        first derivatives differ from zero.
    plane
        Homography of the plane of the grid for this ideal camera, scaled by the pitch of the grid.
    pitch
        Pitch of the grid [m], as given.
    period, turn
        Period of the grid [px] and its turn on the plane, counter-clockwise in the image [rad].
    order
        Order of the polynomials, chosen by cross-validation unless it was given.
    orders, cross_validation
        Orders compared, and the root mean square residual of each at points that were left out of its fit [px].
    magnitude
        Root mean square of the distortion over the image after the best homography [px].
    residual
        Root mean square residual of the polynomials at the points of the fit [px].
    sigma
        Standard deviation of the field due to this scatter, root mean square over the image [px].
    columns, rows, residual_columns, residual_rows : (points,)
        Positions of the points, and their residuals, ideal minus seen [px].
    valid_fraction
        Part of the image that shows the grid.
    warnings
        What should be better, as codes with values; `fringedic.calibration.sentences` makes sentences of them.
    """

    distortion: DistortionMap
    plane: PlaneHomography
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
    warnings: tuple[Finding, ...]


HIGHEST_ORDER = 30  # exceeds what the periods of a grid allow


@check_arguments(GridError, pitch=number(), order=optional(whole(high=HIGHEST_ORDER)), pixel_size=optional(number()))
def measure_distortion(
    grid_image: ArrayLike,
    *,
    pitch: float,
    mask: ArrayLike | None = None,
    order: int | None = None,
    pixel_size: float | None = None,
) -> GridMeasurement:
    """Measure the distortion of a camera from one image of a flat printed grid.

    The windowed Fourier phases of both directions (cubic B-spline windows of four periods that follow the phase) are
    the grid's coordinates of the points seen. With the homography G from these coordinates to pixels, U = G(phases) - p
    at each point; equations 6 and 7 give -D = U with P the period. A polynomial of the lowest order that predicts
    left-out points as well as the best one is fitted to each component of U.

    Parameters
    ----------
    grid_image : (row, column)
        Crossed lines or crossed cosines on a flat surface, 6 to 15 px per period, turned by 1 to 3 degrees against the
        pixels (more on images of less than 500 rows), filling the image. Any numeric type.
    pitch
        Period of the grid [m]; it gives the scale of `GridMeasurement.plane`.
    mask : (row, column) bool
        False where the image is not used.
    order
        Order of the polynomials; None chooses by cross-validation.
    pixel_size
        Approximate length of a pixel on the plane [m]; a pitch that contradicts it by a factor above 1.2 is refused.

    Returns
    -------
    GridMeasurement
        ``distortion`` is the `DistortionMap`.

    Raises
    ------
    GridError
        The image does not determine the distortion: no grid, lines of one direction only, too coarse or too fine, in
        step with the pixels, saturated or without contrast, covered, or of another pitch; or pitch or order is not
        positive.
    ImageError
        The image is too small or no image, or the mask has another size.

    References
    ----------
    S. Coudert, K. Triconnet, A. Zebiri, Y. Surrel, "Etalonnage transverse d'un objectif de camera par la methode de la
    grille", colloque Photomecanique, Albi (2004).

    Y. Surrel, "Additive noise effect in digital phase detection", Applied Optics 36 (1997) 271-276: windowed phase.

    J. Molimard, G. Boyer, H. Zahouani, "Frequency-based image analysis of random patterns: an alternative way to
    classical stereocorrelation", section 2.4.

    Examples
    --------
    A straight grid of 8 px, turned by 3.4 degrees, seen by an ideal camera:

    >>> import numpy as np
    >>> import fringedic
    >>> row, column = np.mgrid[:240, :320]
    >>> c, s = np.cos(0.06) / 8, np.sin(0.06) / 8
    >>> image = 128 + 50 * np.cos(2 * np.pi * (c * column + s * row)) + 50 * np.cos(2 * np.pi * (c * row - s * column))
    >>> found = fringedic.measure_distortion(image, pitch=1e-3)
    >>> round(1e6 * found.plane.pixel_size, 2), bool(found.magnitude < 1e-3)
    (125.0, True)
    """
    if not pitch > 0 or not np.isfinite(pitch):
        raise GridError(f"the grid's pitch is {pitch} m: it has to be above 0")
    if order is not None and order < 1:
        raise GridError(f"order {order}: it has to be 1 or more")
    image, usable, warnings = checked_grid(grid_image, mask)
    carriers = find_carriers(np.where(usable, image, np.mean(image[usable])))
    warnings += check_aliasing(carriers, image.shape)
    period = float(np.mean(1 / np.hypot(*carriers.T)))
    phases = grid_phases(image, usable, carriers)
    if phases.covered:
        warnings.append(Finding(GridFinding.COVERED, ", ".join(phases.covered)))
    field = _fit_field(phases, image.shape, _BLOCK * period, order)
    distortion, plane, turn = _at_rest_in_the_centre(field, image.shape, pitch)
    if pixel_size is not None and not 1 / _SCALE < plane.pixel_size / pixel_size < _SCALE:
        raise GridError(
            f"with this pitch a pixel is {1e6 * plane.pixel_size:.1f} µm on the plane and not about "
            f"{1e6 * pixel_size:.1f} µm: is the pitch given in metre, and the one of this grid?"
        )
    if abs(plane.pixel_aspect - 1) > _ASPECT:
        warnings.append(Finding(GridFinding.ASPECT, values={"difference": abs(plane.pixel_aspect - 1)}))
    if abs(plane.skew) > _SKEW:
        warnings.append(Finding(GridFinding.SKEW, values={"angle": 0.5 * np.pi - plane.skew}))
    return GridMeasurement(
        distortion=distortion,
        plane=plane,
        pitch=pitch,
        period=period,
        turn=turn,
        order=field.order,
        orders=field.orders,
        cross_validation=field.errors,
        magnitude=field.rms(field.shift),
        residual=field.residual,
        sigma=OVERLAP * field.residual * field.basis.uncertainty(field.order, field.weights),
        columns=field.seen[:, 0],
        rows=field.seen[:, 1],
        residual_columns=field.left[:, 0],
        residual_rows=field.left[:, 1],
        valid_fraction=float(phases.valid.mean()),
        warnings=tuple(warnings),
    )


@dataclass(frozen=True, eq=False)
class _Field:
    """The fitted field U at its points, without outliers.

    Attributes
    ----------
    to_pixels : (3, 3)
        Homography from the grid [periods] to pixels.
    seen, shift, left : (points, 2)
        Positions, U, and its residuals [px].
    weights : (points,)
        Of the points.
    coefficients : (terms, 2)
        Of both components of U.
    basis
        The polynomials at the points.
    order, orders, errors
        The chosen order, all orders and the error of each by cross-validation [px].
    """

    to_pixels: np.ndarray
    seen: np.ndarray
    shift: np.ndarray
    left: np.ndarray
    weights: np.ndarray
    coefficients: np.ndarray
    basis: Basis
    order: int
    orders: tuple[int, ...]
    errors: tuple[float, ...]

    def rms(self, values: np.ndarray) -> float:
        """Return the weighted root mean square length of vectors (points, 2)."""
        return float(np.sqrt(np.average(np.sum(values**2, axis=1), weights=self.weights)))

    @property
    def residual(self) -> float:
        """Root mean square residual [px]."""
        return self.rms(self.left)


def _fit_field(phases: GridPhases, shape: tuple[int, int], block: float, order: int | None) -> _Field:
    """Fit homography and polynomials to all points, reject outliers, and fit again.

    Parameters
    ----------
    phases
        Of the grid.
    shape
        Rows and columns of the image.
    block
        Width of the blocks of points that cross-validation leaves out together [px].
    order
        Of the polynomials; None chooses.
    """
    turns, seen, weights = phases.phases / (2 * np.pi), phases.points, phases.weights
    kept = np.ones(len(seen), bool)
    for again in (True, False):
        to_pixels = fit_homography(turns[kept], seen[kept], weights[kept])
        shift = apply_homography(to_pixels, turns) - seen
        basis = Basis(seen[kept], shape)
        best, orders, errors = choose_order(basis, shift[kept], weights[kept], block)
        chosen = best if order is None else min(order, basis.highest)
        coefficients = basis.fit(shift[kept], chosen, weights[kept])
        if again:
            left = np.abs(shift - basis.evaluate(coefficients)).max(axis=1)
            kept = left < max(OUTLIER * TO_SIGMA * float(np.median(left)), _SMALLEST_SCATTER)
    if min(errors) > _NOISIEST:
        raise GridError(
            f"the points of the grid scatter by {min(errors):.2f} px: too much noise or blur, or a surface that is not "
            "flat"
        )
    seen, shift, weights = seen[kept], shift[kept], weights[kept]
    left = shift - basis.evaluate(coefficients)
    return _Field(to_pixels, seen, shift, left, weights, coefficients, basis, chosen, orders, errors)


def checked_grid(grid_image: ArrayLike, mask: ArrayLike | None) -> tuple[np.ndarray, np.ndarray, list[Finding]]:
    """Return the image as float64 (row, column), where it may be used (bool), and warnings.

    Raises
    ------
    ImageError
        The image is too small or no image, or the mask has another size.
    GridError
        No pixel may be used, or too many are saturated.
    """
    given = np.asarray(grid_image)
    if given.ndim != 2 or min(given.shape) < SMALLEST_IMAGE or given.dtype.kind not in "biuf":
        raise ImageError(f"an image (row, column) of at least {SMALLEST_IMAGE} px is needed, not {given.shape}")
    image = given.astype(float)
    usable = np.isfinite(image)
    if mask is not None:
        if np.shape(mask) != image.shape:
            raise ImageError(f"mask of shape {np.shape(mask)} for an image of shape {image.shape}")
        usable &= np.asarray(mask, bool)
    if not usable.any():
        raise GridError("no pixel of the image may be used")
    # This includes means of several frames: a pixel that is saturated in all of them is exactly so in the mean.
    values = image[usable]
    brightest = float(values.max())
    saturated = float(np.mean(values == brightest)) if brightest in _FULL_SCALES else 0.0
    if saturated > _SATURATED_ERROR:
        raise GridError(f"{saturated:.0%} of the grid image is saturated: expose less")
    warnings = [Finding(GridFinding.SATURATED, values={"share": saturated})] if saturated > _SATURATED_WARNING else []
    return np.where(usable, image, image[usable].mean()), usable, warnings


def _at_rest_in_the_centre(
    fitted: _Field, shape: tuple[int, int], pitch: float
) -> tuple[DistortionMap, PlaneHomography, float]:
    """Return the field whose value and slopes vanish at the image's centre, the plane's homography, the grid's turn.

    An affine map of the ideal pixels achieves this. Its inverse goes into the homography, so that every pixel still
    sees the same point of the plane.
    """
    field = np.stack([square(each, fitted.order) for each in fitted.coefficients.T])
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
    to_plane = np.diag([pitch, -pitch, 1.0]) @ np.linalg.inv(fitted.to_pixels) @ back
    x, y, w = to_plane @ np.append(half, 1.0)
    to_plane = np.array([[1, 0, -x / w], [0, 1, -y / w], [0, 0, 1]]) @ to_plane / w
    turned = float(np.arctan2(to_plane[1, 0], to_plane[0, 0]))  # of the image's rows in the grid
    c, s = np.cos(turned), np.sin(turned)
    to_plane = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ to_plane
    return (
        DistortionMap(columns, rows, moved[0], moved[1]),
        PlaneHomography(to_plane, float(half[0]), float(half[1])),
        -turned,
    )
