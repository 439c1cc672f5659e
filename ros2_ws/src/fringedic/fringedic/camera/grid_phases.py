"""Windowed Fourier phase of a printed grid: both directions, up to the edges of the image (Surrel 1997)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from scipy.ndimage import binary_dilation
from scipy.sparse import csr_array

from fringedic.camera.polynomials import Basis, least_squares, square, terms
from fringedic.errors import GridError

# test_grid.py contains images on both sides of the thresholds that refuse an image or warn.
_START_ORDERS = (2, 4, 8)  # differences of neighbours give the phase as polynomials of these orders
_MODEL_ORDER = 14  # the image is demodulated by a phase polynomial of this order
_LIGHT_ORDER = 4  # polynomials of this order follow the amplitudes
_PASSES = 2  # the image is demodulated and the phase refined so many times
_WELL_SEEN = 80  # this percentile of the amplitudes represents the grid, even if half of the image is dark
_FAINT = 0.25  # a smaller part of that amplitude is not the grid
_LOWEST_CONTRAST = 0.04  # visible lines have this amplitude relative to the mean grey level
_FEWEST = 60  # points
_BARE, _PARTLY = 0.2, 0.9  # a ninth of the image with a smaller valid part is bare, or partly covered
_PLACES = (
    ("upper left", "top", "upper right"),
    ("left", "centre", "right"),
    ("lower left", "bottom", "lower right"),
)
# Components (m, n) of m phase_1 + n phase_2 in the spectrum of printed crossed lines.
_COMPONENTS = [
    (0, 0),
    (1, 0),
    (0, 1),
    (1, 1),
    (1, -1),
    (2, 0),
    (0, 2),
    (2, 1),
    (2, -1),
    (1, 2),
    (1, -2),
    (3, 0),
    (0, 3),
]
_COMPONENTS += [(3, 1), (3, -1), (1, 3), (1, -3)]


@dataclass(frozen=True, eq=False)
class GridPhases:
    """Phases of both directions of a grid at points about a period apart.

    Attributes
    ----------
    points : (points, 2)
        Column and row [px]; only those where the grid is visible.
    phases : (points, 2)
        Phase [rad] of the direction that grows along the columns and of the one that grows along the rows.
    weights : (points,)
        Effective number of pixels of a point, relative to a whole window; smaller along the edges of the image.
    valid : (rows of points, columns of points) bool
        Where the grid is visible.
    covered
        Names of places of the image that show too little of it.
    """

    points: np.ndarray
    phases: np.ndarray
    weights: np.ndarray
    valid: np.ndarray
    covered: tuple[str, ...]


def grid_phases(image: np.ndarray, usable: np.ndarray, carriers: np.ndarray) -> GridPhases:
    """Return the phases of a grid with the given `carriers` (2, 2) [1/px] in an image.

    Inside the image, where the windows are whole, the phases follow from the windowed Fourier transform relative to a
    polynomial model of the phase. At the edges a window is truncated and mixes the directions, their harmonics and the
    mean. There the image synthesised from the polynomials of phase and amplitude is subtracted first, so that only the
    remainder is mixed.

    Raises
    ------
    GridError
        The lines are too faint, or hardly any of the image shows them.

    References
    ----------
    Y. Surrel, "Additive noise effect in digital phase detection", Applied Optics 36 (1997) 271-276.
    """
    period = float(np.mean(1 / np.hypot(*carriers.T)))
    windows = _Windows(image, usable, period)
    inner = windows.inner
    models = [_linear(carrier, image.shape) for carrier in carriers]
    valid = inner & windows.all_usable
    for model in models:
        valid &= _strong(windows.demodulate(windows.wave(model)), windows, valid)
    # a window that extends beyond the edge of an object on the grid contains this edge
    valid &= ~binary_dilation(inner & ~valid, np.ones((3, 3), bool), iterations=2)
    if valid.sum() < _FEWEST:
        raise GridError("hardly any of the image shows the grid")
    rows, columns = (3 * np.arange(n) // n for n in valid.shape)
    shares = {}
    for i, names in enumerate(_PLACES):
        for j, name in enumerate(names):
            place = np.ix_(rows == i, columns == j)
            shares[name] = float(valid[place].sum() / max(inner[place].sum(), 1))
    bare = [name for name, share in shares.items() if share < _BARE]
    if bare:
        raise GridError(
            f"the image shows no grid at: {', '.join(bare)}; the grid has to fill the image, free of shadow and glare"
        )
    covered = tuple(name for name, share in shares.items() if share < _PARTLY)
    basis = Basis(windows.points, image.shape, _MODEL_ORDER)
    carried = Basis(windows.points[valid.ravel()], image.shape, _MODEL_ORDER).highest
    for k, model in enumerate(models):
        for order in _START_ORDERS:
            slope = _from_differences(windows.demodulate(windows.wave(model)), valid, basis, min(order, carried))
            model = model + slope
        for _ in range(_PASSES):
            rest = _continuous(windows.demodulate(windows.wave(model)), valid)
            model = model + _polynomial(rest, valid.astype(float), basis, carried)
        models[k] = model

    weights = windows.weights
    shown = windows.all_usable & ~binary_dilation(inner & ~valid, np.ones((3, 3), bool), iterations=2)
    for last in (False, True):
        beyond = _beyond(windows, models, carriers, valid)
        for amplitude in beyond:
            strength = np.abs(amplitude)
            shown &= strength > _FAINT * np.percentile(strength[valid], _WELL_SEEN)
        rests = [_continuous(amplitude, shown) for amplitude in beyond]
        if not last:
            changes = [_polynomial(rest, weights * shown, basis, carried) for rest in rests]
            models = [model + change for model, change in zip(models, changes, strict=True)]
    phases = [windows.at_points(model) + rest for model, rest in zip(models, rests, strict=True)]
    return GridPhases(
        windows.points[shown.ravel()],
        np.stack([phase[shown] for phase in phases], axis=1),
        weights[shown],
        shown,
        covered,
    )


class _Windows:
    """Windowed sums over an image at points one period apart; at the edges the windows are truncated.

    The cubic B-spline of four periods has the transfer function sinc^4(f P), with zeros of the fourth order at 1/P and
    2/P: the mean of the image, the other direction and the mirrored frequency after demodulation.
    """

    def __init__(self, image: np.ndarray, usable: np.ndarray, period: float) -> None:
        self.image = image.astype(np.float32)
        self._positions = np.arange(image.shape[0], dtype=float), np.arange(image.shape[1], dtype=float)
        sides = [_splines(n, period) for n in image.shape]
        (self._down, self.rows, whole_rows, gain_rows), (self._right, self.columns, whole_columns, gain_columns) = sides
        self.inner = whole_rows[:, None] & whole_columns
        self.weights = gain_rows[:, None] * gain_columns
        row, column = np.meshgrid(self.rows, self.columns, indexing="ij")
        self.points = np.stack([column.ravel(), row.ravel()], axis=1)
        self.mean = self.sums(self.image)
        self.all_usable = self.sums(usable.astype(np.float32)) > 0.999

    def sums(self, values: np.ndarray) -> np.ndarray:
        """Return weighted means of an image at the points."""
        means: np.ndarray = (self._right @ (self._down @ values).T).T
        return means

    def demodulate(self, wave: np.ndarray) -> np.ndarray:
        """Return means of the image times the conjugate of a wave: half the amplitude of a cosine, relative phase."""
        return self.sums(self.image * wave.conj())

    def wave(self, phase: np.ndarray) -> np.ndarray:
        """Return exp(i phase) at every pixel, for the coefficients of a phase [rad]."""
        return np.exp(1j * self.at_pixels(phase)).astype(np.complex64)

    def at_pixels(self, coefficients: np.ndarray) -> np.ndarray:
        """Return a polynomial at every pixel."""
        return self._on_grid(*self._positions, coefficients)

    def at_points(self, coefficients: np.ndarray) -> np.ndarray:
        """Return a polynomial at the points."""
        return self._on_grid(self.rows, self.columns, coefficients)

    def _on_grid(self, rows: np.ndarray, columns: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
        b, a = (2 * each / (n - 1) - 1 for each, n in zip((rows, columns), self.image.shape, strict=True))
        order = len(coefficients) - 1
        values: np.ndarray = chebyshev.chebvander(b, order) @ coefficients @ chebyshev.chebvander(a, order).T
        return values


def _splines(size: int, period: float) -> tuple[csr_array, np.ndarray, np.ndarray, np.ndarray]:
    """Return the weights (points, size), the positions [px], which windows are whole, and their relative gain."""
    count = max(round((size - 1) / period), 2)
    centres = (np.arange(count) + 0.5) * (size - 1) / count
    t = np.abs(np.arange(size) - centres[:, None]) / period
    weights = np.where(t < 1, 4 - 6 * t**2 + 3 * t**3, np.where(t < 2, (2 - t) ** 3, 0.0))
    whole = (centres >= 2 * period) & (centres <= size - 1 - 2 * period)
    weights /= weights.sum(axis=1, keepdims=True)
    gain = 1 / np.sum(weights**2, axis=1)
    return csr_array(weights.astype(np.float32)), weights @ np.arange(size), whole, gain / gain.max()


def _linear(carrier: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the phase 2 pi f . p in Chebyshev form, without its constant."""
    coefficients = np.zeros((_MODEL_ORDER + 1, _MODEL_ORDER + 1))
    coefficients[0, 1] = np.pi * carrier[0] * (shape[1] - 1)
    coefficients[1, 0] = np.pi * carrier[1] * (shape[0] - 1)
    return coefficients


