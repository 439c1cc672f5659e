"""Transfer function of the displacement measurement: attenuation of waves, cut-off, noise gain, correlation of errors.

Both methods are linear filters of the displacement for small errors. A zone of the ZOI method returns the mean weighted
by the square of its bi-triangular window w. The dense method has the transfer of its fixed point (see `dense`),

    T = h / (h + (1 - h) (1 - v)^ORDER),   h = exp(-q^2),   v = exp(-(NARROWER q)^2),   q = sqrt(2) pi s f

where h is the transfer of the Gaussian window W of standard deviation s [px], v that of the narrower Gaussian of the
predictor, and f the frequency [1/px]. T is flat up to the order 2 (ORDER + 1), then decreases as h, without overshoot.
White noise passes through the same filter: its spectrum is T^2. Displacement waves are attenuated a little more, as by
T at LONGER times their frequency (`transfer_function`, `shortest_period`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from fringedic.errors import CorrelationError

# Chosen in the study of noise times cut-off, docs/validation/correlation.md; kept by test_transfer.py.
ORDER = 6
NARROWER = 0.75  # standard deviation of the predictor's Gaussian over that of W
# Period of a measured wave over that of T with the same gain: the iteration ends early, cells average waves, and the
# weights of an uneven texture mix them. Decision 0101, test_waves_keep_what_the_transfer_function_states.
LONGER = 1.02
KEPT = 0.9  # share of the amplitude that a resolved wave keeps; the usual 10 % loss (Grediac, Blaysat, Sur 2017)


def transfer_function(frequency: ArrayLike, window: int, method: str = "dense") -> np.ndarray:
    """Return the share of its amplitude that a displacement wave along one axis keeps.

    Parameters
    ----------
    frequency
        Of the wave [1/px], any shape.
    window, method
        As in `measure_displacement`; window in px.

    Returns
    -------
    ndarray
        Dimensionless, float64, of the shape of `frequency`.

    Raises
    ------
    CorrelationError
        The method is unknown.

    References
    ----------
    M. Grediac, B. Blaysat, F. Sur (2017), Experimental Mechanics 57, 871-903, for the transfer of subset methods.

    Examples
    --------
    >>> transfer_function([0.0, 1 / 35.3, 1 / 20], window=32).round(2).tolist()
    [1.0, 0.9, 0.02]
    """
    return noise_transfer(np.asarray(frequency, float) * (LONGER if _is_dense(method) else 1), window, method)


def noise_transfer(frequency: ArrayLike, window: int, method: str = "dense") -> np.ndarray:
    """Return the square root of the spectrum of the noise, relative to that at frequency 0.

    Parameters
    ----------
    frequency, window, method
        As in `transfer_function`.

    Returns
    -------
    ndarray
        Dimensionless, float64, of the shape of `frequency`.

    Raises
    ------
    CorrelationError
        The method is unknown.

    Examples
    --------
    >>> noise_transfer([0.0, 1 / 34.6, 1 / 20], window=32).round(2).tolist()
    [1.0, 0.9, 0.02]
    """
    frequency = np.asarray(frequency, float)
    if _is_dense(method):
        return _dense_transfer(0.5 * (2 * np.pi * window_deviation(window)) ** 2 * frequency**2)
    weight = _zone_weight(window)
    distance = np.arange(window) - (window - 1) / 2
    waves = np.cos(2 * np.pi * frequency[..., np.newaxis] * distance)
    return np.asarray(waves @ weight / weight.sum())


def shortest_period(window: int, method: str = "dense", *, kept: float = KEPT) -> float:
    """Return the period of the shortest displacement wave that keeps the share `kept` of its amplitude.

    Parameters
    ----------
    window, method
        As in `measure_displacement`; window in px.
    kept
        Share of the amplitude, between 0 and 1.

    Returns
    -------
    float
        Period [px]; it is proportional to window - 1.

    Raises
    ------
    CorrelationError
        The method is unknown.

    Examples
    --------
    >>> round(shortest_period(32), 1), round(shortest_period(32, "zoi"), 1)
    (35.3, 67.2)
    """
    if _is_dense(method):
        q2 = np.linspace(1e-3, 10, 100_000)
        q = math.sqrt(q2[np.argmax(_dense_transfer(q2) < kept)])
        return math.sqrt(2) * math.pi * LONGER * window_deviation(window) / q
    frequency = np.linspace(0, 1 / window, 10_001)
    return float(1 / frequency[np.argmax(transfer_function(frequency, window, method) < kept)])


def noise_gain(window: int, method: str = "dense") -> float:
    """Return the variance of a displacement over that of independent values at every pixel.

    The windows of both methods are defined to have the same gain: a bi-triangular window used on both images averages
    noise over (sum w^2)^2 / sum w^4, about (window - 1) / 1.8, pixels along each axis.

    Parameters
    ----------
    window, method
        As in `measure_displacement`; window in px.

    Returns
    -------
    float
        Dimensionless; the inverse of the number of pixels that are averaged.

    Raises
    ------
    CorrelationError
        The method is unknown.

    Examples
    --------
    >>> round(1 / noise_gain(32)), round(1 / noise_gain(32, "zoi"))
    (297, 297)
    """
    if _is_dense(method):
        return float(_dense_covariance(window, 0)[0, 0])
    weight = _zone_weight(window)
    return float((weight @ weight / weight.sum() ** 2) ** 2)


@lru_cache(maxsize=8)
def error_correlation(window: int, method: str = "dense", reach: int = 0) -> np.ndarray:
    """Return the correlation coefficient of the noise of a displacement component at two points.

    Parameters
    ----------
    window, method
        As in `measure_displacement`; window in px.
    reach
        Largest lag [px]; by default twice the window.

    Returns
    -------
    ndarray
        Shape (reach + 1, reach + 1), float64: at lags of 0, 1, 2... rows and columns [px].

    Raises
    ------
    CorrelationError
        The method is unknown.

    Examples
    --------
    >>> error_correlation(32)[0, [0, 8, 40]].round(2).tolist()
    [1.0, 0.68, 0.04]
    """
    reach = reach or 2 * window
    if _is_dense(method):
        covariance = _dense_covariance(window, reach)
        return np.asarray(covariance / covariance[0, 0])
    weight = _zone_weight(window)
    along = np.correlate(weight, weight, "full")[window - 1 :] / (weight @ weight)
    along = np.pad(along, (0, max(0, reach + 1 - window)))[: reach + 1]
    return np.outer(along, along)


@lru_cache(maxsize=16)
def window_deviation(window: int) -> float:
    """Return the standard deviation [px] of the Gaussian W with the noise gain of a bi-triangular window.

    The bi-triangular window averages noise over (window - 1) / 1.8 pixels along each axis. For the Gaussian the
    integral of T^2 over the frequencies is (n / (sqrt(2) pi s))^2, where n^2 is pi times the integral of T^2 over q^2.
    """
    q2 = np.linspace(0, 40, 40001)
    n = np.sqrt(np.pi * np.sum(_dense_transfer(q2) ** 2) * (q2[1] - q2[0]))
    return float(n / (np.sqrt(2) * np.pi) * (window - 1) / 1.8)


@dataclass(frozen=True)
class NodeGains:
    """Gains of the dense method on its nodes, from the sampled and truncated filters.

    Attributes
    ----------
    noise
        Mean of T^2 over the frequencies of the nodes: the variance at a node over that of one cell.
    left
        Share of white noise through V that the fit leaves: mean of v^2 (1 - T)^2 over mean of v^2.
    independent
        Number of independent values per node in what the fit leaves.
    """

    noise: float
    left: float
    independent: float


def node_gains(window: np.ndarray, narrow: np.ndarray) -> NodeGains:
    """Return the gains of symmetric filters W and V given by their taps from the centre on."""
    h, v = _response(window), _response(narrow)
    gain = _fixed_point_transfer(np.outer(h, h), np.outer(v, v))
    through = np.outer(v, v) ** 2
    remains = through * (1 - gain) ** 2
    return NodeGains(
        noise=float(np.mean(gain**2)),
        left=float(np.mean(remains) / np.mean(through)),
        independent=float(np.mean(remains) ** 2 / np.mean(remains**2)),
    )


def _is_dense(method: str) -> bool:
    if method not in ("dense", "zoi"):
        raise CorrelationError(f"method = {method!r} is unknown: it must be 'dense' or 'zoi'")
    return method == "dense"


def _fixed_point_transfer(window: np.ndarray, narrow: np.ndarray) -> np.ndarray:
    """T from the transfers of W and of V."""
    return np.asarray(window / (window + (1 - window) * (1 - narrow) ** ORDER))


def _dense_transfer(q2: np.ndarray) -> np.ndarray:
    """T at the squares of q, see the module."""
    return _fixed_point_transfer(np.exp(-q2), np.exp(-q2 * NARROWER**2))


def _dense_covariance(window: int, reach: int) -> np.ndarray:
    """Covariance of the noise at lags (row, column) up to `reach` [px] for white noise of variance 1 per pixel."""
    size = 2 ** int(np.ceil(np.log2(2 * (reach + 2 * window))))
    waves = 2 * np.pi * window_deviation(window)
    q2 = 0.5 * waves**2 * (np.fft.fftfreq(size)[:, np.newaxis] ** 2 + np.fft.rfftfreq(size) ** 2)
    covariance = np.fft.irfft2(_dense_transfer(q2) ** 2, (size, size))
    return np.asarray(covariance[: reach + 1, : reach + 1])


def _zone_weight(window: int) -> np.ndarray:
    """Weights along one axis of the mean that a zone returns: the square of its triangular window."""
    half = (window - 1) / 2
    return np.asarray(np.maximum(0, 1 - np.abs(np.arange(window) - half) / half) ** 2)


def _response(taps: np.ndarray) -> np.ndarray:
    """Transfer of a symmetric filter at 128 frequencies of the nodes."""
    waves = np.cos(2 * np.pi * np.outer(np.fft.fftfreq(128), np.arange(taps.size)))
    waves[:, 1:] *= 2
    return np.asarray(waves @ taps)
