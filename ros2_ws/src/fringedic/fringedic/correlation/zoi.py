"""ZOI method: amplitude-weighted phase differences of two windowed zones (Molimard et al., section 2.2).

Unlike in the text, the window of the second zone moves with the current estimate, w(x - d): a fixed window biases the
result towards whole pixels by about 4.5 %. Nothing is interpolated. The method validates the dense one.

References
----------
J. Molimard, G. Boyer, H. Zahouani, "Frequency-based image analysis of random patterns: an alternative way to classical
stereocorrelation".
J. Shi, C. Tomasi (1994), Good features to track, IEEE Conference on Computer Vision and Pattern Recognition, 593-600.
"""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.lib.stride_tricks import sliding_window_view

from fringedic.correlation.agreement import SMALLEST_EXPLAINED, adjust_determination, check_agreement
from fringedic.correlation.dense import TEXTURE
from fringedic.correlation.start import find_correlation_peak

PASSES = 5  # the window moves so many times; test_zones_reach_table_1
OUTLIER = 3  # weighted standard deviations from which on a phase is erroneous (section 2.2)
# Gradient energy that rounding to grey levels leaves across a texture of one direction, of the whole: up to 2e-4 in
# test_texture_of_one_direction, where noise makes up to 1.7 times the expected energy.
ROUNDING = 3e-4
BATCH = 256  # the spectra of so many zones stay in the cache


