"""What a measured displacement leaves of the difference between two textures."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from fringedic.errors import CorrelationError, ErrorCode
from fringedic.wording.arguments import array, check_arguments, whole

_LEAST = 3  # brightness and contrast can be fitted to so many points
_NO_TEXTURE = 1e-6  # of the mean: rounding of single precision


@check_arguments(CorrelationError, reference=array(2), deformed=array(2), spacing=whole(1))
def grey_residual(
    reference: np.ndarray,
    deformed: np.ndarray,
    displacement_x: np.ndarray,
    displacement_y: np.ndarray,
    spacing: int = 1,
) -> np.ndarray:
    """Return the grey-level residual, deformed(p + d(p)) - reference(p), after a common change of brightness.

    It contains what the displacement does not explain: noise, changes of the texture and of the light, and motion that
    the subset averages. Gain and offset of the deformed image are those of the least squares over all points.

    Parameters
    ----------
    reference, deformed
        Textures (row, column) [grey level]; NaN is not measured.
    displacement_x, displacement_y
        Displacement to the right and down [px] at the first, and every further `spacing`-th, row and column.
    spacing
        Distance of the points [px].

    Returns
    -------
    ndarray
        float32, at the points of the displacement [grey level of the reference]; NaN where something is not measured.

    Raises
    ------
    CorrelationError
        The arrays have different shapes, or nearly no point is measured.

    Examples
    --------
    >>> texture = np.random.default_rng(1).random((40, 40))
    >>> shift = np.full((40, 40), 2.0)
    >>> residual = grey_residual(texture, np.roll(1 + 2 * texture, 2, axis=1), shift, 0 * shift)
    >>> bool(np.nanmax(np.abs(residual)) < 1e-6)
    True
    """
    at_points = reference[::spacing, ::spacing]
    if reference.shape != deformed.shape or not at_points.shape == displacement_x.shape == displacement_y.shape:
        raise CorrelationError(
            f"textures of {reference.shape} and {deformed.shape} px and a displacement of {displacement_x.shape} "
            f"points do not belong together at a spacing of {spacing} px"
        )
    row, column = spacing * np.indices(at_points.shape)
    places = np.stack([row + displacement_y, column + displacement_x]).astype(np.float64)
    known = np.isfinite(deformed)
    filled = np.where(known, deformed, np.nanmean(deformed) if known.any() else 0.0)
    moved = map_coordinates(filled, places, order=5, mode="constant", cval=np.nan)
    # nearest pixels that are not measured, and places outside of the image, are left out
    moved[map_coordinates(known.astype(np.float64), places, order=1, mode="constant", cval=0.0) < 1.0 - 1e-6] = np.nan
    inside = np.isfinite(moved) & np.isfinite(at_points)
    if np.count_nonzero(inside) < _LEAST:
        raise CorrelationError("nearly no point is measured; the residual of a displacement needs some")
    (mean, expected), spread = (
        (values[inside].mean(dtype=np.float64) for values in (moved, at_points)),
        moved[inside].std(),
    )
    if spread <= _NO_TEXTURE * abs(mean):
        raise CorrelationError("the deformed image has no texture: it is constant", code=ErrorCode.NO_TEXTURE)
    gain = np.mean((moved[inside] - mean) * (at_points[inside] - expected)) / spread**2
    return np.where(inside, gain * (moved - mean) + expected - at_points, np.nan).astype(np.float32)
