"""How strongly the residuals of neighbouring blocks are alike, and what this leaves of their number."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

_FEWEST = 5  # a mean over larger parts leaves fewer of them along the shorter side of the image
_SEEN = 2.0  # standard deviations by which a variance exceeds 1 before it counts


def residual_correlation(residuals: Sequence[np.ndarray]) -> float:
    """Return the factor by which the variance of a smooth parameter exceeds that of independent residuals.

    The pattern of the projector's pixels, harmonics of its response and the lens make errors that neighbouring blocks
    share. A parameter of the rig is a mean over many blocks, so that it is their common part that counts: the variance
    of means over larger and larger squares, over whole columns and whole rows, in units of what independent errors
    would give. The largest of them is returned, at least 1.

    Parameters
    ----------
    residuals
        Residual of the blocks of each plane in units of their standard deviation, (row, column), NaN without data.

    Examples
    --------
    >>> random = np.random.default_rng(1)
    >>> independent = [random.normal(size=(30, 40)) for _ in range(5)]
    >>> round(residual_correlation(independent), 1)
    1.0
    >>> common = [each + random.normal(size=40) for each in independent]  # as fringes that are displaced together
    >>> bool(20 < residual_correlation(common) < 45)
    True
    """
    parts = [np.concatenate(each) for each in zip(*(list(_means(each)) for each in residuals), strict=True)]
    found = [float(np.mean(each**2)) - _SEEN * np.sqrt(2 / len(each)) for each in parts if len(each)]
    return float(max([1.0, *found]))


def _means(residual: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the means over parts of an image, each in units of its own standard deviation."""
    known = np.isfinite(residual)
    values = np.where(known, residual, 0.0)
    rows, columns = residual.shape
    sizes = [(size, size) for size in range(1, max(1, min(rows, columns) // _FEWEST) + 1)]
    for height, width in (*sizes, (rows, 1), (1, columns)):
        down, across = rows // height, columns // width
        inside = np.s_[: down * height, : across * width]
        shape = (down, height, across, width)
        count = known[inside].reshape(shape).sum(axis=(1, 3))
        sums = values[inside].reshape(shape).sum(axis=(1, 3))
        full = count > 0.5 * height * width
        yield sums[full] / np.sqrt(count[full])