def measure_zones(
    reference: np.ndarray,
    deformed: np.ndarray,
    window: int,
    rows: np.ndarray,
    columns: np.ndarray,
    initial: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Measure displacement and standard uncertainty (2, row, column) [px] of the zones centred on a grid of pixels.

    Parameters
    ----------
    reference, deformed
        Grey levels (row, column); a zone that contains a NaN or leaves either image is not measured.
    window
        Width of the zones [px].
    rows, columns
        Centres of the zones [px].
    initial
        Displacement (2, row, column) [px] to start from; where NaN or not given, the translation of the whole image.

    Raises
    ------
    CorrelationError
        Hardly any of the zones that could be measured correlates.
    """
    centres = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)
    start = np.empty((len(centres), 2))
    start[:] = find_correlation_peak(reference, deformed)[:2]
    if initial is not None:
        given = initial.reshape(2, -1).T
        start = np.where(np.isfinite(given), given, start)
    # A border of NaN lets zones at the edges be cut out and then refused as incomplete.
    border = window
    zones_f = sliding_window_view(np.pad(reference, border, constant_values=np.nan), (window, window))
    zones_g = sliding_window_view(np.pad(deformed, border, constant_values=np.nan), (window, window))
    displacement = np.full((2, len(centres)), np.nan, dtype=np.float32)
    sigma = np.full((2, len(centres)), np.nan, dtype=np.float32)
    measurable = 0
    first = border - window // 2
    for begin in range(0, len(centres), BATCH):
        part = slice(begin, begin + BATCH)
        corner = centres[part] + first
        complete = ~np.isnan(zones_f[corner[:, 0], corner[:, 1]]).any(axis=(1, 2))
        which = np.flatnonzero(complete) + begin
        if which.size == 0:
            continue
        corner = corner[complete]
        d, s, seen = _fit(zones_f[corner[:, 0], corner[:, 1]], zones_g, corner, start[which])
        displacement[:, which], sigma[:, which] = d.T, s.T
        measurable += seen
    check_agreement(int(np.isfinite(displacement[0]).sum()), measurable)
    shape = (2, rows.size, columns.size)
    return displacement.reshape(shape), sigma.reshape(shape)


def _sample_triangle(window: int, shift: np.ndarray) -> np.ndarray:
    """Sample triangular windows (zone, window) that are moved by `shift` from the centre pixels of the zones."""
    half = (window - 1) / 2
    position = np.arange(window) - window // 2
    return np.asarray(np.clip(1 - np.abs(position - shift[:, None]) / half, 0, None))


def _transform(zones: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the spectra of the zones under their window, without the mean weighted by w^2, and the windows."""
    window = zones.shape[-1]
    w = _sample_triangle(window, shift[:, 1])[:, :, None] * _sample_triangle(window, shift[:, 0])[:, None, :]
    w2 = w * w
    mean = np.sum(w2 * zones, axis=(1, 2)) / np.sum(w2, axis=(1, 2))
    return scipy.fft.rfft2(w * (zones - mean[:, None, None])), w


def _fit(
    zones_f: np.ndarray, zones_g: np.ndarray, corner: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray, int]:
    """Return displacement and uncertainty (zone, 2) as (x, y) of complete zones, and the number of measurable ones."""
    count, window = zones_f.shape[0], zones_f.shape[-1]
    kx = 2 * np.pi * np.fft.rfftfreq(window)[None, :]
    ky = 2 * np.pi * np.fft.fftfreq(window)[:, None]
    used = ((kx > 0) | (ky > 0)) & (kx < np.pi) & (np.abs(ky) < np.pi)
    kx, ky = np.broadcast_arrays(kx, ky)
    kx, ky = kx[used], ky[used]
    middle = np.zeros((count, 2))
    spectrum_f, w = _transform(zones_f.astype(np.float64), middle)
    limits = np.array(zones_g.shape[:2]) - 1

    def cut(whole: np.ndarray) -> np.ndarray:
        at = np.clip(corner + whole[:, ::-1].astype(np.intp), 0, limits)
        return np.asarray(zones_g[at[:, 0], at[:, 1]], np.float64)

    whole = np.rint(start)
    for _ in range(2):  # the second search sees the zone that the first has centred
        spectrum_g, _ = _transform(np.nan_to_num(cut(whole)), middle)
        surface = scipy.fft.irfft2(np.conj(spectrum_f) * spectrum_g, (window, window))
        peak = np.array(np.unravel_index(surface.reshape(count, -1).argmax(axis=1), (window, window))).T
        whole = whole + ((peak + window // 2) % window - window // 2)[:, ::-1]

    f = spectrum_f[:, used]
    d = whole.copy()
    for _ in range(PASSES):
        whole = np.rint(d)
        rest = d - whole
        zones = cut(whole)
        lost = np.isnan(zones).any(axis=(1, 2))
        zones[lost] = 0
        g = _transform(zones, rest)[0][:, used] * np.exp(1j * (rest[:, :1] * kx + rest[:, 1:] * ky))
        cross = np.conj(f) * g
        weight, phase = np.abs(cross), -np.angle(cross)
        # Erroneous phases are those far outside the weighted residual around the current estimate.
        total = np.maximum(weight.sum(axis=1), 1e-30)
        spread = np.sqrt((weight * phase**2).sum(axis=1) / total)
        weight[np.abs(phase) > OUTLIER * spread[:, None]] = 0
        xx, xy, yy = (weight * kx * kx).sum(1), (weight * kx * ky).sum(1), (weight * ky * ky).sum(1)
        bx, by = (weight * kx * phase).sum(1), (weight * ky * phase).sum(1)
        determinant = np.maximum(xx * yy - xy * xy, 1e-30)
        change = np.stack([yy * bx - xy * by, xx * by - xy * bx], axis=1) / determinant[:, None]
        d = d + np.clip(change, -1, 1)

    sigma, share, noise = _estimate_uncertainty(f, g, kx, ky, w)
    measurable = ~lost & _has_texture(zones_f, w, noise)
    good = measurable & (share > SMALLEST_EXPLAINED) & np.isfinite(sigma).all(axis=1)
    d[~good] = np.nan
    sigma[~good] = np.nan
    return d, sigma, int(np.count_nonzero(measurable))


def _has_texture(zones: np.ndarray, w: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return which zones have a texture beyond that of noise in both directions (zone), bool.

    A texture of one direction fixes one component of the displacement only (aperture problem): the smaller eigenvalue
    of its structure tensor is that of noise (Shi, Tomasi 1994). The spectra cannot tell, because the window itself
    makes gradients.

    Parameters
    ----------
    zones, w
        Zones and their windows (zone, row, column).
    noise
        Variance of the difference of two zones (zone).
    """
    w2 = w * w
    along_y, along_x = np.gradient(zones.astype(np.float64), axis=(1, 2))
    pairs = (along_x, along_x), (along_x, along_y), (along_y, along_y)
    xx, xy, yy = ((w2 * first * second).sum(axis=(1, 2)) for first, second in pairs)
    smaller = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    # one image has half of the noise, and a central difference half of the variance of one image
    of_noise = np.maximum(noise / 4 * w2.sum(axis=(1, 2)), ROUNDING * (xx + yy))
    return np.asarray(smaller > 2 * TEXTURE * of_noise)


def _estimate_uncertainty(
    f: np.ndarray, g: np.ndarray, kx: np.ndarray, ky: np.ndarray, w: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Estimate standard uncertainty (zone, 2), adjusted r^2 and variance of f - g (zone) from half-plane spectra.

    With white noise of variance s^2 in f - g the estimator's covariance is s^2 (sum w^4 / sum w^2) H^-1. By Parseval
    H = sum w^2 grad f grad f^T = (2 / N^2) sum k k^T abs(F)^2 and s^2 = (2 / N^2) sum abs(F - a G)^2 / sum w^2, over
    the half plane.
    """
    pixels = w.shape[-1] ** 2
    power_f, power_g = np.sum(np.abs(f) ** 2, axis=1), np.sum(np.abs(g) ** 2, axis=1)
    common = np.sum(np.conj(f) * g, axis=1).real
    gain = common / np.maximum(power_g, 1e-30)
    w2 = w * w
    noise = 2 / pixels * np.sum(np.abs(f - gain[:, None] * g) ** 2, axis=1) / w2.sum(axis=(1, 2))
    energy = 2 / pixels * np.abs(f) ** 2
    xx, xy, yy = (energy * kx * kx).sum(1), (energy * kx * ky).sum(1), (energy * ky * ky).sum(1)
    scale = noise * (w2 * w2).sum(axis=(1, 2)) / w2.sum(axis=(1, 2))
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = np.sqrt(np.stack([yy, xx], axis=1) * (scale / (xx * yy - xy * xy))[:, None])
        correlation = common / np.sqrt(power_f * power_g)
        speckle = 2 * np.pi * np.sum(energy, axis=1) / (xx + yy)
    speckles = w2.sum(axis=(1, 2)) ** 2 / (w2 * w2).sum(axis=(1, 2)) / speckle
    return sigma, adjust_determination(correlation, speckles), noise
