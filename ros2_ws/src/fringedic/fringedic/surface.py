"""Material points of a surface: 3D displacement (eq. 12), its components along the surface, and the surface's strain.

The shape is known at every pixel of each step, the in-plane displacement tells which pixel a material point has moved
to. All lengths are in metre in the rig frame; NaN is "not measured".
"""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from numba import njit, prange

from fringedic.errors import InvalidWindowError, RaysMissingError, ShapeMismatchError
from fringedic.rig import RigModel, pixel_positions

JUMP = 6.0  # standard deviations of a third difference beyond which a surface is torn
_REACH = 3.0  # half-width of the Gaussian filter in standard deviations
_GAIN_STEPS = 64  # of a pixel, in which the noise of interpolated values is tabulated
_BLOCK = 64  # rows that share running sums; fixed, so that results do not depend on the number of threads
_MINIMUM_COVERAGE = 0.5  # of a window, measured


def couple(
    reference_shape: xr.Dataset,
    deformed_shape: xr.Dataset,
    displacement: xr.Dataset,
    *,
    calibration: RigModel | None = None,
    z_filter: float = 0.0,
) -> xr.Dataset:
    """Subtract the positions of the same material points before and after deformation (eq. 12).

    A point seen at the reference pixel p is seen at p + d in the deformed image. There z' is interpolated (cubic
    convolution) and x', y' follow from z' on the line of sight of p + d, which is known exactly. With weights c_i,
    interpolating x' = a(p) (z' - h0) as well would add sum c_i (a_i - a) n_i of the noise n of z', for three times the
    work. Higher orders have nothing to win: the cubic errs by 10 nm on skin, and quintic weights pass more noise on.

    A point is NaN when its interpolation touches a pixel that is not measured, or a tear of the surface: a place where
    the third difference of z along four pixels exceeds 6 times its noise and the size of a pixel.

    Parameters
    ----------
    reference_shape, deformed_shape
        From `RigModel.reconstruct`, whole images or equal crops with unit steps of ``row`` and ``column``; used are
        ``z`` and ``sigma_z`` [m].
    displacement
        ``displacement_x``, ``displacement_y``, ``sigma_x``, ``sigma_y`` [px] at points of the reference image whose
        pixel positions are the coordinates ``row`` and ``column``.
    calibration
        Where the lines of sight come from; without, from the attributes of `deformed_shape`.
    z_filter
        Standard deviation [px] of a Gaussian that smooths both z first; 0 for none. Its weights are divided by the
        variances of z, and it takes only pairs of points on opposite sides of a pixel, as far as both are measured:
        so it neither shifts slopes nor crosses tears.

    Returns
    -------
    Dataset
        Reference positions ``x``, ``y``, ``z``, displacement ``u``, ``v``, ``w`` and its standard deviations
        ``sigma_u``, ``sigma_v``, ``sigma_w`` [m] at the points of `displacement`; float32. With a filter z is the
        smoothed one, and x and y are those of its lines of sight.

    Raises
    ------
    RaysMissingError
        When neither a calibration nor the attributes tell the lines of sight.
    ShapeMismatchError
        When the shapes are not of the same pixels, or the sigmas or displacements differ in size.
    """
    camera_distance, ray_matrix = _lines_of_sight(deformed_shape, calibration)
    rows, columns = pixel_positions(reference_shape, reference_shape["z"].shape)
    for mine, other in zip((rows, columns), pixel_positions(deformed_shape, deformed_shape["z"].shape), strict=True):
        if not np.array_equal(mine, other):
            raise ShapeMismatchError(
                f"reference shape of {reference_shape['z'].shape} and deformed shape of {deformed_shape['z'].shape} "
                "points do not cover the same pixels"
            )
    d_x, d_y, sigma_x, sigma_y = (
        np.ascontiguousarray(displacement[name], np.float32)
        for name in ("displacement_x", "displacement_y", "sigma_x", "sigma_y")
    )
    point_rows, point_columns = pixel_positions(displacement, d_x.shape)
    kernel = _gaussian(z_filter)
    pixel_size = camera_distance * float(np.linalg.norm(ray_matrix[:, 0]))
    z, variance, right, down = _prepare(reference_shape, kernel, pixel_size)
    z_after, variance_after, right_after, down_after = _prepare(deformed_shape, kernel, pixel_size)
    result = np.empty((9, *d_x.shape), np.float32)
    _couple(
        z,
        variance,
        right,
        down,
        z_after,
        variance_after,
        right_after,
        down_after,
        d_x,
        d_y,
        sigma_x,
        sigma_y,
        point_rows,
        point_columns,
        rows[0],
        columns[0],
        _noise_gain(kernel),
        ray_matrix,
        camera_distance,
        result,
    )
    names = ("x", "y", "z", "u", "v", "w", "sigma_u", "sigma_v", "sigma_w")
    return xr.Dataset(
        {
            name: (("row", "column"), values, {"units": "m", "long_name": _LONG_NAMES[name]})
            for name, values in zip(names, result, strict=True)
        },
        coords={"row": point_rows, "column": point_columns},
        attrs={"camera_distance": camera_distance, "ray_matrix": ray_matrix.ravel().tolist(), "z_filter_px": z_filter},
    )


