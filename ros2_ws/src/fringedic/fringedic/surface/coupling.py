"""3D displacement of material points: positions after minus positions before (Molimard et al., section 3.3, eq. 12)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import xarray as xr

from fringedic.errors import ImageError, SurfaceError
from fringedic.patterns.pattern import Orientation
from fringedic.rig.model import RigModel
from fringedic.rig.reconstruction import pixel_positions
from fringedic.surface.calibration_uncertainty import calibration_covariance
from fringedic.surface.coupling_kernels import InPlane, couple_points, cubic
from fringedic.surface.prepared import WIDEST_FILTER, PreparedShape, require_one_calibration, sample_gaussian
from fringedic.wording.arguments import check_arguments, dataset, either, number, of_type, optional

_GAIN_STEPS = 64  # the noise of interpolated values is tabulated at so many parts of a pixel

FIELDS = {
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


@check_arguments(
    SurfaceError,
    reference_shape=either(PreparedShape, dataset("x", "y", "z")),
    deformed_shape=either(PreparedShape, dataset("x", "y", "z")),
    displacement=dataset("displacement_x", "displacement_y", "sigma_x", "sigma_y"),
    calibration=optional(of_type(RigModel)),
    z_filter=number(high=WIDEST_FILTER),
)
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

    A point at the reference pixel p is at p + d in the deformed image. There z' is interpolated (cubic convolution) and
    x', y' follow from z' on the line of sight of p + d, which is that of x, y, z of its pixel and linear between
    pixels. With weights c_i, interpolating x' = a(p) (z' - h0) instead would add sum c_i (a_i - a) n_i of the noise n
    of z'. A higher order has no advantage: the error of the cubic is 10 nm on skin; quintic weights pass more noise.

    A point is NaN where its interpolation touches a pixel that is not measured, or a discontinuity of the surface: the
    third difference of z along four pixels exceeds 6 times its noise and the size of a pixel.

    Parameters
    ----------
    reference_shape, deformed_shape
        From `RigModel.reconstruct`, whole images or equal crops with unit steps of ``row`` and ``column``, containing
        ``x``, ``y``, ``z`` and ``noise_z`` [m]. A `PreparedShape` keeps the preparation for many couplings.
    displacement
        ``displacement_x`` (to the right), ``displacement_y`` (down), ``sigma_x``, ``sigma_y`` [px] at points of the
        reference image whose pixel positions are the coordinates ``row`` and ``column``.
    calibration
        Gives the distance of the camera, and its uncertainty is added to the sigmas; without it the distance is an
        attribute of the shapes.
    z_filter
        Standard deviation [px] of a Gaussian that smooths both z first; 0 for none. Its weights are divided by the
        variances of z; the local slope corrects for the centroid of uneven weights. The filter uses only points on both
        sides of a pixel that are measured, so that it does not cross discontinuities. It moves curved surfaces by half
        of the second moment of its weights times the curvature; the reference positions are corrected for that.
    orientation
        Direction of the fringes, for the uncertainty of the calibration.

    Returns
    -------
    Dataset
        Over (row, column), float32: reference positions ``x`` (right), ``y`` (up), ``z`` (towards the camera),
        displacement ``u``, ``v``, ``w`` and its standard deviations ``sigma_u``, ``sigma_v``, ``sigma_w`` [m] with the
        covariances ``cov_uv``, ``cov_uw``, ``cov_vw`` [m^2] at the points of `displacement`. With a filter z is the
        smoothed one, and x and y are those of its lines of sight. ``noise_z``, ``noise_z_deformed`` [m] and
        ``displacement_sigma_x``, ``displacement_sigma_y`` [px] are the independent errors behind them.

    Raises
    ------
    CalibrationError
        The shapes were made with different calibrations, or not with the given one.
    SurfaceError
        Neither a calibration nor the attributes contain the distance of the camera, or a shape was prepared with
        another filter.
    ImageError
        The shapes do not cover the same pixels, or their fields differ in size.

    References
    ----------
    J. Molimard, G. Boyer, H. Zahouani, "Frequency-based image analysis of random patterns: an alternative way to
    classical stereocorrelation", section 3.3.
    R. G. Keys (1981), Cubic convolution interpolation for digital image processing, IEEE Trans. Acoustics, Speech and
    Signal Processing 29, 1153-1160.

    Examples
    --------
    A plane that moves by 1 mm towards a camera 0.5 m above it; its points stay on their lines of sight.

    >>> import numpy as np, xarray as xr
    >>> column, row = np.meshgrid(np.arange(40.0), np.arange(30.0))
    >>> def plane(z):
    ...     x, y = 1e-4 * (column - 20) * (1 - z / 0.5), -1e-4 * (row - 15) * (1 - z / 0.5)
    ...     fields = {"x": x, "y": y, "z": z + 0 * x, "noise_z": 1e-6 + 0 * x}
    ...     arrays = {name: (("row", "column"), values) for name, values in fields.items()}
    ...     return xr.Dataset(arrays, attrs={"camera_distance": 0.5})
    >>> names = ("displacement_x", "displacement_y", "sigma_x", "sigma_y")
    >>> still = xr.Dataset({name: (("row", "column"), 0 * column) for name in names})
    >>> cloud = couple(plane(0.0), plane(1e-3), still)
    >>> round(1e3 * float(cloud.w.median()), 4), round(1e6 * float(cloud.u.sel(row=15, column=30)), 2)
    (1.0, -2.0)
    """
    before, after = (
        shape if isinstance(shape, PreparedShape) else PreparedShape(shape, z_filter=z_filter, calibration=calibration)
        for shape in (reference_shape, deformed_shape)
    )
    _require_same_preparation(before, after, z_filter)
    in_plane = InPlane(
        *(
            np.ascontiguousarray(displacement[name], np.float32)
            for name in ("displacement_x", "displacement_y", "sigma_x", "sigma_y")
        )
    )
    rows, columns = pixel_positions(displacement, in_plane.x.shape)
    result = np.empty((len(FIELDS), *in_plane.x.shape), np.float32)
    places = rows - before.rows[0], columns - before.columns[0]
    gain = _tabulate_noise_gain(z_filter)
    couple_points(before.arrays, after.arrays, in_plane, *places, gain, after.camera_distance, result)
    # Points stay on their lines of sight. Both heights have the same offset, so that their difference has none.
    offsets = before.offsets(*places)
    result[:2] *= 1 - offsets / (result[2] - before.camera_distance)
    result[2] -= offsets
    if calibration is not None and calibration.parameter_names:
        column, row = np.meshgrid(columns, rows)
        moved = (column + in_plane.x, row + in_plane.y, result[2] + result[5])
        added = calibration_covariance(calibration, (column, row, result[2]), moved, orientation)
        for sigma, variance in zip(result[6:9], added[:3], strict=True):
            np.sqrt(sigma**2 + variance, out=sigma)
        result[9:12] += added[3:]
    # Compilers differ in the sign of NaN that results from others; a replay gives the same bits with each Python.
    uncertainties = result[6:12]
    np.copyto(uncertainties, np.nan, where=np.isnan(uncertainties))
    fields = {
        name: (("row", "column"), values, {"units": units, "long_name": long_name})
        for (name, (units, long_name)), values in zip(FIELDS.items(), result, strict=True)
    }
    for name, values in (("displacement_sigma_x", in_plane.sigma_x), ("displacement_sigma_y", in_plane.sigma_y)):
        fields[name] = (
            ("row", "column"),
            values,
            {"units": "px", "long_name": f"standard deviation of displacement_{name[-1]}"},
        )
    kept = {name: displacement.attrs[name] for name in ("window_px", "method") if name in displacement.attrs}
    return xr.Dataset(
        fields,
        coords={"row": rows, "column": columns},
        attrs={
            "camera_distance": after.camera_distance,
            "z_filter_px": z_filter,
            **{f"displacement_{name}": value for name, value in kept.items()},
        },
    )


