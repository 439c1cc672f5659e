"""3D displacement of material points: positions after minus positions before (3.3, eq. 12)."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from numba import njit, prange

from fringedic.errors import InvalidWindowError, ShapeMismatchError
from fringedic.rig import RigModel, pixel_positions
from fringedic.sequence import Orientation
from fringedic.surface.calibration_error import calibration_covariance
from fringedic.surface.prepared import PreparedShape, gaussian, require_one_calibration

_GAIN_STEPS = 64  # of a pixel, in which the noise of interpolated values is tabulated

_FIELDS = {
    "x": ("m", "reference position, to the right"),
    "y": ("m", "reference position, upwards"),
    "z": ("m", "reference position, towards the camera"),
    "u": ("m", "displacement along x"),
    "v": ("m", "displacement along y"),
    "w": ("m", "displacement along z"),
    "sigma_u": ("m", "standard deviation of u"),
    "sigma_v": ("m", "standard deviation of v"),
    "sigma_w": ("m", "standard deviation of w"),
    "cov_uv": ("m2", "covariance of the errors of u and v"),
    "cov_uw": ("m2", "covariance of the errors of u and w"),
    "cov_vw": ("m2", "covariance of the errors of v and w"),
    "noise_z": ("m", "noise of the reference height at this pixel"),
    "noise_z_deformed": ("m", "noise of the deformed height at the pixel of this point"),
}


def couple(
    reference_shape: xr.Dataset | PreparedShape,
    deformed_shape: xr.Dataset | PreparedShape,
    displacement: xr.Dataset,
    *,
    calibration: RigModel | None = None,
    z_filter: float = 0.0,
    orientation: Orientation = Orientation.VERTICAL,
) -> xr.Dataset:
    """Subtract the positions of the same material points before and after deformation (eq. 12).

    A point seen at the reference pixel p is seen at p + d in the deformed image. There z' is interpolated (cubic
    convolution) and x', y' follow from z' on the line of sight of p + d. A line of sight is that of x, y, z of its
    pixel; between pixels its slopes are linear. With weights c_i, interpolating x' = a(p) (z' - h0) as well would add
    sum c_i (a_i - a) n_i of the noise n of z'. Higher orders have nothing to win: the cubic errs by 10 nm on skin, and
    quintic weights pass more noise on.

    A point is NaN when its interpolation touches a pixel that is not measured, or a tear of the surface: a place where
    the third difference of z along four pixels exceeds 6 times its noise and the size of a pixel.

    Parameters
    ----------
    reference_shape, deformed_shape
        From `RigModel.reconstruct`, whole images or equal crops with unit steps of ``row`` and ``column``; used are
        ``x``, ``y``, ``z`` and ``noise_z`` [m]. A `PreparedShape` keeps the preparation for many couplings.
    displacement
        ``displacement_x``, ``displacement_y``, ``sigma_x``, ``sigma_y`` [px] at points of the reference image whose
        pixel positions are the coordinates ``row`` and ``column``.
    calibration
        Where the camera's distance comes from, and what the uncertainty of the calibration adds to the sigmas;
        without, the distance is an attribute of the shapes.
    z_filter
        Standard deviation [px] of a Gaussian that smooths both z first; 0 for none. Its weights are divided by the
        variances of z; that the mean of uneven weights stands beside the pixel is made up for by the surface's slope.
        It takes only points on both sides of a pixel, as far as both are measured: so it does not cross tears.
    orientation
        Direction of the fringes, which the uncertainty of the calibration depends on.

    Returns
    -------
    Dataset
        Reference positions ``x``, ``y``, ``z``, displacement ``u``, ``v``, ``w`` and its standard deviations
        ``sigma_u``, ``sigma_v``, ``sigma_w`` [m] with the covariances ``cov_uv``, ``cov_uw``, ``cov_vw`` [m^2] at the
        points of `displacement`; float32. With a filter z is the smoothed one, and x and y are those of its lines of
        sight. ``noise_z``, ``noise_z_deformed`` [m] and ``displacement_sigma_x``, ``displacement_sigma_y`` [px] are
        the independent errors that all these come from.

    Raises
    ------
    CalibrationMismatchError
        When the shapes were made with different calibrations, or with another one than that which is given.
    RaysMissingError
        When neither a calibration nor the attributes tell the camera's distance.
    ShapeMismatchError
        When the shapes are not of the same pixels, or the sigmas or displacements differ in size.
    InvalidWindowError
        When a shape was prepared with another filter.
    """
    before, after = (
        shape if isinstance(shape, PreparedShape) else PreparedShape(shape, z_filter=z_filter, calibration=calibration)
        for shape in (reference_shape, deformed_shape)
    )
    for shape in (before, after):
        if shape.z_filter != z_filter:
            raise InvalidWindowError(
                f"a shape was prepared with a z_filter of {shape.z_filter:g} px, {z_filter:g} px is asked for"
            )
    if not (np.array_equal(before.rows, after.rows) and np.array_equal(before.columns, after.columns)):
        raise ShapeMismatchError(
            f"reference shape of {before.z.shape} and deformed shape of {after.z.shape} points do not cover the same "
            "pixels"
        )
    require_one_calibration(
        "reference shape and deformed shape",
        (before.calibration_identifier, after.calibration_identifier),
        (before.camera_distance, after.camera_distance),
    )
    d_x, d_y, sigma_x, sigma_y = (
        np.ascontiguousarray(displacement[name], np.float32)
        for name in ("displacement_x", "displacement_y", "sigma_x", "sigma_y")
    )
    rows, columns = pixel_positions(displacement, d_x.shape)
    result = np.empty((len(_FIELDS), *d_x.shape), np.float32)
    _couple(
        before.z,
        before.variance,
        before.right,
        before.down,
        before.rays,
        after.z,
        after.variance,
        after.right,
        after.down,
        after.rays,
        d_x,
        d_y,
        sigma_x,
        sigma_y,
        rows - before.rows[0],
        columns - before.columns[0],
        _noise_gain(gaussian(z_filter)),
        after.camera_distance,
        result,
    )
    if calibration is not None and calibration.parameter_names:
        _add_calibration(calibration, orientation, rows, columns, d_x, d_y, result)
    kept = {name: displacement.attrs[name] for name in ("window_px", "method") if name in displacement.attrs}
    fields = {
        name: (("row", "column"), values, {"units": units, "long_name": long_name})
        for (name, (units, long_name)), values in zip(_FIELDS.items(), result, strict=True)
    }
    for name, values in (("displacement_sigma_x", sigma_x), ("displacement_sigma_y", sigma_y)):
        fields[name] = (
            ("row", "column"),
            values,
            {"units": "px", "long_name": f"standard deviation of displacement_{name[-1]}"},
        )
    return xr.Dataset(
        fields,
        coords={"row": rows, "column": columns},
        attrs={
            "camera_distance": after.camera_distance,
            "z_filter_px": z_filter,
            **{f"displacement_{name}": value for name, value in kept.items()},
        },
    )


def _add_calibration(
    calibration: RigModel,
    orientation: Orientation,
    rows: np.ndarray,
    columns: np.ndarray,
    d_x: np.ndarray,
    d_y: np.ndarray,
    result: np.ndarray,
) -> None:
    """Add the errors that the calibration causes to sigmas and covariances."""
    column, row = np.meshgrid(columns, rows)
    before = (column, row, result[2])
    after = (column + d_x, row + d_y, result[2] + result[5])
    added = calibration_covariance(calibration, before, after, orientation)
    for sigma, variance in zip(result[6:9], added[:3], strict=True):
        np.sqrt(sigma**2 + variance, out=sigma)
    result[9:12] += added[3:]


def _noise_gain(kernel: np.ndarray) -> np.ndarray:
    """Return what filtering does to the variance of interpolated noise, at fractions from 0 to 1 of a pixel.

    Neighbours of a filtered map err alike, so that their weighted sum is noisier than one of independent values with
    the same variances.
    """
    both_sides = np.pad(np.concatenate([kernel[:0:-1], kernel]), (0, 3))
    overlap = np.array([both_sides[: len(both_sides) - lag] @ both_sides[lag:] for lag in range(4)])
    correlation = overlap[np.abs(np.subtract.outer(range(4), range(4)))] / overlap[0]
    weights = np.array([cubic(fraction) for fraction in np.linspace(0.0, 1.0, _GAIN_STEPS + 1)])
    return np.einsum("fi,ij,fj->f", weights, correlation, weights) / np.sum(weights**2, axis=1)


@njit(cache=True, nogil=True)
def cubic(f: float) -> tuple[float, float, float, float]:
    """Return the weights of cubic convolution (Keys 1981, a = -1/2) at the fraction f."""
    return (
        f * (-0.5 + f * (1.0 - 0.5 * f)),
        1.0 + f * f * (-2.5 + 1.5 * f),
        f * (0.5 + f * (2.0 - 1.5 * f)),
        f * f * (-0.5 + 0.5 * f),
    )


@njit(cache=True, nogil=True)
def _cubic_slope(f: float) -> tuple[float, float, float, float]:
    """Return the derivatives of `cubic` by f."""
    return (
        -0.5 + f * (2.0 - 1.5 * f),
        f * (-5.0 + 4.5 * f),
        0.5 + f * (4.0 - 4.5 * f),
        f * (-1.0 + 1.5 * f),
    )


@njit(cache=True, nogil=True)
def _squares(weight: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    return weight[0] ** 2, weight[1] ** 2, weight[2] ** 2, weight[3] ** 2


@njit(cache=True, nogil=True)
def _dot(weight: tuple[float, float, float, float], a: float, b: float, c: float, d: float) -> float:
    return weight[0] * a + weight[1] * b + weight[2] * c + weight[3] * d


@njit(cache=True, nogil=True)
def _along_row(image: np.ndarray, i: int, j: int, weight: tuple[float, float, float, float]) -> float:
    return _dot(weight, image[i, j - 1], image[i, j], image[i, j + 1], image[i, j + 2])


@njit(cache=True, nogil=True)
def _interpolate(
    z: np.ndarray,
    variance: np.ndarray,
    right: np.ndarray,
    down: np.ndarray,
    noise_gain: np.ndarray,
    s: float,
    r: float,
    slopes: bool,
) -> tuple[float, float, float, float]:
    """Return z, its variance and its derivatives by column and row at row s, column r; NaN beside holes and tears.

    Exactly on a pixel that pixel alone counts, and the derivatives, if `slopes` are asked for, are NaN where its
    neighbours are not measured.
    """
    nan = np.nan
    rows, columns = z.shape
    if not (0.0 <= s <= rows - 1.0 and 0.0 <= r <= columns - 1.0):  # NaN fails as well
        return nan, nan, nan, nan
    i, j = int(s), int(r)
    on_pixel = s == i and r == j
    if on_pixel and not slopes:
        return z[i, j], variance[i, j], nan, nan
    whole = 1 <= i < rows - 2 and 1 <= j < columns - 2
    if whole:
        whole = right[i - 1, j] and right[i, j] and right[i + 1, j] and right[i + 2, j]
        whole = whole and down[i, j - 1] and down[i, j] and down[i, j + 1] and down[i, j + 2]
    if not whole:
        return (z[i, j], variance[i, j], nan, nan) if on_pixel else (nan, nan, nan, nan)
    f, g = r - j, s - i
    across, along = cubic(f), cubic(g)
    a, b = _along_row(z, i - 1, j, across), _along_row(z, i, j, across)
    c, d = _along_row(z, i + 1, j, across), _along_row(z, i + 2, j, across)
    value = _dot(along, a, b, c, d)
    by_row = _dot(_cubic_slope(g), a, b, c, d)
    slope = _cubic_slope(f)
    by_column = _dot(
        along,
        _along_row(z, i - 1, j, slope),
        _along_row(z, i, j, slope),
        _along_row(z, i + 1, j, slope),
        _along_row(z, i + 2, j, slope),
    )
    square = _squares(across)
    spread = _dot(
        _squares(along),
        _along_row(variance, i - 1, j, square),
        _along_row(variance, i, j, square),
        _along_row(variance, i + 1, j, square),
        _along_row(variance, i + 2, j, square),
    )
    fine = len(noise_gain) - 1
    gain = noise_gain[int(f * fine + 0.5)] * noise_gain[int(g * fine + 0.5)]
    return value, spread * gain, by_column, by_row


@njit(cache=True, nogil=True)
def _ray(ray: np.ndarray, s: float, r: float) -> tuple[float, float, float]:
    """Return the slope of the line of sight at row s, column r, and its derivatives by column and row; bilinear."""
    rows, columns = ray.shape
    if not (0.0 <= s <= rows - 1.0 and 0.0 <= r <= columns - 1.0):
        return np.nan, np.nan, np.nan
    i, j = min(int(s), rows - 2), min(int(r), columns - 2)
    f, g = r - j, s - i
    a, b, c, d = float(ray[i, j]), float(ray[i, j + 1]), float(ray[i + 1, j]), float(ray[i + 1, j + 1])
    by_column = (1.0 - g) * (b - a) + g * (d - c)
    by_row = (1.0 - f) * (c - a) + f * (d - b)
    if s == int(s) and r == int(r):  # the neighbours of that pixel need not be measured
        return float(ray[int(s), int(r)]), by_column, by_row
    return (1.0 - g) * ((1.0 - f) * a + f * b) + g * ((1.0 - f) * c + f * d), by_column, by_row


@njit(cache=True, nogil=True)
def _nearest(values: np.ndarray, s: float, r: float) -> float:
    rows, columns = values.shape
    if not (0.0 <= s <= rows - 1.0 and 0.0 <= r <= columns - 1.0):
        return np.nan
    return values[int(s + 0.5), int(r + 0.5)]


@njit(cache=True, nogil=True, parallel=True)
def _couple(
    z: np.ndarray,
    variance: np.ndarray,
    right: np.ndarray,
    down: np.ndarray,
    rays: np.ndarray,
    z_after: np.ndarray,
    variance_after: np.ndarray,
    right_after: np.ndarray,
    down_after: np.ndarray,
    rays_after: np.ndarray,
    displacement_x: np.ndarray,
    displacement_y: np.ndarray,
    sigma_x: np.ndarray,
    sigma_y: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    noise_gain: np.ndarray,
    h0: float,
    result: np.ndarray,
) -> None:
    for i in prange(len(rows)):
        for j in range(len(columns)):
            s, r = rows[i], columns[j]
            height, spread, _, _ = _interpolate(z, variance, right, down, noise_gain, s, r, False)
            ray_x, ray_y = _ray(rays[0], s, r)[0], _ray(rays[1], s, r)[0]
            x, y = ray_x * (height - h0), ray_y * (height - h0)
            result[12, i, j] = math.sqrt(_nearest(variance, s, r))

            s, r = s + displacement_y[i, j], r + displacement_x[i, j]
            after, spread_after, z_r, z_s = _interpolate(
                z_after, variance_after, right_after, down_after, noise_gain, s, r, True
            )
            ray_x_after, ray_x_r, ray_x_s = _ray(rays_after[0], s, r)
            ray_y_after, ray_y_r, ray_y_s = _ray(rays_after[1], s, r)
            # derivatives of x' = ray_x (z' - h0) by column and row of the deformed image
            x_r, x_s = ray_x_r * (after - h0) + ray_x_after * z_r, ray_x_s * (after - h0) + ray_x_after * z_s
            y_r, y_s = ray_y_r * (after - h0) + ray_y_after * z_r, ray_y_s * (after - h0) + ray_y_after * z_s
            d_r, d_s = sigma_x[i, j] * sigma_x[i, j], sigma_y[i, j] * sigma_y[i, j]

            result[0, i, j] = x
            result[1, i, j] = y
            result[2, i, j] = height
            result[3, i, j] = ray_x_after * (after - h0) - x
            result[4, i, j] = ray_y_after * (after - h0) - y
            result[5, i, j] = after - height
            xz, yz = ray_x * spread, ray_y * spread
            xz_after, yz_after = ray_x_after * spread_after, ray_y_after * spread_after
            result[6, i, j] = math.sqrt(x_r * x_r * d_r + x_s * x_s * d_s + ray_x * xz + ray_x_after * xz_after)
            result[7, i, j] = math.sqrt(y_r * y_r * d_r + y_s * y_s * d_s + ray_y * yz + ray_y_after * yz_after)
            result[8, i, j] = math.sqrt(z_r * z_r * d_r + z_s * z_s * d_s + spread + spread_after)
            result[9, i, j] = x_r * y_r * d_r + x_s * y_s * d_s + ray_y * xz + ray_y_after * xz_after
            result[10, i, j] = x_r * z_r * d_r + x_s * z_s * d_s + xz + xz_after
            result[11, i, j] = y_r * z_r * d_r + y_s * z_s * d_s + yz + yz_after
            result[13, i, j] = math.sqrt(_nearest(variance_after, s, r))