def to_local_frame(displacement_3d: xr.Dataset, *, window: int = 21) -> xr.Dataset:
    """Project the displacement on the reference surface: two components along it and one normal to it (3.3).

    The basis is t1 along (1, 0, dz/dx), n the upward normal, t2 = n x t1. The slopes are those of the plane z(x, y)
    fitted by least squares to the points of the window.

    Parameters
    ----------
    displacement_3d
        From `couple`.
    window
        Width of the window [px of the reference image]; slopes are NaN where less than half of it is measured.

    Returns
    -------
    Dataset
        ``u_t``, ``v_t`` along t1 and t2 and ``w_n`` along n [m], ``dz_dx`` and ``dz_dy`` [1].

    Raises
    ------
    InvalidWindowError
        When the window holds fewer than 3 x 3 points.
    """
    gradient = _gradients(displacement_3d, ("z",), window)
    z_x, z_y = gradient[0]
    u, v, w = (np.asarray(displacement_3d[name], float) for name in "uvw")
    along = np.sqrt(1 + z_x**2)
    upright = np.sqrt(1 + z_x**2 + z_y**2)
    local = {
        "u_t": (u + z_x * w) / along,
        "v_t": (-z_x * z_y * u + along**2 * v + z_y * w) / (along * upright),
        "w_n": (w - z_x * u - z_y * v) / upright,
    }
    return _like(
        displacement_3d,
        {name: (values, "m", _LONG_NAMES[name]) for name, values in local.items()}
        | {"dz_dx": (z_x, "1", "slope of the surface along x"), "dz_dy": (z_y, "1", "slope of the surface along y")},
        window,
    )


def surface_strain(displacement_3d: xr.Dataset, *, window: int) -> xr.Dataset:
    """Return the Green-Lagrange strain of the surface in its own tangent plane.

    Least-squares planes of z, u, v and w over (x, y) in the window give the tangent vectors of the surface before,
    A1 = (1, 0, z_x) and A2 = (0, 1, z_y), and after, a_i = A_i + (u, v, w)_i. The strain is half the difference of
    their scalar products, expressed in the basis t1, t2 of `to_local_frame`. A rigid motion gives zero on any surface.

    Parameters
    ----------
    displacement_3d
        From `couple`.
    window
        Width of the window [px of the reference image]; the strain is NaN where its centre or more than half of it is
        not measured.

    Returns
    -------
    Dataset
        ``e_11``, ``e_22``, ``e_12`` (tensor shear, half the engineering one), principal values ``e_1`` >= ``e_2``
        [1], and ``direction`` [rad] of the first one: its angle from t1 towards t2, in (-pi/2, pi/2].

    Raises
    ------
    InvalidWindowError
        When the window holds fewer than 3 x 3 points.
    """
    gradient = _gradients(displacement_3d, ("z", "u", "v", "w"), window)
    strain = np.empty((6, *gradient.shape[2:]))
    _green_lagrange(gradient, strain)
    names = ("e_11", "e_22", "e_12", "e_1", "e_2", "direction")
    return _like(
        displacement_3d,
        {
            name: (values, "rad" if name == "direction" else "1", _LONG_NAMES[name])
            for name, values in zip(names, strain, strict=True)
        },
        window,
    )