def _require_same_preparation(before: PreparedShape, after: PreparedShape, z_filter: float) -> None:
    """Check that both shapes have the requested filter, the same pixels and the same calibration."""
    for shape in (before, after):
        if shape.z_filter != z_filter:
            raise SurfaceError(
                f"a shape was prepared with a z_filter of {shape.z_filter:g} px, {z_filter:g} px is requested"
            )
    if not (np.array_equal(before.rows, after.rows) and np.array_equal(before.columns, after.columns)):
        raise ImageError(
            f"reference shape of {before.z.shape} and deformed shape of {after.z.shape} points do not cover the same "
            "pixels"
        )
    require_one_calibration(
        "reference shape and deformed shape",
        (before.calibration_identifier, after.calibration_identifier),
        (before.camera_distance, after.camera_distance),
    )


@lru_cache(maxsize=8)
def _tabulate_noise_gain(z_filter: float) -> np.ndarray:
    """Return the factor of the variance of interpolated noise by filtering, at fractions from 0 to 1 of a pixel.

    The errors of neighbours in a filtered map are correlated, so that their weighted sum is noisier than one of
    independent values with the same variances.
    """
    kernel = sample_gaussian(z_filter)
    both_sides = np.pad(np.concatenate([kernel[:0:-1], kernel]), (0, 3))
    overlap = np.array([both_sides[: len(both_sides) - lag] @ both_sides[lag:] for lag in range(4)])
    correlation = overlap[np.abs(np.subtract.outer(range(4), range(4)))] / overlap[0]
    weights = np.array([cubic(fraction) for fraction in np.linspace(0.0, 1.0, _GAIN_STEPS + 1)])
    return np.asarray(np.einsum("fi,ij,fj->f", weights, correlation, weights) / np.sum(weights**2, axis=1))
