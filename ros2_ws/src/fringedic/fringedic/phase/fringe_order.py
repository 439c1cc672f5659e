"""Fringe orders from phases: coarse to fine (absolute), from another phase, or from pixel to pixel (relative)."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import xarray as xr
from skimage.restoration import unwrap_phase

from fringedic.errors import ImageError
from fringedic.phase.layout import check_finer, pixels
from fringedic.wording.arguments import array, check_arguments, number, several


@check_arguments(ImageError, wrapped=several(array(2)), pitches=several(number(1e-9)))
def unwrap_hierarchical(wrapped: Sequence[np.ndarray | xr.DataArray], pitches: Sequence[float]) -> xr.DataArray:
    """Unwrap phases coarse to fine: each gives the fringe order of the next finer one (temporal unwrapping).

    Parameters
    ----------
    wrapped
        Wrapped phases [rad], one image of shape (row, column) for each pitch, all zero on the projector axis. One
        fringe of the first has to cover the field: that phase is used unchanged.
    pitches
        Fringe pitches, coarse to fine, in any one unit.

    Returns
    -------
    DataArray
        Absolute phase at the finest pitch [rad]; NaN where any phase is NaN.

    Raises
    ------
    PhaseError
        The pitches do not become finer.
    ImageError
        There is not one image for each pitch, or the images differ in size.

    References
    ----------
    J. M. Huntley, H. Saldner, "Temporal phase-unwrapping algorithm for automated interferogram analysis", Applied
    Optics 32 (1993) 3047-3052.

    Examples
    --------
    >>> truth = np.linspace(-12.0, 12.0, 5).reshape(1, 5)  # at a pitch of 10 px
    >>> wrapped = [truth * 10 / 50, np.angle(np.exp(1j * truth))]
    >>> unwrap_hierarchical(wrapped, [50, 10]).values.round(6).tolist()
    [[-12.0, -6.0, 0.0, 6.0, 12.0]]
    """
    if len(wrapped) != len(pitches) or not wrapped:
        raise ImageError(f"{len(wrapped)} phase images for {len(pitches)} pitches: give one for each")
    check_finer(pitches)
    images = [np.asarray(image, float) for image in wrapped]
    if len({image.shape for image in images}) > 1:
        raise ImageError(f"phase images differ in size: {[image.shape for image in images]}")
    phase = images[0]
    for image, coarse, fine in zip(images[1:], pitches, pitches[1:], strict=False):
        phase = image + 2 * np.pi * np.round((phase * coarse / fine - image) / (2 * np.pi))
    return _label(phase, relative=False)


@check_arguments(ImageError, wrapped=array(2))
def unwrap_spatial(wrapped: np.ndarray | xr.DataArray) -> xr.DataArray:
    """Unwrap one phase over the image, from pixel to pixel; the result is true up to the same number of whole fringes.

    Where neighbours differ by more than half a fringe (steps, shadows), the orders behind are wrong without notice. A
    region that is not connected to the largest one has no order relative to it and is left out.

    Parameters
    ----------
    wrapped
        Wrapped phase [rad], shape (row, column), NaN where not measured.

    Returns
    -------
    DataArray
        Phase [rad] of the largest connected region, NaN elsewhere, with the attribute ``relative`` = 1. Its offset is
        chosen so that the median phase lies in the wrapped range.

    References
    ----------
    M. A. Herraez, D. R. Burton, M. J. Lalor, M. A. Gdeisat, "Fast two-dimensional phase-unwrapping algorithm based on
    sorting by reliability following a noncontinuous path", Applied Optics 41 (2002) 7437-7444; the implementation is
    that of scikit-image.

    D. C. Ghiglia, M. D. Pritt, "Two-Dimensional Phase Unwrapping: Theory, Algorithms, and Software", Wiley (1998).

    Examples
    --------
    >>> truth = np.linspace(-10.0, 10.0, 21) * np.ones((4, 1))
    >>> phase = unwrap_spatial(np.angle(np.exp(1j * truth)))
    >>> bool(abs(phase - truth).max() < 1e-9), phase.attrs["relative"]
    (True, 1)
    """
    image = np.asarray(wrapped, float)
    measured = np.isfinite(image)
    phase = np.full(image.shape, np.nan)
    if measured.any():
        _, labels, statistics, _ = cv2.connectedComponentsWithStats(measured.astype(np.uint8), connectivity=4)
        region = labels == 1 + int(np.argmax(statistics[1:, cv2.CC_STAT_AREA]))
        rows, columns = (np.flatnonzero(region.any(axis=axis)) for axis in (1, 0))
        window = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        inside = region[window]
        part = np.where(inside, image[window], np.nan)
        jumps = any((np.abs(np.diff(part, axis=axis)) > np.pi).any() for axis in (0, 1))
        orders = _orders_over_image(part) if jumps else np.zeros(part.shape)
        orders -= np.round(np.median((orders + part / (2 * np.pi))[inside]))
        phase[window] = part + 2 * np.pi * orders
    return _label(phase, relative=True)


def assign_orders(phase: np.ndarray | xr.DataArray, coarse: np.ndarray | xr.DataArray) -> xr.DataArray:
    """Make a relative or wrapped phase absolute with another one that is known to within half a fringe.

    Parameters
    ----------
    phase
        Phase [rad], shape (row, column), true up to whole turns at every pixel.
    coarse
        Absolute phase at the same pitch [rad], same shape, such as that of the step before.

    Returns
    -------
    DataArray
        Absolute phase [rad]; NaN where any of the two is NaN.

    Raises
    ------
    ImageError
        The images differ in size.

    Examples
    --------
    >>> assign_orders(np.array([[0.5, -0.5]]), np.array([[6.0, 7.0]])).values.round(3).tolist()
    [[6.783, 5.783]]
    """
    image, known = np.asarray(phase, float), np.asarray(coarse, float)
    if image.shape != known.shape:
        raise ImageError(f"a phase of shape {image.shape} cannot take its orders from one of {known.shape}")
    return _label(image + 2 * np.pi * np.round((known - image) / (2 * np.pi)), relative=False)


def _orders_over_image(wrapped: np.ndarray) -> np.ndarray:
    """Return the whole turns to add to each pixel; the phase itself stays bit-identical."""
    known = np.isfinite(wrapped)
    # a masked border: scikit-image warns of images that are one pixel wide
    border = [(0, int(size == 1)) for size in wrapped.shape]
    masked = np.ma.array(
        np.pad(np.where(known, wrapped, 0.0), border), mask=np.pad(~known, border, constant_values=True)
    )
    unwrapped = np.ma.getdata(unwrap_phase(masked))[: wrapped.shape[0], : wrapped.shape[1]]  # type: ignore[no-untyped-call]
    return np.asarray(np.where(known, np.round((unwrapped - wrapped) / (2 * np.pi)), 0.0))


def _label(phase: np.ndarray, *, relative: bool) -> xr.DataArray:
    return xr.DataArray(
        phase,
        dims=("row", "column"),
        coords=pixels(phase.shape),
        name="phase",
        attrs={"units": "rad", "relative": int(relative)},
    )