_LONG_NAMES = {
    "x": "reference position, to the right",
    "y": "reference position, upwards",
    "z": "reference position, towards the camera",
    "u": "displacement along x",
    "v": "displacement along y",
    "w": "displacement along z",
    "sigma_u": "standard deviation of u",
    "sigma_v": "standard deviation of v",
    "sigma_w": "standard deviation of w",
    "u_t": "displacement along the surface, in the plane of x and z",
    "v_t": "displacement along the surface, across u_t",
    "w_n": "displacement normal to the surface",
    "e_11": "strain along t1",
    "e_22": "strain along t2",
    "e_12": "tensor shear strain",
    "e_1": "larger principal strain",
    "e_2": "smaller principal strain",
    "direction": "angle of the larger principal strain from t1 towards t2",
}


def _lines_of_sight(shape: xr.Dataset, calibration: RigModel | None) -> tuple[float, np.ndarray]:
    if calibration is not None:
        return calibration.camera_distance, calibration.ray_matrix
    try:
        return float(shape.attrs["camera_distance"]), np.asarray(shape.attrs["ray_matrix"], float).reshape(3, 3)
    except KeyError as error:
        raise RaysMissingError(
            f"the deformed shape has no attribute {error.args[0]}: give the calibration it was made with"
        ) from None