def _strong(amplitude: np.ndarray, windows: _Windows, valid: np.ndarray) -> np.ndarray:
    """Return where the grid is visible; refuse an image in which it hardly is."""
    if not valid.any():
        raise GridError("hardly any of the image shows the grid")
    strength = np.abs(amplitude)
    typical = float(np.percentile(strength[valid], _WELL_SEEN))
    if 2 * typical < _LOWEST_CONTRAST * float(np.mean(windows.mean[valid])):
        raise GridError(
            f"the lines of the grid change the grey level by {2 * typical:.1f} only: focus the camera, light the grid "
            "evenly, or print a coarser one"
        )
    shown: np.ndarray = strength > _FAINT * typical
    return shown


def _continuous(amplitude: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Return the phase of complex amplitudes [rad], continuous within half a turn about their mean."""
    middle = np.angle(np.sum(amplitude[valid]))
    phase: np.ndarray = middle + np.angle(amplitude * np.exp(-1j * middle))
    return phase


def _polynomial(values: np.ndarray, weights: np.ndarray, basis: Basis, order: int) -> np.ndarray:
    """Return the square coefficients of the polynomial that fits values at the points."""
    used = weights.ravel() > 0
    fitted = least_squares(basis.matrix[used, : terms(order)], values.ravel()[used], weights.ravel()[used])
    return square(fitted, _MODEL_ORDER)


def _from_differences(amplitude: np.ndarray, valid: np.ndarray, basis: Basis, order: int) -> np.ndarray:
    """Return a phase polynomial without constant, fitted to the phase differences of neighbours: no unwrapping."""
    products = basis.matrix[:, : terms(order)].reshape(*valid.shape, -1)
    parts, differences = [], []
    every, later, earlier = slice(None), slice(1, None), slice(None, -1)
    for after, before in (((every, later), (every, earlier)), ((later, every), (earlier, every))):
        both = valid[after] & valid[before]
        parts.append((products[after] - products[before])[both])
        differences.append(np.angle(amplitude[after] * amplitude[before].conj())[both])
    change = np.concatenate(differences)
    fitted = least_squares(np.concatenate(parts)[:, 1:], change, np.ones(len(change)))
    return square(np.concatenate([[0.0], fitted]), _MODEL_ORDER)


def _beyond(windows: _Windows, models: list[np.ndarray], carriers: np.ndarray, valid: np.ndarray) -> list[np.ndarray]:
    """Return the complex amplitudes of both directions at all points, including those of truncated windows."""
    waves = [windows.wave(model) for model in models]
    powers = {}
    for k, wave in enumerate(waves):
        powers[k, 0] = np.ones_like(wave)
        for n in (1, 2, 3):
            powers[k, n] = powers[k, n - 1] * wave
            powers[k, -n] = powers[k, n].conj()
    basis = Basis(windows.points, windows.image.shape, _LIGHT_ORDER)
    weights = valid.astype(float)
    left = windows.image.copy()
    amplitudes = {}
    for m, n in _COMPONENTS:
        if np.max(np.abs(m * carriers[0] + n * carriers[1])) > 0.5:
            continue  # aliased, possibly to the frequency of another component
        wave = powers[0, m] * powers[1, n]
        amplitude = windows.demodulate(wave)
        coefficients = _polynomial(amplitude, weights, basis, _LIGHT_ORDER)
        amplitudes[m, n] = windows.at_points(coefficients)
        twice = 1 if m == n == 0 else 2
        left -= twice * (windows.at_pixels(coefficients) * wave).real.astype(np.float32)
    return [amplitudes[key] + windows.sums(left * waves[k].conj()) for k, key in enumerate([(1, 0), (0, 1)])]
