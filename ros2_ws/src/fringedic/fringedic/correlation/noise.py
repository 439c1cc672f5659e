"""How the errors of neighbouring points agree: the correlation that the window gives to the noise of a displacement."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from fringedic.correlation import dense
from fringedic.errors import CorrelationMethodError


@lru_cache(maxsize=8)
def error_correlation(window: int, method: str = "dense", reach: int = 0) -> np.ndarray:
    """Return the correlation coefficient of the noise of a displacement component at two points.

    The noise of the dense method is white noise through the transfer T of its fixed point; that of a zone is white
    noise weighted by the square of its window.

    Parameters
    ----------
    window, method
        As in `measure_displacement`.
    reach
        Largest lag [px]; by default twice the window.

    Returns
    -------
    ndarray
        Shape (reach + 1, reach + 1): at lags of 0, 1, 2... rows and columns [px].

    Raises
    ------
    CorrelationMethodError
        The method is unknown.
    """
    reach = reach or 2 * window
    if method == "zoi":
        half = (window - 1) / 2
        weight = np.maximum(0, 1 - np.abs(np.arange(window) - half) / half) ** 2
        along = np.correlate(weight, weight, "full")[window - 1 :] / (weight @ weight)
        along = np.pad(along, (0, max(0, reach + 1 - window)))[: reach + 1]
        return np.outer(along, along)
    if method != "dense":
        raise CorrelationMethodError(f"method = {method!r} is unknown: it must be 'dense' or 'zoi'")
    size = 2 ** int(np.ceil(np.log2(2 * (reach + 2 * window))))
    waves = 2 * np.pi * dense.window_of(window).deviation
    q2 = 0.5 * waves**2 * (np.fft.fftfreq(size)[:, np.newaxis] ** 2 + np.fft.rfftfreq(size) ** 2)
    spectrum = dense._transfer(np.exp(-q2), np.exp(-q2 * dense.NARROWER**2)) ** 2
    correlation = np.fft.irfft2(spectrum, (size, size))
    return correlation[: reach + 1, : reach + 1] / correlation[0, 0]