def _prepare(
    shape: xr.Dataset, kernel: np.ndarray, pixel_size: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return z and its variance, filtered, and where they run on without a tear to the right and downwards."""
    z = np.ascontiguousarray(shape["z"], np.float32)
    variance = np.ascontiguousarray(shape["sigma_z"], np.float32) ** 2
    if variance.shape != z.shape:
        raise ShapeMismatchError(f"sigma_z of shape {variance.shape} for z of shape {z.shape}")
    # neither what the sigmas do not know of (speckle seen through blur) nor the relief of one pixel is a tear
    roughness = np.float32(max(_roughness(z), _roughness(z.T), pixel_size / JUMP))
    right = _runs_on(z, variance, roughness)
    z_turned, variance_turned = np.ascontiguousarray(z.T), np.ascontiguousarray(variance.T)
    down = _runs_on(z_turned, variance_turned, roughness)
    if len(kernel) > 1:
        sample = variance[::8, ::8][np.isfinite(z[::8, ::8])]
        typical = np.float32(np.median(sample)) if len(sample) else np.float32(np.nan)
        # close to 1, or the squares of the weights leave the range of float32
        relative = variance / typical if typical > 0 else np.ones_like(z)
        z, relative = _filter_rows(z, relative, right, kernel)
        z_turned, relative = _filter_rows(np.ascontiguousarray(z.T), np.ascontiguousarray(relative.T), down, kernel)
        z, variance = np.ascontiguousarray(z_turned.T), np.ascontiguousarray(relative.T) * typical
    return z, variance, right, np.ascontiguousarray(down.T)


def _roughness(z: np.ndarray) -> float:
    """Return the robust standard deviation of third differences along rows, 0 when there are none."""
    sample = z[:: max(1, len(z) // 100)]
    difference = np.abs(sample[:, 3:] - sample[:, :-3] - 3 * (sample[:, 2:-1] - sample[:, 1:-2]))
    difference = difference[np.isfinite(difference)]
    return 1.4826 * float(np.median(difference)) if len(difference) else 0.0


@njit(cache=True, nogil=True, parallel=True)
def _runs_on(z: np.ndarray, variance: np.ndarray, roughness: np.float32) -> np.ndarray:
    """Tell for each pixel whether the surface runs on to the next one of its row, judged by four pixels."""
    rows, columns = z.shape
    result = np.zeros((rows, columns), np.bool_)
    limit = np.float32(JUMP) ** 2
    for i in prange(rows):
        for j in range(1, columns - 2):
            third = z[i, j + 2] - z[i, j - 1] - np.float32(3) * (z[i, j + 1] - z[i, j])
            noise = variance[i, j - 1] + variance[i, j + 2] + np.float32(9) * (variance[i, j] + variance[i, j + 1])
            # a noise that is not known, NaN, is not larger either
            noise = noise if noise > roughness * roughness else roughness * roughness
            result[i, j] = third * third <= limit * noise
    return result


def _gaussian(width: float) -> np.ndarray:
    """Return one half of a Gaussian from its centre on, not normalised; its centre alone for no filter."""
    if not math.isfinite(width) or width < 0:
        raise InvalidWindowError(f"z_filter is {width}: give its standard deviation in pixels, 0 for none")
    if width == 0:
        return np.ones(1)
    return np.exp(-0.5 * (np.arange(math.ceil(_REACH * width) + 1) / width) ** 2)


def _noise_gain(kernel: np.ndarray) -> np.ndarray:
    """Return what filtering does to the variance of interpolated noise, at fractions from 0 to 1 of a pixel.

    Neighbours of a filtered map err alike, so that their weighted sum is noisier than one of independent values with
    the same variances.
    """
    both_sides = np.pad(np.concatenate([kernel[:0:-1], kernel]), (0, 3))
    overlap = np.array([both_sides[: len(both_sides) - lag] @ both_sides[lag:] for lag in range(4)])
    correlation = overlap[np.abs(np.subtract.outer(range(4), range(4)))] / overlap[0]
    weights = np.array([_cubic(fraction) for fraction in np.linspace(0.0, 1.0, _GAIN_STEPS + 1)])
    return np.einsum("fi,ij,fj->f", weights, correlation, weights) / np.sum(weights**2, axis=1)


@njit(cache=True, nogil=True, parallel=True)
def _filter_rows(
    z: np.ndarray, variance: np.ndarray, runs_on: np.ndarray, kernel: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Smooth along rows by pairs at equal distances from each pixel, as far as both sides run on.

    A pair weighs as much as its noise allows: the mean of two has the variance (v1 + v2)/4, and dark speckles have many
    times the variance of their surroundings. Being weighed together the two keep any slope.
    """
    rows, columns = z.shape
    radius = len(kernel) - 1
    smooth, noise = np.empty((rows, columns), np.float32), np.empty((rows, columns), np.float32)
    for i in prange(rows):
        reach_left = np.zeros(columns, np.int64)
        for j in range(1, columns):
            if runs_on[i, j - 1]:
                reach_left[j] = min(reach_left[j - 1] + 1, radius)
        reach_right = 0
        for j in range(columns - 1, -1, -1):
            reach_right = min(reach_right + 1, radius) if runs_on[i, j] else 0
            reach = min(reach_left[j], reach_right)
            share = kernel[0] / variance[i, j]
            total = share
            mean = share * z[i, j]
            spread = share * share * variance[i, j]
            for k in range(1, reach + 1):
                both = variance[i, j - k] + variance[i, j + k]
                share = np.float32(2) * kernel[k] / both
                total += np.float32(2) * share
                mean += share * (z[i, j - k] + z[i, j + k])
                spread += share * share * both
            smooth[i, j] = mean / total
            noise[i, j] = spread / (total * total)
    return smooth, noise


@njit(cache=True, nogil=True)
def _cubic(f: float) -> tuple[float, float, float, float]:
    """Return the weights of cubic convolution (Keys 1981, a = -1/2) at the fraction f."""
    return (
        f * (-0.5 + f * (1.0 - 0.5 * f)),
        1.0 + f * f * (-2.5 + 1.5 * f),
        f * (0.5 + f * (2.0 - 1.5 * f)),
        f * f * (-0.5 + 0.5 * f),
    )


@njit(cache=True, nogil=True)
def _cubic_slope(f: float) -> tuple[float, float, float, float]:
    """Return the derivatives of `_cubic` by f."""
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
    across, along = _cubic(f), _cubic(g)
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


@njit(cache=True, nogil=True, parallel=True)
def _couple(
    z: np.ndarray,
    variance: np.ndarray,
    right: np.ndarray,
    down: np.ndarray,
    z_after: np.ndarray,
    variance_after: np.ndarray,
    right_after: np.ndarray,
    down_after: np.ndarray,
    displacement_x: np.ndarray,
    displacement_y: np.ndarray,
    sigma_x: np.ndarray,
    sigma_y: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    first_row: float,
    first_column: float,
    noise_gain: np.ndarray,
    rays: np.ndarray,
    h0: float,
    result: np.ndarray,
) -> None:
    for i in prange(len(rows)):
        for j in range(len(columns)):
            s, r = rows[i], columns[j]
            height, spread, _, _ = _interpolate(
                z, variance, right, down, noise_gain, s - first_row, r - first_column, False
            )
            depth = rays[2, 0] * r + rays[2, 1] * s + rays[2, 2]
            ray_x = (rays[0, 0] * r + rays[0, 1] * s + rays[0, 2]) / depth
            ray_y = (rays[1, 0] * r + rays[1, 1] * s + rays[1, 2]) / depth
            x, y = ray_x * (height - h0), ray_y * (height - h0)

            s, r = s + displacement_y[i, j], r + displacement_x[i, j]
            after, spread_after, z_r, z_s = _interpolate(
                z_after,
                variance_after,
                right_after,
                down_after,
                noise_gain,
                s - first_row,
                r - first_column,
                True,
            )
            depth = rays[2, 0] * r + rays[2, 1] * s + rays[2, 2]
            ray_x_after = (rays[0, 0] * r + rays[0, 1] * s + rays[0, 2]) / depth
            ray_y_after = (rays[1, 0] * r + rays[1, 1] * s + rays[1, 2]) / depth
            # derivatives of x' = ray_x (z' - h0) by column and row of the deformed image
            x_r = (rays[0, 0] - ray_x_after * rays[2, 0]) / depth * (after - h0) + ray_x_after * z_r
            x_s = (rays[0, 1] - ray_x_after * rays[2, 1]) / depth * (after - h0) + ray_x_after * z_s
            y_r = (rays[1, 0] - ray_y_after * rays[2, 0]) / depth * (after - h0) + ray_y_after * z_r
            y_s = (rays[1, 1] - ray_y_after * rays[2, 1]) / depth * (after - h0) + ray_y_after * z_s
            d_r, d_s = sigma_x[i, j] * sigma_x[i, j], sigma_y[i, j] * sigma_y[i, j]

            result[0, i, j] = x
            result[1, i, j] = y
            result[2, i, j] = height
            result[3, i, j] = ray_x_after * (after - h0) - x
            result[4, i, j] = ray_y_after * (after - h0) - y
            result[5, i, j] = after - height
            noise_x = ray_x * ray_x * spread + ray_x_after * ray_x_after * spread_after
            noise_y = ray_y * ray_y * spread + ray_y_after * ray_y_after * spread_after
            result[6, i, j] = math.sqrt(x_r * x_r * d_r + x_s * x_s * d_s + noise_x)
            result[7, i, j] = math.sqrt(y_r * y_r * d_r + y_s * y_s * d_s + noise_y)
            result[8, i, j] = math.sqrt(z_r * z_r * d_r + z_s * z_s * d_s + spread + spread_after)


def _gradients(displacement_3d: xr.Dataset, names: tuple[str, ...], window: int) -> np.ndarray:
    """Return the slopes by x and y of least-squares planes, shape (field, 2, row, column)."""
    rows, columns = pixel_positions(displacement_3d, displacement_3d["x"].shape)
    half = [_half_width(window, positions) for positions in (rows, columns)]
    fields = np.stack([np.asarray(displacement_3d[name], float) for name in ("x", "y", *names)])
    measured = np.isfinite(fields).all(axis=0)
    fields[:, ~measured] = 0.0
    # sums of squares keep their digits around the middle; slopes do not depend on it
    middle = fields.sum(axis=(1, 2)) / max(1, np.count_nonzero(measured))
    fields -= middle[:, None, None]
    fields[:, ~measured] = 0.0
    result = np.empty((len(names), 2, *measured.shape))
    _fit_planes(fields, measured, half[0], half[1], result)
    return result


def _half_width(window: int, positions: np.ndarray) -> int:
    spacing = positions[1] - positions[0] if len(positions) > 1 else 1.0
    half = round((window - 1) / 2 / spacing)
    if half < 1:
        raise InvalidWindowError(
            f"a window of {window} px holds fewer than 3 points at a spacing of {spacing:g} px: widen it"
        )
    return half


@njit(cache=True, nogil=True, parallel=True)
def _fit_planes(
    fields: np.ndarray, measured: np.ndarray, half_rows: int, half_columns: int, result: np.ndarray
) -> None:
    """Fit planes over (fields[0], fields[1]) to the other fields by running sums over the window."""
    count, rows, columns = fields.shape
    unknowns = count - 2
    enough = _MINIMUM_COVERAGE * (2 * half_rows + 1) * (2 * half_columns + 1)
    for block in prange((rows + _BLOCK - 1) // _BLOCK):
        # of each column: number, x, y, xx, xy, yy, then f, xf, yf of each field
        sums = np.zeros((6 + 3 * unknowns, columns))
        first = block * _BLOCK
        last = min(first + _BLOCK, rows)
        for row in range(max(first - half_rows, 0), min(first + half_rows, rows)):
            _add_row(fields, measured, row, 1.0, sums)
        for row in range(first, last):
            if row + half_rows < rows:
                _add_row(fields, measured, row + half_rows, 1.0, sums)
            if row > first and row - half_rows - 1 >= 0:
                _add_row(fields, measured, row - half_rows - 1, -1.0, sums)
            total = np.zeros(len(sums))
            for column in range(min(half_columns, columns)):
                total += sums[:, column]
            for column in range(columns):
                if column + half_columns < columns:
                    total += sums[:, column + half_columns]
                if column - half_columns - 1 >= 0:
                    total -= sums[:, column - half_columns - 1]
                number = total[0]
                if not measured[row, column] or number < enough:
                    result[:, :, row, column] = np.nan
                    continue
                x, y = total[1] / number, total[2] / number
                xx = total[3] / number - x * x
                xy = total[4] / number - x * y
                yy = total[5] / number - y * y
                determinant = xx * yy - xy * xy
                for k in range(unknowns):
                    f = total[6 + 3 * k] / number
                    xf = total[7 + 3 * k] / number - x * f
                    yf = total[8 + 3 * k] / number - y * f
                    result[k, 0, row, column] = (yy * xf - xy * yf) / determinant
                    result[k, 1, row, column] = (xx * yf - xy * xf) / determinant


@njit(cache=True, nogil=True)
def _add_row(fields: np.ndarray, measured: np.ndarray, row: int, sign: float, sums: np.ndarray) -> None:
    count, _, columns = fields.shape
    for column in range(columns):
        x, y = fields[0, row, column], fields[1, row, column]
        sums[0, column] += sign * measured[row, column]
        sums[1, column] += sign * x
        sums[2, column] += sign * y
        sums[3, column] += sign * x * x
        sums[4, column] += sign * x * y
        sums[5, column] += sign * y * y
    for k in range(count - 2):
        for column in range(columns):
            f = sign * fields[k + 2, row, column]
            sums[6 + 3 * k, column] += f
            sums[7 + 3 * k, column] += fields[0, row, column] * f
            sums[8 + 3 * k, column] += fields[1, row, column] * f


@njit(cache=True, nogil=True, parallel=True)
def _green_lagrange(gradient: np.ndarray, strain: np.ndarray) -> None:
    """Strain of the tangent vectors A1, A2 in the basis t1 = A1/|A1|, t2 = n x t1, and its principal values."""
    rows, columns = gradient.shape[2:]
    for i in prange(rows):
        for j in range(columns):
            z_x, z_y = gradient[0, 0, i, j], gradient[0, 1, i, j]
            u_x, u_y = gradient[1, 0, i, j], gradient[1, 1, i, j]
            v_x, v_y = gradient[2, 0, i, j], gradient[2, 1, i, j]
            w_x, w_y = gradient[3, 0, i, j], gradient[3, 1, i, j]
            # (a_i . a_j - A_i . A_j) / 2 with a_i = A_i + (u, v, w)_i
            e_xx = u_x + z_x * w_x + 0.5 * (u_x * u_x + v_x * v_x + w_x * w_x)
            e_yy = v_y + z_y * w_y + 0.5 * (u_y * u_y + v_y * v_y + w_y * w_y)
            e_xy = 0.5 * (u_y + v_x + z_x * w_y + z_y * w_x + u_x * u_y + v_x * v_y + w_x * w_y)
            # t1 = p A1, t2 = q A1 + r A2
            squared = 1.0 + z_x * z_x
            p = 1.0 / math.sqrt(squared)
            r = math.sqrt(squared / (squared + z_y * z_y))
            q = -r * z_x * z_y / squared
            e_11 = p * p * e_xx
            e_22 = q * q * e_xx + 2.0 * q * r * e_xy + r * r * e_yy
            e_12 = p * (q * e_xx + r * e_xy)
            centre = 0.5 * (e_11 + e_22)
            radius = math.sqrt(0.25 * (e_11 - e_22) ** 2 + e_12 * e_12)
            strain[0, i, j] = e_11
            strain[1, i, j] = e_22
            strain[2, i, j] = e_12
            strain[3, i, j] = centre + radius
            strain[4, i, j] = centre - radius
            strain[5, i, j] = 0.5 * math.atan2(2.0 * e_12, e_11 - e_22)


def _like(displacement_3d: xr.Dataset, fields: dict[str, tuple[np.ndarray, str, str]], window: int) -> xr.Dataset:
    """Return fields (values, units, long name) at the points of a dataset."""
    return xr.Dataset(
        {
            name: (("row", "column"), values, {"units": units, "long_name": long_name})
            for name, (values, units, long_name) in fields.items()
        },
        coords={name: displacement_3d.coords[name] for name in ("row", "column")},
        attrs={"window_px": window},
    )
