"""The public function: checks, the two methods, and the labelled result."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from fringedic.correlation import dense, kernels, pyramid, zoi
from fringedic.correlation.images import checked_image, checked_mask, checked_window, grey_range, saturation
from fringedic.errors import CorrelationMethodError, ShapeMismatchError

f4 = np.float32

CUT = 0.5  # standard deviations of the grey levels next to a saturated one: its neighbours are interpolated wrongly


class Reference:
    """A reference image prepared once for many deformed images.

    Parameters
    ----------
    image
        Grey levels (row, column), integers or real numbers; NaN where not measured.
    window, spacing, mask
        As in `measure_displacement`.

    Raises
    ------
    ColourImageError, ImageTypeError, ImageSizeError, TexturelessImageError, WindowError, ShapeMismatchError,
    EmptyMaskError
    """

    def __init__(self, image: ArrayLike, *, window: int = 32, spacing: int = 1, mask: ArrayLike | None = None) -> None:
        array = checked_image(image, "reference")
        self.shape: tuple[int, int] = (array.shape[0], array.shape[1])
        self.window, self.spacing = checked_window(window, spacing, self.shape)
        excluded = checked_mask(mask, self.shape)
        self.mean, self.deviation = grey_range(array, "reference")
        values = self.normalised(array)
        if excluded is not None:
            values[~excluded] = np.nan
        self.values = values
        self.images = pyramid.pyramid_of(values)
        self.levels = [pyramid.reference_level(level) for level in self.images]
        self.textured = dense.textured_cells(self.levels[0], dense.window_of(self.window).cell)
        self.rows = np.arange(0, self.shape[0], self.spacing)
        self.columns = np.arange(0, self.shape[1], self.spacing)

    def normalised(self, image: np.ndarray) -> np.ndarray:
        """Grey levels as float32 in standard deviations of the reference from its mean; infinities become NaN."""
        out = np.empty(image.shape, f4)
        kernels.normalised(image, self.mean, 1 / self.deviation, out)
        if image.dtype == np.float32:
            out[~np.isfinite(out)] = np.nan
        return out


def measure_displacement(
    reference: ArrayLike | Reference,
    deformed: ArrayLike,
    *,
    window: int = 32,
    spacing: int = 1,
    mask: ArrayLike | None = None,
    initial: Sequence[ArrayLike] | xr.Dataset | None = None,
    method: str = "dense",
) -> xr.Dataset:
    """Measure the in-plane displacement of every point of a surface between two images.

    The material point at reference pixel p is at p + d(p) in the deformed image: deformed(p + d(p)) = reference(p).

    Parameters
    ----------
    reference, deformed
        Grey images (row, column) of the same shape, 8 to 16 bits or real numbers; NaN where not measured. A `Reference`
        keeps the preparation, the window, the spacing and the mask for many deformed images.
    window
        Width [px] of the bi-triangular window with the same noise.
    spacing
        Distance [px] of the points; 1 measures at every pixel.
    mask
        Booleans (row, column), True where the surface is to be measured in the reference; all of it by default.
    initial
        Displacement expected at the same points, (d_x, d_y) or the result of an earlier call, known to a few pixels;
        NaN where unknown. Without it the search is global.
    method
        "dense" (one least-squares phase fit per pixel) or "zoi" (the paper's zones, one by one).

    Returns
    -------
    xarray.Dataset
        `displacement_x` (along columns), `displacement_y` (along rows, downwards) [px], their standard uncertainties
        `sigma_x`, `sigma_y` [px] and `valid`, over (row, column), whose coordinates are pixel positions in the
        reference. NaN where not valid.

    Raises
    ------
    ColourImageError, ImageTypeError, ImageSizeError
        An image is not a grey image of at least 8 x 8 pixels.
    ShapeMismatchError
        The images, the mask or the initial displacement differ in shape.
    TexturelessImageError
        An image is constant or not measured anywhere.
    WindowError, EmptyMaskError, CorrelationMethodError
        A setting does not fit the image, or is unknown.
    NoCorrelationError
        The images do not show the same surface.

    References
    ----------
    J. Molimard, G. Boyer, H. Zahouani, "Frequency-based image analysis of random patterns: an alternative way to
    classical stereocorrelation", section 2.

    Examples
    --------
    >>> import numpy as np
    >>> texture = np.random.default_rng(1).normal(size=(64, 64)).astype(np.float32)
    >>> field = measure_displacement(texture, np.roll(texture, 2, axis=1), window=16)
    >>> round(float(field.displacement_x.median()), 2)
    2.0
    """
    if method not in ("dense", "zoi"):
        raise CorrelationMethodError(f"method = {method!r} is unknown: it must be 'dense' or 'zoi'")
    if not isinstance(reference, Reference):
        reference = Reference(reference, window=window, spacing=spacing, mask=mask)
    array = checked_image(deformed, "deformed")
    if array.shape != reference.shape:
        raise ShapeMismatchError(
            f"the deformed image has the shape {array.shape}, the reference {reference.shape}: they must be equal"
        )
    mean, deviation = grey_range(array, "deformed")
    values = reference.normalised(array)
    brightness = (reference.deviation / deviation, (reference.mean - mean) / deviation)
    lowest, highest = ((end - reference.mean) / reference.deviation for end in saturation(array))
    ends = (lowest + CUT, highest - CUT)
    start = None if initial is None else _initial(initial, reference)
    if method == "zoi":
        displacement, sigma = zoi.displacement_zones(
            reference.values, values, reference.window, reference.rows, reference.columns, start
        )
        valid = np.isfinite(displacement[0])
    else:
        displacement, sigma, valid = _dense(reference, values, start, brightness, ends)
    coordinates = {"row": reference.rows, "column": reference.columns}
    dimensions = ("row", "column")
    pixels = {"units": "px"}
    return xr.Dataset(
        {
            "displacement_x": (dimensions, displacement[0], {**pixels, "long_name": "displacement along columns"}),
            "displacement_y": (dimensions, displacement[1], {**pixels, "long_name": "displacement along rows"}),
            "sigma_x": (dimensions, sigma[0], {**pixels, "long_name": "standard uncertainty of displacement_x"}),
            "sigma_y": (dimensions, sigma[1], {**pixels, "long_name": "standard uncertainty of displacement_y"}),
            "valid": (dimensions, valid, {"long_name": "measured"}),
        },
        coordinates,
        {"method": method, "window_px": reference.window, "spacing_px": reference.spacing},
    )


def _initial(initial: Sequence[ArrayLike] | xr.Dataset, reference: Reference) -> np.ndarray:
    """Initial displacement (2, row, column) on the points of the result."""
    if isinstance(initial, xr.Dataset):
        initial = (initial["displacement_x"].to_numpy(), initial["displacement_y"].to_numpy())
    shape = (reference.rows.size, reference.columns.size)
    if len(initial) != 2 or any(np.shape(part) != shape for part in initial):
        raise ShapeMismatchError(
            f"the initial displacement must be two arrays (d_x, d_y) of the shape {shape} of the result"
        )
    start = np.array([np.asarray(part, dtype=f4) for part in initial])
    start[:, ~np.isfinite(start).all(axis=0)] = np.nan
    return start


def _dense(
    reference: Reference,
    values: np.ndarray,
    start: np.ndarray | None,
    brightness: tuple[float, float],
    ends: tuple[float, float],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Displacement, its uncertainty (2, row, column) and validity at the points of the result."""
    window = dense.window_of(reference.window)
    initial = None
    if start is not None and np.isfinite(start).any():
        initial = pyramid.initial_nodes(start, reference.shape, window.cell, reference.spacing)
    field = dense.displacement_nodes(
        reference.levels, reference.images, pyramid.pyramid_of(values), reference.window, initial, brightness, ends
    )
    nodes = dense.judged(field, window, reference.textured)
    centre = 0.5 * (window.cell - 1)
    rows, columns = (reference.rows - centre) / window.cell, (reference.columns - centre) / window.cell
    node_rows = np.clip(np.rint(rows).astype(np.intp), 0, nodes.valid.shape[0] - 1)
    node_columns = np.clip(np.rint(columns).astype(np.intp), 0, nodes.valid.shape[1] - 1)
    lines = np.empty((4, nodes.valid.shape[0] + 4, reference.shape[1]), f4)
    kernels.spread_out(np.concatenate([nodes.displacement, nodes.sigma]), window.cell, lines)
    lines = np.ascontiguousarray(lines[:, :, :: reference.spacing])
    fields = np.empty((4, rows.size, columns.size), f4)
    valid = np.empty((rows.size, columns.size), np.bool_)
    measured = np.ascontiguousarray(reference.values[:: reference.spacing, :: reference.spacing])
    kernels.points(lines, rows, nodes.valid, node_rows, node_columns, measured, fields, valid)
    return fields[:2], fields[2:], valid
