"""Displacement in the local frame of the surface: along it and normal to it (Molimard et al., section 3.3)."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from numba import njit, prange

from fringedic.errors import SurfaceError
from fringedic.surface.noise_correlation import height_correlation, height_gains
from fringedic.surface.planes import WIDEST_WINDOW, fit_planes
from fringedic.wording.arguments import check_arguments, dataset, whole

_LOCAL = {
    "u_t": ("m", "displacement along the surface, in the plane of x and z"),
    "v_t": ("m", "displacement along the surface, across u_t"),
    "w_n": ("m", "displacement normal to the surface"),
}
_SLOPES = {
    "dz_dx": ("1", "slope of the surface along x"),
    "dz_dy": ("1", "slope of the surface along y"),
}
_SIGMAS = {
    "sigma_u_t": ("m", "standard deviation of u_t"),
    "sigma_v_t": ("m", "standard deviation of v_t"),
    "sigma_w_n": ("m", "standard deviation of w_n"),
    "sigma_dz_dx": ("1", "standard deviation of dz_dx"),
    "sigma_dz_dy": ("1", "standard deviation of dz_dy"),
}
_COVARIANCE = ("sigma_u", "sigma_v", "sigma_w", "cov_uv", "cov_uw", "cov_vw")


@check_arguments(SurfaceError, displacement_3d=dataset("x", "y", "z", "u", "v", "w"), window=whole(high=WIDEST_WINDOW))
def to_local_frame(displacement_3d: xr.Dataset, *, window: int = 21) -> xr.Dataset:
    """Project the displacement on the reference surface: two components along it and one normal to it.

    The basis is t1 along (1, 0, dz/dx), n the upward normal, t2 = n x t1. The slopes are those of the plane z(x, y)
    fitted by least squares to the points of the window: this is the low-pass filter that the derivatives need.

    Parameters
    ----------
    displacement_3d
        From `couple`.
    window
        Width of the window [px of the reference image]; slopes are NaN where less than half of it is measured.

    Returns
    -------
    Dataset
        Over (row, column), in the precision of the input: ``u_t``, ``v_t`` along t1 and t2 and ``w_n`` along n [m],
        ``dz_dx`` and ``dz_dy`` [1]. Where the errors are known, ``sigma_u_t``, ``sigma_v_t``, ``sigma_w_n`` [m] from
        those of u, v, w and of the slopes, ``sigma_dz_dx``, ``sigma_dz_dy`` [1], and the attribute
        ``slope_noise_gain``: the noise of the slopes over that of differences between the two neighbours of each point.

    Raises
    ------
    SurfaceError
        The window contains fewer than 3 x 3 points.

    References
    ----------
    J. Molimard, G. Boyer, H. Zahouani, "Frequency-based image analysis of random patterns: an alternative way to
    classical stereocorrelation", section 3.3.

    Examples
    --------
    A surface inclined by 45 degrees that moves along z: half of the motion is normal to it.

    >>> import numpy as np, xarray as xr
    >>> x, y = np.meshgrid(1e-4 * np.arange(40), -1e-4 * np.arange(30))
    >>> fields = {"x": x, "y": y, "z": x, "u": 0 * x, "v": 0 * x, "w": 0 * x + 1e-3}
    >>> arrays = {name: (("row", "column"), values) for name, values in fields.items()}
    >>> cloud = xr.Dataset(arrays, {"row": np.arange(30), "column": np.arange(40)})
    >>> local = to_local_frame(cloud)
    >>> [round(1e3 * float(local[name].mean()), 3) for name in ("u_t", "v_t", "w_n")]
    [0.707, 0.0, 0.707]
    """
    known_errors = all(name in displacement_3d for name in ("noise_z", *_COVARIANCE))
    planes = fit_planes(displacement_3d, ("z",), window, ("noise_z",) if known_errors else ())
    z_x, z_y = planes.slopes[0]
    kind = z_x.dtype
    moved = np.stack([np.asarray(displacement_3d[name], kind) for name in "uvw"])
    local = np.empty_like(moved)
    _project(z_x, z_y, moved, local)
    fields = dict(zip((*_LOCAL, *_SLOPES), (*local, z_x, z_y), strict=True))
    units, attributes = {**_LOCAL, **_SLOPES}, dict[str, float]({"window_px": window})
    if known_errors:
        spacing = (round(planes.spacing[0]), round(planes.spacing[1]))
        z_filter = float(displacement_3d.attrs["z_filter_px"])
        gains = height_gains(z_filter, False, planes.half, spacing)
        covariance = np.stack([np.asarray(displacement_3d[name], kind) for name in _COVARIANCE])
        sigmas = np.empty((len(_SIGMAS), *z_x.shape), kind)
        _propagate(z_x, z_y, moved, covariance, planes.white, planes.means[0], gains, sigmas)
        fields |= zip(_SIGMAS, sigmas, strict=True)
        units |= _SIGMAS
        rows, columns = planes.half
        offsets = np.arange(-columns, columns + 1) * spacing[1]
        plane = gains[0] / ((2 * rows + 1) * float(offsets @ offsets))
        along = height_correlation(z_filter, False)
        lag = 2 * spacing[1]
        difference = 2 * (1 - (along[lag] if lag < len(along) else 0.0)) / lag**2
        attributes["slope_noise_gain"] = math.sqrt(plane / difference)
    return xr.Dataset(
        {
            name: (("row", "column"), values, {"units": units[name][0], "long_name": units[name][1]})
            for name, values in fields.items()
        },
        coords={name: displacement_3d.coords[name] for name in ("row", "column")},
        attrs=attributes,
    )


@njit(cache=True, nogil=True, parallel=True)
def _project(z_x: np.ndarray, z_y: np.ndarray, moved: np.ndarray, local: np.ndarray) -> None:
    """Compute u_t, v_t, w_n from the slopes and (u, v, w)."""
    rows, columns = z_x.shape
    for i in prange(rows):
        for j in range(columns):
            a, b = float(z_x[i, j]), float(z_y[i, j])
            u, v, w = moved[0, i, j], moved[1, i, j], moved[2, i, j]
            along, upright = math.sqrt(1.0 + a * a), math.sqrt(1.0 + a * a + b * b)
            local[0, i, j] = (u + a * w) / along
            local[1, i, j] = (-a * b * u + along * along * v + b * w) / (along * upright)
            local[2, i, j] = (w - a * u - b * v) / upright


@njit(cache=True, nogil=True)
def _variance_along(covariance: np.ndarray, i: int, j: int, x: float, y: float, z: float) -> float:
    """Return the variance of the component of (u, v, w) along (x, y, z)."""
    uu, vv, ww = covariance[0, i, j], covariance[1, i, j], covariance[2, i, j]
    crossed = x * y * covariance[3, i, j] + x * z * covariance[4, i, j] + y * z * covariance[5, i, j]
    return float(x * x * uu * uu + y * y * vv * vv + z * z * ww * ww + 2.0 * crossed)


@njit(cache=True, nogil=True, parallel=True)
def _propagate(
    z_x: np.ndarray,
    z_y: np.ndarray,
    moved: np.ndarray,
    covariance: np.ndarray,
    white: np.ndarray,
    noise: np.ndarray,
    gains: np.ndarray,
    sigmas: np.ndarray,
) -> None:
    """Propagate the errors of u, v, w, and those of the slopes a, b by the derivatives of the projection.

    Errors of slopes over a symmetric window are independent of that of its centre, so both parts add up.
    """
    rows, columns = z_x.shape
    for i in prange(rows):
        for j in range(columns):
            a, b = float(z_x[i, j]), float(z_y[i, j])
            u, v, w = moved[0, i, j], moved[1, i, j], moved[2, i, j]
            l2, n2 = 1.0 + a * a, 1.0 + a * a + b * b
            along, upright = math.sqrt(l2), math.sqrt(n2)
            aa = noise[i, j] * gains[0] * white[0, i, j]
            bb = noise[i, j] * gains[1] * white[1, i, j]
            ab = noise[i, j] * math.sqrt(gains[0] * gains[1]) * white[2, i, j]
            v_t = (-a * b * u + l2 * v + b * w) / (along * upright)
            w_n = (w - a * u - b * v) / upright
            u_a = (w - a * u) / (l2 * along)
            v_a = (-b * u + 2.0 * a * v) / (along * upright) - v_t * a * (1.0 / l2 + 1.0 / n2)
            v_b = (-a * u + w) / (along * upright) - v_t * b / n2
            w_a = -u / upright - w_n * a / n2
            w_b = -v / upright - w_n * b / n2
            t1 = _variance_along(covariance, i, j, 1.0 / along, 0.0, a / along)
            t2 = _variance_along(covariance, i, j, -a * b / (along * upright), along / upright, b / (along * upright))
            n = _variance_along(covariance, i, j, -a / upright, -b / upright, 1.0 / upright)
            sigmas[0, i, j] = math.sqrt(t1 + u_a * u_a * aa)
            sigmas[1, i, j] = math.sqrt(t2 + v_a * v_a * aa + 2.0 * v_a * v_b * ab + v_b * v_b * bb)
            sigmas[2, i, j] = math.sqrt(n + w_a * w_a * aa + 2.0 * w_a * w_b * ab + w_b * w_b * bb)
            sigmas[3, i, j] = math.sqrt(aa)
            sigmas[4, i, j] = math.sqrt(bb)
