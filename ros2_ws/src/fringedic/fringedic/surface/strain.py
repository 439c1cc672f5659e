"""Strain of the surface in its own tangent plane, its uncertainty, and measures that follow from it."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
import xarray as xr
from numba import njit, prange

from fringedic.errors import SurfaceError
from fringedic.surface.coarse_grid import by_point, interpolate_column, interpolate_row, step_of
from fringedic.surface.curvature import (
    add_covariances,
    inverse_root,
    point_slopes,
    second_derivatives,
    turn_of_basis,
    window_moments,
)
from fringedic.surface.discontinuities import find_discontinuities
from fringedic.surface.noise_correlation import displacement_gains, height_gains
from fringedic.surface.planes import WIDEST_WINDOW, Planes, fit_planes
from fringedic.surface.resolution import estimate_resolution, smoothing_gain
from fringedic.surface.strain_measures import GREEN_LAGRANGE, MEASURES, TENSORS, SurfaceStrain, require_measures
from fringedic.wording.arguments import check_arguments, dataset, number, several, text, whole

_ERRORS = ("noise_z", "noise_z_deformed", "displacement_sigma_x", "displacement_sigma_y")
_STRAIN = {
    "e_11": ("1", "strain along t1"),
    "e_22": ("1", "strain along t2"),
    "e_12": ("1", "tensor shear strain"),
    "e_1": ("1", "larger principal strain"),
    "e_2": ("1", "smaller principal strain"),
    "direction": ("rad", "angle of the larger principal strain from t1 towards t2"),
}
_SIGMAS = {
    "sigma_e_11": ("1", "standard deviation of e_11"),
    "sigma_e_22": ("1", "standard deviation of e_22"),
    "sigma_e_12": ("1", "standard deviation of e_12"),
}
_RESOLUTIONS = {
    "resolution_e_11": ("1", "expected error of e_11 by the smoothing of its window"),
    "resolution_e_22": ("1", "expected error of e_22 by the smoothing of its window"),
    "resolution_e_12": ("1", "expected error of e_12 by the smoothing of its window"),
}


@check_arguments(
    SurfaceError,
    displacement_3d=dataset("x", "y", "z", "u", "v", "w"),
    window=whole(high=WIDEST_WINDOW),
    measures=several(text),
    slope_noise=number(0.0),
)
def surface_strain(
    displacement_3d: xr.Dataset, *, window: int, measures: Iterable[str] = (), slope_noise: float = 1.0
) -> xr.Dataset:
    """Return the Green-Lagrange strain of the surface in its tangent plane.

    Least-squares planes of z, u, v and w over (x, y) in the window give the tangent vectors of the surface before,
    A1 = (1, 0, z_x) and A2 = (0, 1, z_y), and after, a_i = A_i + (u, v, w)_i. The strain is half the difference of
    their scalar products, in the basis t1, t2 of `to_local_frame`. The curvature of the surface within the window is
    included to second order, see `fringedic.surface.curvature`. A rigid motion gives zero on any surface.

    The standard deviations follow from the independent errors that `couple` returns: noise of both heights along the
    lines of sight and noise of the in-plane displacement, propagated through the planes and the scalar products to
    first order, with the correlation of neighbouring errors.

    Windows do not extend across a discontinuity, see `find_discontinuities`: a jump of height or displacement beyond
    its errors. Points whose displacement was measured with both sides of it are NaN.

    Parameters
    ----------
    displacement_3d
        From `couple`.
    window
        Width of the window [px of the reference image]; the strain is NaN where its centre, or more than half of it, is
        not measured or not connected with its centre.
    measures
        Further fields computed from the strain:

        - ``von_mises``: ``e_von_mises`` = 2/sqrt(3) sqrt(e_1^2 + e_1 e_2 + e_2^2), the equivalent strain of an
          incompressible material, whose strain across the surface, which is not measured, is -(e_1 + e_2). It equals
          abs(e_1) in uniaxial tension.
        - ``area_change``: change of the surface's area over its area, without any assumption on the thickness.
        - ``hencky``: logarithmic strain ``h_11``, ``h_22``, ``h_12``, ``h_1``, ``h_2``; principal values are
          ln(1 + 2 e)/2 in the same directions.
        - ``engineering``: ``elongation_1``, ``elongation_2`` of lines along t1 and t2, and ``shear_angle``, the
          decrease of the right angle between them [rad].
    slope_noise
        Variance of the slopes of the in-plane noise over that on a texture of uniform contrast.

    Returns
    -------
    Dataset
        Over (row, column), in the precision of the input: ``e_11``, ``e_22``, ``e_12`` (tensor shear, half the
        engineering one), principal values ``e_1`` >= ``e_2`` [1], and ``direction`` [rad] of the first one: its angle
        from t1 towards t2, in (-pi/2, pi/2]. Where the errors and the window of the in-plane displacement are known,
        the standard deviations ``sigma_e_11``, ``sigma_e_22``, ``sigma_e_12`` and the expected errors by the smoothing
        of the window ``resolution_e_11``, ``resolution_e_22``, ``resolution_e_12``, see
        `fringedic.surface.resolution`. The attributes ``virtual_strain_gauge_px`` and ``virtual_strain_gauge_mm`` are
        the length that a value is measured over: from the first to the last point of the window, plus the window of the
        in-plane displacement where it is known.

    Raises
    ------
    SurfaceError
        The window contains fewer than 3 x 3 points, or a measure is unknown.

    References
    ----------
    M. A. Sutton, J.-J. Orteu, H. W. Schreier (2009), Image correlation for shape, motion and deformation measurements,
    Springer, for the strain of a curved surface in its tangent plane.

    Examples
    --------
    A plate that is stretched by 1 % along x: e_11 = 0.01 + 0.01^2 / 2.

    >>> import numpy as np, xarray as xr
    >>> x, y = np.meshgrid(1e-4 * np.arange(40), -1e-4 * np.arange(30))
    >>> fields = {"x": x, "y": y, "z": 0 * x, "u": 0.01 * x, "v": 0 * x, "w": 0 * x}
    >>> arrays = {name: (("row", "column"), values) for name, values in fields.items()}
    >>> cloud = xr.Dataset(arrays, {"row": np.arange(30), "column": np.arange(40)})
    >>> strain = surface_strain(cloud, window=9, measures=["engineering"])
    >>> round(float(strain.e_11.mean()), 6), round(float(strain.elongation_1.mean()), 6)
    (0.01005, 0.01)
    """
    return compute_strain(displacement_3d, window, measures, slope_noise)


def compute_strain(
    displacement_3d: xr.Dataset,
    window: int,
    measures: Iterable[str],
    slope_noise: float = 1.0,
    tensor: str = GREEN_LAGRANGE,
) -> xr.Dataset:
    """Return what `surface_strain` returns, with the strain in one of `TENSORS`."""
    measures = require_measures(measures)
    attributes = displacement_3d.attrs
    known_errors = "displacement_window_px" in attributes and all(name in displacement_3d for name in _ERRORS)
    discontinuous = find_discontinuities(displacement_3d) if known_errors else None
    planes = fit_planes(displacement_3d, ("z", "u", "v", "w"), window, _ERRORS if known_errors else (), discontinuous)
    strain = np.empty((len(_STRAIN), *planes.slopes.shape[2:]), planes.slopes.dtype)
    step = step_of(planes.half)
    _compute_green_lagrange(
        planes.slopes,
        planes.white,
        planes.fields,
        planes.centres,
        planes.number,
        by_point(second_derivatives(planes, step)),
        step,
        strain,
    )
    found, converted = SurfaceStrain(*strain), tensor != GREEN_LAGRANGE
    if known_errors:
        sigmas = _compute_sigmas(displacement_3d, planes, slope_noise, covariances=converted)
        if converted:
            sigmas = TENSORS[tensor].convert_sigmas(found, np.concatenate([sigmas[:3] ** 2, sigmas[3:]]))
    if converted:
        found = TENSORS[tensor].convert(found)
        strain = np.stack([getattr(found, name) for name in _STRAIN])
    fields = dict(zip(_STRAIN, strain, strict=True))
    units = dict(_STRAIN)
    if known_errors:
        fields |= zip(_SIGMAS, sigmas, strict=True)
        gain = smoothing_gain(*_displacement_filter(displacement_3d), planes.half, _whole_spacing(planes), step)
        fields |= zip(_RESOLUTIONS, estimate_resolution(strain[:3], sigmas, planes.half, step, gain), strict=True)
        units |= {**_SIGMAS, **_RESOLUTIONS}
    for measure in (MEASURES[name] for name in measures):
        fields |= zip(measure.fields, measure.compute(found), strict=True)
        units |= measure.fields
    length = max(planes.width_px) + float(displacement_3d.attrs.get("displacement_window_px", 1))
    steps = (
        np.diff(np.asarray(displacement_3d["x"])[:: max(1, displacement_3d.sizes["row"] // 50)], axis=-1)
        / planes.spacing[1]
    )
    steps = steps[np.isfinite(steps)]
    pixel = abs(float(np.median(steps))) if len(steps) else math.nan
    return xr.Dataset(
        {
            name: (("row", "column"), values, {"units": units[name][0], "long_name": units[name][1]})
            for name, values in fields.items()
        },
        coords={name: displacement_3d.coords[name] for name in ("row", "column")},
        attrs={
            "window_px": window,
            "virtual_strain_gauge_px": length,
            "virtual_strain_gauge_mm": 1e3 * length * pixel,
        },
    )


def _whole_spacing(planes: Planes) -> tuple[int, int]:
    return round(planes.spacing[0]), round(planes.spacing[1])


def _displacement_filter(cloud: xr.Dataset) -> tuple[int, str]:
    """Return window [px] and method of the in-plane displacement."""
    return int(cloud.attrs["displacement_window_px"]), str(cloud.attrs.get("displacement_method", "dense"))


def _compute_sigmas(cloud: xr.Dataset, planes: Planes, slope_noise: float, covariances: bool) -> np.ndarray:
    """Return the standard deviations (3, row, column) of e_11, e_22, e_12.

    Their covariances, if wanted, follow: of e_11 and e_22, e_11 and e_12, e_22 and e_12 (6, row, column).
    """
    spacing = _whole_spacing(planes)
    z_filter = float(cloud.attrs["z_filter_px"])
    in_plane = slope_noise * displacement_gains(*_displacement_filter(cloud), planes.half, spacing)
    gains = np.array([height_gains(z_filter, after, planes.half, spacing) for after in (False, True)])
    h0 = float(cloud.attrs["camera_distance"])
    sigmas = np.empty((6 if covariances else 3, *planes.slopes.shape[2:]), planes.slopes.dtype)
    few = {name: slice(None, None, max(1, cloud.sizes[name] // 50)) for name in ("row", "column")}
    some = cloud[["x", "y", "z"]].isel(few)
    row, column = (each.astype(float) for each in np.meshgrid(some.row, some.column, indexing="ij"))
    depth = np.asarray(some.z, float) - h0
    known = np.isfinite(depth)
    if np.count_nonzero(known) < 3:
        by_pixel = np.full((2, 2), np.nan)
    else:
        basis = np.stack([column[known], row[known], np.ones(np.count_nonzero(known))], axis=-1)
        rays = np.stack([(np.asarray(some[name], float) / depth)[known] for name in ("x", "y")], axis=-1)
        by_pixel = np.ascontiguousarray(np.linalg.lstsq(basis, rays, rcond=None)[0][:2].T)
    _propagate(
        planes.slopes,
        planes.white,
        planes.means,
        planes.fields,  # x, y, z, u, v, w
        by_pixel,
        h0,
        np.stack([*gains, in_plane, in_plane]),
        sigmas,
    )
    return sigmas


@njit(cache=True, nogil=True)
def _local_basis(z_x: float, z_y: float) -> tuple[float, float, float]:
    """Return p, q, r of t1 = p A1, t2 = q A1 + r A2, orthonormal."""
    squared = 1.0 + z_x * z_x
    r = math.sqrt(squared / (squared + z_y * z_y))
    return 1.0 / math.sqrt(squared), -r * z_x * z_y / squared, r


@njit(cache=True, nogil=True)
def _metric_change(
    slopes: np.ndarray, i: int, j: int
) -> tuple[float, float, float, float, float, float, float, float, float, float, float]:
    """Return (a_i . a_j - A_i . A_j)/2 with a_i = A_i + (u, v, w)_i for xx, yy, xy, and the slopes."""
    z_x, z_y = float(slopes[0, 0, i, j]), float(slopes[0, 1, i, j])
    u_x, u_y = float(slopes[1, 0, i, j]), float(slopes[1, 1, i, j])
    v_x, v_y = float(slopes[2, 0, i, j]), float(slopes[2, 1, i, j])
    w_x, w_y = float(slopes[3, 0, i, j]), float(slopes[3, 1, i, j])
    e_xx = u_x + z_x * w_x + 0.5 * (u_x * u_x + v_x * v_x + w_x * w_x)
    e_yy = v_y + z_y * w_y + 0.5 * (u_y * u_y + v_y * v_y + w_y * w_y)
    e_xy = 0.5 * (u_y + v_x + z_x * w_y + z_y * w_x + u_x * u_y + v_x * v_y + w_x * w_y)
    return e_xx, e_yy, e_xy, z_x, z_y, u_x, u_y, v_x, v_y, w_x, w_y


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _compute_green_lagrange(
    slopes: np.ndarray,
    white: np.ndarray,
    positions: np.ndarray,
    centres: np.ndarray,
    number: np.ndarray,
    second: np.ndarray,
    step: int,
    strain: np.ndarray,
) -> None:
    """Compute the strain in the basis t1 = A1/|A1|, t2 = n x t1 of each point, and its principal values."""
    rows, columns = slopes.shape[2:]
    for i in prange(rows):
        line, derivatives = np.empty(second.shape[1:]), np.empty(second.shape[2])
        missed, plane = np.empty(6), np.empty((4, 2))
        interpolate_row(second, step, i, line)
        for j in range(columns):
            if not math.isfinite(number[i, j]):
                strain[:, i, j] = np.nan
                continue
            e_xx, e_yy, e_xy, z_x, z_y, _, _, _, _, _, _ = _metric_change(slopes, i, j)
            for field in range(4):
                plane[field, 0], plane[field, 1] = slopes[field, 0, i, j], slopes[field, 1, i, j]
            interpolate_column(line, step, j, derivatives)
            moments = window_moments(white, number[i, j], i, j)
            add_covariances(plane, derivatives, moments, missed)
            e_xx, e_yy, e_xy = e_xx + missed[0], e_yy + missed[1], e_xy + missed[2]
            g_xx, g_yy, g_xy = missed[3], missed[4], missed[5]
            p, q, r = _local_basis(z_x, z_y)
            e_11, e_22, e_12 = _in_basis(p, q, r, e_xx, e_yy, e_xy)
            g_11, g_22, g_12 = _in_basis(p, q, r, g_xx, g_yy, g_xy)
            s_11, s_22, s_12 = inverse_root(g_11, g_22, g_12)
            to_x, to_y = point_slopes(
                z_x,
                z_y,
                derivatives,
                moments,
                float(centres[0, i, j]) - float(positions[0, i, j]),
                float(centres[1, i, j]) - float(positions[1, i, j]),
            )
            sine = turn_of_basis(z_x, z_y, to_x, to_y)
            cosine = 1.0 - 0.5 * sine * sine
            # rows of the root, turned
            a_1, a_2 = cosine * s_11 - sine * s_12, cosine * s_12 - sine * s_22
            b_1, b_2 = sine * s_11 + cosine * s_12, sine * s_12 + cosine * s_22
            e_11, e_22, e_12 = (
                a_1 * a_1 * e_11 + 2.0 * a_1 * a_2 * e_12 + a_2 * a_2 * e_22,
                b_1 * b_1 * e_11 + 2.0 * b_1 * b_2 * e_12 + b_2 * b_2 * e_22,
                a_1 * b_1 * e_11 + (a_1 * b_2 + a_2 * b_1) * e_12 + a_2 * b_2 * e_22,
            )
            centre = 0.5 * (e_11 + e_22)
            radius = math.sqrt(0.25 * (e_11 - e_22) ** 2 + e_12 * e_12)
            strain[0, i, j] = e_11
            strain[1, i, j] = e_22
            strain[2, i, j] = e_12
            strain[3, i, j] = centre + radius
            strain[4, i, j] = centre - radius
            strain[5, i, j] = 0.5 * math.atan2(2.0 * e_12, e_11 - e_22)


@njit(cache=True, nogil=True)
def _in_basis(p: float, q: float, r: float, xx: float, yy: float, xy: float) -> tuple[float, float, float]:
    """Return 11, 22, 12 of a covariant tensor in the basis of `_local_basis`."""
    return p * p * xx, q * q * xx + 2.0 * q * r * xy + r * r * yy, p * (q * xx + r * xy)


@njit(cache=True, nogil=True, parallel=True)
def _propagate(
    slopes: np.ndarray,
    white: np.ndarray,
    means: np.ndarray,
    positions: np.ndarray,
    pixel: np.ndarray,
    h0: float,
    gains: np.ndarray,
    sigmas: np.ndarray,
) -> None:
    """Compute the standard deviations of e_11, e_22, e_12, and in arrays of six maps their covariances.

    An independent error n of a source moves the point before by b n and the point after by c n. To first order, and
    with the fitted slopes over x, y that carry the same error, the strain of the metric changes by

        e_xx: m_x N_x,   e_yy: m_y N_y,   e_xy: (m_x N_y + m_y N_x)/2
        m_i = a_i . c - A_i . b - 2 (e_ix b_x + e_iy b_y)

    where N_x and N_y are the slopes of the plane through n. In the basis t1, t2 both m and N transform as derivatives.
    The sources are the heights before and after, which move points along their lines of sight, and the displacement by
    one column and one row, which moves the point after along its surface.
    """
    rows, columns = slopes.shape[2:]
    for i in prange(rows):
        for j in range(columns):
            e_xx, e_yy, e_xy, z_x, z_y, u_x, u_y, v_x, v_y, w_x, w_y = _metric_change(slopes, i, j)
            p, q, r = _local_basis(z_x, z_y)
            x, y, z = float(positions[0, i, j]), float(positions[1, i, j]), float(positions[2, i, j])
            ray_x, ray_y = x / (z - h0), y / (z - h0)
            depth = z + positions[5, i, j] - h0
            after_x, after_y = (x + positions[3, i, j]) / depth, (y + positions[4, i, j]) / depth
            a_xx, a_xy, a_xz = 1.0 + u_x, v_x, z_x + w_x
            a_yx, a_yy, a_yz = u_y, 1.0 + v_y, z_y + w_y
            normal_x = a_xy * a_yz - a_xz * a_yy
            normal_y = a_xz * a_yx - a_xx * a_yz
            normal_z = a_xx * a_yy - a_xy * a_yx
            facing = normal_x * after_x + normal_y * after_y + normal_z
            variance_11, variance_22, variance_12 = 0.0, 0.0, 0.0
            covariance_11_22, covariance_11_12, covariance_22_12 = 0.0, 0.0, 0.0
            for source in range(4):
                if source == 0:
                    m_x = -(ray_x + z_x + 2.0 * (e_xx * ray_x + e_xy * ray_y))
                    m_y = -(ray_y + z_y + 2.0 * (e_xy * ray_x + e_yy * ray_y))
                elif source == 1:
                    m_x = a_xx * after_x + a_xy * after_y + a_xz
                    m_y = a_yx * after_x + a_yy * after_y + a_yz
                else:
                    turn_x, turn_y = pixel[0, source - 2], pixel[1, source - 2]
                    sink = (normal_x * turn_x + normal_y * turn_y) / facing
                    c_x, c_y, c_z = turn_x - after_x * sink, turn_y - after_y * sink, -sink
                    m_x = depth * (a_xx * c_x + a_xy * c_y + a_xz * c_z)
                    m_y = depth * (a_yx * c_x + a_yy * c_y + a_yz * c_z)
                m_1, m_2 = p * m_x, q * m_x + r * m_y
                noise = means[source, i, j]
                n_xx, n_yy = noise * gains[source, 0] * white[0, i, j], noise * gains[source, 1] * white[1, i, j]
                n_xy = noise * math.sqrt(gains[source, 0] * gains[source, 1]) * white[2, i, j]
                n_11, n_22, n_12 = _in_basis(p, q, r, n_xx, n_yy, n_xy)
                variance_11 += m_1 * m_1 * n_11
                variance_22 += m_2 * m_2 * n_22
                variance_12 += 0.25 * (m_1 * m_1 * n_22 + 2.0 * m_1 * m_2 * n_12 + m_2 * m_2 * n_11)
                covariance_11_22 += m_1 * m_2 * n_12
                covariance_11_12 += 0.5 * m_1 * (m_1 * n_12 + m_2 * n_11)
                covariance_22_12 += 0.5 * m_2 * (m_1 * n_22 + m_2 * n_12)
            sigmas[0, i, j] = math.sqrt(variance_11)
            sigmas[1, i, j] = math.sqrt(variance_22)
            sigmas[2, i, j] = math.sqrt(variance_12)
            if len(sigmas) > 3:
                sigmas[3, i, j], sigmas[4, i, j], sigmas[5, i, j] = covariance_11_22, covariance_11_12, covariance_22_12
