"""Displacement between two images: input checks, the two methods, and the labelled result."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from fringedic.correlation import image_kernels, zoi
from fringedic.correlation.images import (
    measure_grey_range,
    measure_photometry,
    require_image,
    require_mask,
    require_window,
)
from fringedic.correlation.points import measure_points
from fringedic.correlation.prepared import Prepared
from fringedic.errors import CorrelationError, ImageError
from fringedic.wording.arguments import array, check_arguments, either, optional, several, whole

f4 = np.float32


class Reference:
    """A reference image that is prepared once for many deformed images.

    Parameters
    ----------
    image
        Grey levels (row, column), integers or real numbers; NaN where not measured.
    window, spacing, mask
        As in `measure_displacement`.

    Attributes
    ----------
    shape
        Rows and columns of the image.
    window, spacing
        [px]
    rows, columns : (row,), (column,) int
        Pixel positions of the points of the result.

    Raises
    ------
    ImageError
        The image is not a grey image of at least 8 x 8 pixels, or the mask does not fit it.
    CorrelationError
        The image is constant or not measured anywhere, or window or spacing do not fit it.

    Examples
    --------
    >>> import numpy as np
    >>> texture = np.random.default_rng(1).normal(size=(64, 64)).astype(np.float32)
    >>> reference = Reference(texture, window=16, spacing=4)
    >>> fields = [measure_displacement(reference, np.roll(texture, moved, axis=1)) for moved in (1, 2)]
    >>> [round(float(field.displacement_x.median()), 2) for field in fields]
    [1.0, 2.0]
    """

    @check_arguments(CorrelationError, window=whole(), spacing=whole())
    def __init__(self, image: ArrayLike, *, window: int = 32, spacing: int = 1, mask: ArrayLike | None = None) -> None:
        array = require_image(image, "reference")
        self.shape: tuple[int, int] = (array.shape[0], array.shape[1])
        self.window, self.spacing = require_window(window, spacing, self.shape)
        measured = require_mask(mask, self.shape)
        self.mean, self.deviation = measure_grey_range(array, "reference")
        values = self.normalise(array)
        if measured is not None:
            values[~measured] = np.nan
        self.prepared = Prepared.of(values, self.window, self.deviation)
        self.rows = np.arange(0, self.shape[0], self.spacing)
        self.columns = np.arange(0, self.shape[1], self.spacing)

    def normalise(self, image: np.ndarray) -> np.ndarray:
        """Return grey levels in standard deviations of the reference from its mean, float32; infinities become NaN."""
        out = np.empty(image.shape, f4)
        image_kernels.normalise(image, self.mean, 1 / self.deviation, out)
        if image.dtype == np.float32:
            out[~np.isfinite(out)] = np.nan
        return out


@check_arguments(
    CorrelationError,
    window=whole(),
    spacing=whole(),
    initial=optional(either(xr.Dataset, several(array(2), length=2))),
)
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
        Width [px] of the bi-triangular window with the same noise. `fringedic.correlation.transfer` contains the
        attenuation of short waves for it.
    spacing
        Distance [px] of the points (step size); 1 measures at every pixel.
    mask
        Booleans (row, column), True where the surface is to be measured in the reference; all of it by default.
    initial
        Expected displacement at the same points [px], (d_x, d_y) or the result of an earlier call, wrong by a few
        pixels at most; NaN where unknown. Without it the search is global.
    method
        "dense" (one least-squares phase fit per point) or "zoi" (the zones of Molimard et al., one by one).

    Returns
    -------
    xarray.Dataset
        `displacement_x` (to the right), `displacement_y` (down) [px], their standard uncertainties `sigma_x`, `sigma_y`
        [px], float32, and `valid`, bool, over (row, column), whose coordinates are pixel positions in the reference.
        NaN where not valid. Attributes `method`, `window_px`, `spacing_px`; of the dense method also, where they apply:

        - `motions`, `unmatched_fraction`: number of motions of the image, if texture wider than a window was left by
          the first one, and the share of the texture (0 to 1) that none of them explains.
        - `repeats_px`: (x, y) of each vector after which a periodic texture repeats, in one list, if its irregularities
          do not decide: the displacement is then known up to sums of multiples of these vectors.
        - `binning_px`: side of the blocks of pixels that were averaged, because the texture is coarse and faint;
          `window_px` is then as many times wider than `window`.

    Raises
    ------
    ImageError
        An image is not a grey image of at least 8 x 8 pixels, or images, mask and initial displacement differ in shape.
    CorrelationError
        An image is constant or not measured anywhere, a setting does not fit the image or is unknown, or the images do
        not show the same surface (code NO_CORRELATION).

    References
    ----------
    J. Molimard, G. Boyer, H. Zahouani, "Frequency-based image analysis of random patterns: an alternative way to
    classical stereocorrelation", section 2.
    B. D. Lucas, T. Kanade (1981), An iterative image registration technique with an application to stereo vision,
    IJCAI, 674-679.

    Examples
    --------
    >>> import numpy as np
    >>> texture = np.random.default_rng(1).normal(size=(64, 64)).astype(np.float32)
    >>> field = measure_displacement(texture, np.roll(texture, 2, axis=1), window=16)
    >>> round(float(field.displacement_x.median()), 2)
    2.0
    """
    if method not in ("dense", "zoi"):
        raise CorrelationError(f"method = {method!r} is unknown: it must be 'dense' or 'zoi'")
    if not isinstance(reference, Reference):
        reference = Reference(reference, window=window, spacing=spacing, mask=mask)
    array = require_image(deformed, "deformed")
    if array.shape != reference.shape:
        raise ImageError(
            f"the deformed image has the shape {array.shape}, the reference {reference.shape}: they must be equal"
        )
    photometry = measure_photometry(array, reference.mean, reference.deviation)
    values = reference.normalise(array)
    start = None if initial is None else _take_initial(initial, reference)
    attributes: dict[str, Any] = {"method": method, "window_px": reference.window, "spacing_px": reference.spacing}
    if method == "zoi":
        displacement, sigma = zoi.measure_zones(
            reference.prepared.values, values, reference.window, reference.rows, reference.columns, start
        )
        valid = np.isfinite(displacement[0])
    else:
        found = measure_points(reference.prepared, values, photometry, start, reference.spacing)
        displacement, sigma, valid = found.displacement, found.sigma, found.valid
        attributes |= found.attributes
    dimensions = ("row", "column")
    pixels = {"units": "px"}
    return xr.Dataset(
        {
            "displacement_x": (dimensions, displacement[0], {**pixels, "long_name": "in-plane displacement x (right)"}),
            "displacement_y": (dimensions, displacement[1], {**pixels, "long_name": "in-plane displacement y (down)"}),
            "sigma_x": (dimensions, sigma[0], {**pixels, "long_name": "standard uncertainty of displacement_x"}),
            "sigma_y": (dimensions, sigma[1], {**pixels, "long_name": "standard uncertainty of displacement_y"}),
            "valid": (dimensions, valid, {"long_name": "measured"}),
        },
        {"row": reference.rows, "column": reference.columns},
        attributes,
    )


def _take_initial(initial: Sequence[ArrayLike] | xr.Dataset, reference: Reference) -> np.ndarray:
    """Return the initial displacement (2, row, column) on the points of the result."""
    if isinstance(initial, xr.Dataset):
        initial = (initial["displacement_x"].to_numpy(), initial["displacement_y"].to_numpy())
    shape = (reference.rows.size, reference.columns.size)
    if len(initial) != 2 or any(np.shape(part) != shape for part in initial):
        raise ImageError(f"the initial displacement must be two arrays (d_x, d_y) of the shape {shape} of the result")
    start = np.array([np.asarray(part, dtype=f4) for part in initial])
    start[:, ~np.isfinite(start).all(axis=0)] = np.nan
    return start
