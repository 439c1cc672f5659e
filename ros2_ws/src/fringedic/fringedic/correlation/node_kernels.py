"""Compiled loops over the nodes of the dense correlation: filters, fixed point, brightness, uncertainty and agreement.

Node arrays are float32 (channel, node row, node column). Bands of rows are processed in parallel and nothing is summed
across them, so results do not depend on the number of threads.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from fringedic.correlation.cell_kernels import GXE, GXX, GXY, GYE, GYY, SEEN, WE, WEE, WEF, WF, WFF, W
from fringedic.correlation.transfer import ORDER

f4 = np.float32

# Taps on either side of the centre of a window, and of the narrower filter of the predictor.
REACH = 6
NARROW_REACH = 4
# Node rows of a band.
BAND = 32

# An uneven texture of n speckles per window adds UNEVEN / (n + FEWEST) to the variance of a displacement: the fixed
# point amplifies the noise of weak places, and residuals are smaller by it. test_uncertainty_with_few_speckles.
UNEVEN = 2.5
FEWEST = 4.0
# Unresolved waves, see `bound_unresolved`: test_unresolved_waves_are_no_outliers and the tests of patches and borders.
EXPLAINED = 2 / 3
UNRESOLVED = 0.35  # [px]
CREST = 1.5


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _smooth_wide(padded: np.ndarray, taps: np.ndarray, line: np.ndarray, r: int, out: np.ndarray) -> None:
    """Compute row r of the separable symmetric filter of an array with REACH rows of zeros above and below.

    `line` is a work array with REACH zeros at either end. Compilers vectorise loops over a few rows at a time.
    """
    columns = out.size
    body = line[REACH : REACH + columns]
    t0, t1, t2, t3, t4, t5, t6 = taps[0], taps[1], taps[2], taps[3], taps[4], taps[5], taps[6]
    c = r + REACH
    m3, m2, m1, p0, p1, p2, p3 = (
        padded[c - 3], padded[c - 2], padded[c - 1], padded[c], padded[c + 1], padded[c + 2], padded[c + 3],
    )  # fmt: skip
    for k in range(columns):
        body[k] = t0 * p0[k] + t1 * (m1[k] + p1[k]) + t2 * (m2[k] + p2[k]) + t3 * (m3[k] + p3[k])
    m6, m5, m4, p4, p5, p6 = padded[c - 6], padded[c - 5], padded[c - 4], padded[c + 4], padded[c + 5], padded[c + 6]
    for k in range(columns):
        body[k] += t4 * (m4[k] + p4[k]) + t5 * (m5[k] + p5[k]) + t6 * (m6[k] + p6[k])
    for k in range(columns):
        out[k] = (
            t0 * line[k + 6]
            + t1 * (line[k + 5] + line[k + 7])
            + t2 * (line[k + 4] + line[k + 8])
            + t3 * (line[k + 3] + line[k + 9])
            + t4 * (line[k + 2] + line[k + 10])
            + t5 * (line[k + 1] + line[k + 11])
            + t6 * (line[k] + line[k + 12])
        )


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _smooth_narrow(padded: np.ndarray, taps: np.ndarray, line: np.ndarray, r: int, out: np.ndarray) -> None:
    """Do as `_smooth_wide` with NARROW_REACH taps and as many zeros at either end of `line`."""
    columns = out.size
    body = line[NARROW_REACH : NARROW_REACH + columns]
    t0, t1, t2, t3, t4 = taps[0], taps[1], taps[2], taps[3], taps[4]
    c = r + REACH
    m4, m3, m2, m1, p0 = padded[c - 4], padded[c - 3], padded[c - 2], padded[c - 1], padded[c]
    p1, p2, p3, p4 = padded[c + 1], padded[c + 2], padded[c + 3], padded[c + 4]
    for k in range(columns):
        body[k] = t0 * p0[k] + t1 * (m1[k] + p1[k]) + t2 * (m2[k] + p2[k]) + t3 * (m3[k] + p3[k]) + t4 * (m4[k] + p4[k])
    for k in range(columns):
        out[k] = (
            t0 * line[k + 4]
            + t1 * (line[k + 3] + line[k + 5])
            + t2 * (line[k + 2] + line[k + 6])
            + t3 * (line[k + 1] + line[k + 7])
            + t4 * (line[k] + line[k + 8])
        )


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def apply_window(nodes: np.ndarray, taps: np.ndarray, out: np.ndarray) -> None:
    """Filter node arrays (channel, node row, node column) by a separable symmetric window, zero outside.

    `taps` are REACH + 1 from the centre on. As many channels are filtered as `out` has.
    """
    channels, rows, columns = out.shape
    bands = -(-rows // BAND)
    for task in prange(channels * bands):
        channel, first = task // bands, task % bands * BAND
        size = min(BAND, rows - first)
        line, padded = np.zeros(columns + 2 * REACH, f4), np.zeros((BAND + 2 * REACH, columns), f4)
        for r in range(max(first - REACH, 0), min(first + size + REACH, rows)):
            padded[r - first + REACH] = nodes[channel, r]
        for r in range(size):
            _smooth_wide(padded, taps, line, r, out[channel, first + r])


@njit(cache=True, nogil=True, error_model="numpy")
def fit_planes(field: np.ndarray, weight: np.ndarray, out: np.ndarray) -> None:
    """Fit weighted planes a + b column + c row to every fourth node of each channel, out (channel, 3).

    A slope that the weights do not determine is zero.
    """
    channels, rows, columns = field.shape
    total, x0, y0 = 1e-30, 0.0, 0.0
    for r in range(0, rows, 4):
        for c in range(0, columns, 4):
            w = float(weight[r, c])
            total += w
            x0 += w * c
            y0 += w * r
    x0 /= total
    y0 /= total
    xx, xy, yy = 0.0, 0.0, 0.0
    sums = np.zeros((channels, 3))
    for r in range(0, rows, 4):
        for c in range(0, columns, 4):
            w = float(weight[r, c])
            x, y = c - x0, r - y0
            xx += w * x * x
            xy += w * x * y
            yy += w * y * y
            for channel in range(channels):
                value = w * field[channel, r, c]
                sums[channel, 0] += value
                sums[channel, 1] += value * x
                sums[channel, 2] += value * y
    determinant = xx * yy - xy * xy
    for channel in range(channels):
        value, along_x, along_y = sums[channel]
        slope_x, slope_y = 0.0, 0.0
        if determinant > 1e-6 * (xx * yy) and determinant > 0.0:
            slope_x = (yy * along_x - xy * along_y) / determinant
            slope_y = (xx * along_y - xy * along_x) / determinant
        out[channel, 0] = f4(value / total - slope_x * x0 - slope_y * y0)
        out[channel, 1] = f4(slope_x)
        out[channel, 2] = f4(slope_y)


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _add_neighbours(plane: np.ndarray, r: int, column: np.ndarray, out: np.ndarray) -> None:
    """Add the mean over 3 x 3 cells of a plane (node row, node column) to row r, `out`. `column` is a work array.

    The neighbourhood has sharp limits: texture at the far end of a window must not count for its bare centre.
    """
    rows, columns = plane.shape
    column[:] = f4(0)
    for k in range(max(r - 1, 0), min(r + 2, rows)):
        line = plane[k]
        for c in range(columns):
            column[c + 1] += line[c]
    ninth = f4(1.0 / 9.0)
    for c in range(columns):
        out[c] += ninth * (column[c] + column[c + 1] + column[c + 2])


@njit(nogil=True, error_model="numpy")
def _average_gradient_energy(cells: np.ndarray, r: int, column: np.ndarray, out: np.ndarray) -> None:
    """Average the sum of (df/dx)^2 + (df/dy)^2 per cell over 3 x 3 cells, in row r."""
    out[:] = f4(0)
    _add_neighbours(cells[GXX], r, column, out)
    _add_neighbours(cells[GYY], r, column, out)


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def average_gradient_energy(cells: np.ndarray, out: np.ndarray) -> None:
    """Average the sum of (df/dx)^2 + (df/dy)^2 per cell over 3 x 3 cells, out (node row, node column)."""
    for r in prange(out.shape[0]):
        column = np.empty(out.shape[1] + 2, f4)
        _average_gradient_energy(cells, r, column, out[r])


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def weigh_texture(cells: np.ndarray, least: float, factor: float, floor: float, out: np.ndarray) -> None:
    """Set out to floor, plus factor times the weight of the cells whose gradient energy is above `least`."""
    low, scale, add = f4(least), f4(factor), f4(floor)
    for r in prange(out.shape[0]):
        columns = out.shape[1]
        column, energy = np.empty(columns + 2, f4), np.empty(columns, f4)
        _average_gradient_energy(cells, r, column, energy)
        weight, target = cells[W, r], out[r]
        for c in range(columns):
            target[c] = add + (scale * weight[c] if energy[c] > low else f4(0))


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _multiply(a: np.ndarray, b: np.ndarray, out: np.ndarray) -> None:
    for c in range(out.size):
        out[c] = a[c] * b[c]


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _move(
    filtered: np.ndarray, inverse: np.ndarray, seen: np.ndarray, total: np.ndarray, left: np.ndarray, out: np.ndarray
) -> None:
    """Move filtered * inverse from `left` to `total`; `out` is the rest times `seen`."""
    for c in range(filtered.size):
        value = filtered[c] * inverse[c]
        total[c] += value
        rest = left[c] - value
        left[c] = rest
        out[c] = rest * seen[c]


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _subtract_explained(
    ge: np.ndarray,
    gx: np.ndarray,
    gy: np.ndarray,
    u: np.ndarray,
    v: np.ndarray,
    u0: np.ndarray,
    v0: np.ndarray,
    out: np.ndarray,
) -> None:
    """Subtract from the sums of gradient times residual the part that the change from (u0, v0) to (u, v) explains."""
    for c in range(out.size):
        out[c] = ge[c] - gx[c] * (u[c] - u0[c]) - gy[c] * (v[c] - v0[c])


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _relax(
    own: np.ndarray,
    other: np.ndarray,
    energies: tuple[np.ndarray, np.ndarray, np.ndarray],
    tau: np.float32,
    smooth: np.ndarray,
    relaxation: np.float32,
    out: np.ndarray,
) -> None:
    """Move `out`, one component, towards smooth + H^-1 (own, other) by the share `relaxation`.

    `energies` are the entries of H: own, mixed and other. The steps are limited to one pixel.
    """
    own_h, cross_h, other_h = energies
    for c in range(out.size):
        first, cross, second = own_h[c] + tau, cross_h[c], other_h[c] + tau
        step = (second * own[c] - cross * other[c]) / (first * second - cross * cross)
        target = smooth[c] + min(max(step, f4(-1)), f4(1))
        out[c] += relaxation * (target - out[c])


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _invert_coverage(padded: np.ndarray, taps: np.ndarray, inverse: np.ndarray) -> None:
    """Set `inverse` to 1 over the narrow filter of weights that have REACH rows of zeros above and below."""
    rows, columns = inverse.shape
    for band in prange(-(-rows // BAND)):
        line = np.zeros(columns + 2 * NARROW_REACH, f4)
        for r in range(band * BAND, min(band * BAND + BAND, rows)):
            _smooth_narrow(padded, taps, line, r, inverse[r])
            for c in range(columns):
                inverse[r, c] = f4(1) / inverse[r, c]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _predict(
    field: np.ndarray,
    seen: np.ndarray,
    inverse: np.ndarray,
    taps: np.ndarray,
    weighted: np.ndarray,
    rest: np.ndarray,
    smooth: np.ndarray,
) -> None:
    """Set `smooth` to S field with S = 1 - (1 - V)^ORDER; V is the narrow filter, normalised by the weights `seen`.

    `weighted` (2, 2, REACH + node row + REACH, node column), with zeros at the ends, and `rest` are work arrays.
    """
    _, rows, columns = field.shape
    for channel in prange(2):
        line, filtered = np.zeros(columns + 2 * NARROW_REACH, f4), np.empty(columns, f4)
        smooth[channel] = f4(0)
        for r in range(rows):
            rest[channel, r] = field[channel, r]
            _multiply(seen[r], rest[channel, r], weighted[channel, 0, r + REACH])
        for n in range(ORDER):
            source, target = weighted[channel, n % 2], weighted[channel, 1 - n % 2]
            for r in range(rows):
                _smooth_narrow(source, taps, line, r, filtered)
                _move(filtered, inverse[r], seen[r], smooth[channel, r], rest[channel, r], target[r + REACH])


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _correct(
    right: np.ndarray,
    sums: np.ndarray,
    taps: np.ndarray,
    tau: np.float32,
    smooth: np.ndarray,
    relaxation: np.float32,
    out: np.ndarray,
) -> None:
    """Move `out` towards smooth + H^-1 W * right; `right` has REACH rows of zeros above and below."""
    _, rows, columns = out.shape
    for band in prange(-(-rows // BAND)):
        line = np.zeros(columns + 2 * REACH, f4)
        along_x, along_y = np.empty(columns, f4), np.empty(columns, f4)
        for r in range(band * BAND, min(band * BAND + BAND, rows)):
            _smooth_wide(right[0], taps, line, r, along_x)
            _smooth_wide(right[1], taps, line, r, along_y)
            xx, xy, yy = sums[GXX, r], sums[GXY, r], sums[GYY, r]
            _relax(along_x, along_y, (xx, xy, yy), tau, smooth[0, r], relaxation, out[0, r])
            _relax(along_y, along_x, (yy, xy, xx), tau, smooth[1, r], relaxation, out[1, r])


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def iterate_fixed_point(
    cells: np.ndarray,
    sums: np.ndarray,
    seen: np.ndarray,
    start: np.ndarray,
    filters: tuple[np.ndarray, np.ndarray],
    tau: float,
    relaxations: np.ndarray,
    out: np.ndarray,
) -> None:
    """Iterate u = S u + H^-1 W * (grad f (e - grad f . (S u - start))) on the nodes; `out` (2, ...) is the first u.

    `filters` are the taps of W and of V, see `_predict` for S. Step k moves by the share `relaxations[k]`.
    """
    window, narrow = filters
    _, rows, columns = start.shape
    smooth, rest = np.empty((2, rows, columns), f4), np.empty((2, rows, columns), f4)
    weighted = np.zeros((2, 2, rows + 2 * REACH, columns), f4)
    right = np.zeros((2, rows + 2 * REACH, columns), f4)
    inverse = np.empty((rows, columns), f4)
    right[0, REACH : REACH + rows] = seen
    _invert_coverage(right[0], narrow, inverse)
    for k in range(relaxations.size):
        _predict(out, seen, inverse, narrow, weighted, rest, smooth)
        for r in prange(rows):
            u, v, u0, v0 = smooth[0, r], smooth[1, r], start[0, r], start[1, r]
            _subtract_explained(cells[GXE, r], cells[GXX, r], cells[GXY, r], u, v, u0, v0, right[0, r + REACH])
            _subtract_explained(cells[GYE, r], cells[GXY, r], cells[GYY, r], u, v, u0, v0, right[1, r + REACH])
        _correct(right, sums, window, f4(tau), smooth, relaxations[k], out)


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _subtract_moved(cells: np.ndarray, moved: np.ndarray, r: np.int64, out: np.ndarray) -> None:
    """Set `out` (6, node column) to H (3), grad f e (2) and e^2 of the cells of row r after a displacement."""
    u, v = moved[0, r], moved[1, r]
    xx, xy, yy, along_x, along_y = cells[GXX, r], cells[GXY, r], cells[GYY, r], cells[GXE, r], cells[GYE, r]
    energy = cells[WEE, r]
    out[0], out[1], out[2] = xx, xy, yy
    for c in range(u.size):
        x, y = along_x[c] - xx[c] * u[c] - xy[c] * v[c], along_y[c] - xy[c] * u[c] - yy[c] * v[c]
        out[3, c] = x
        out[4, c] = y
        out[5, c] = energy[c] - u[c] * (along_x[c] + x) - v[c] * (along_y[c] + y)


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def bound_unresolved(cells: np.ndarray, moved: np.ndarray, out: np.ndarray) -> None:
    """Bound the displacement (node row, node column) [px] that the window left in the residuals; 0 where none is seen.

    A wave d of which the window keeps T d leaves e = grad f . r + noise with r = (1 - T) d: no outlier, however small
    the noise is. r is the least-squares displacement of 3 x 3 cells. Glare and decorrelated patches do not follow the
    gradient: of m independent pixels two parameters explain about 2 / m of the residual's energy, so r counts if it
    explains EXPLAINED of it. Below this share noise is at least 1 / sqrt(3) of the residual, and the limit for noise
    is wide enough. More than UNRESOLVED px are no wave but the border between two motions. A crest is higher than its
    mean over the cells by up to CREST for the waves that T does not remove, and it may be in a neighbouring cell.
    """
    _, rows, columns = moved.shape
    left = np.zeros((rows + 2, 6, columns + 2), f4)
    found = np.zeros((rows + 2, columns + 2), f4)
    for r in prange(rows):
        # a parallel loop counts in uint64, which the function would be compiled for beside int64
        _subtract_moved(cells, moved, np.int64(r), left[r + 1, :, 1:-1])
    for r in prange(rows):
        column, target = left[r] + left[r + 1] + left[r + 2], found[r + 1]
        total = column[:, :-2] + column[:, 1:-1] + column[:, 2:]
        for c in range(columns):
            xx, xy, yy, along_x, along_y = total[0, c], total[1, c], total[2, c], total[3, c], total[4, c]
            scale = f4(1) / max(xx * yy - xy * xy, f4(1e-12))
            x, y = (yy * along_x - xy * along_y) * scale, (xx * along_y - xy * along_x) * scale
            seen = x * along_x + y * along_y > f4(EXPLAINED) * total[5, c]
            length = np.sqrt(x * x + y * y)
            target[c + 1] = f4(CREST) * length if seen and length < f4(UNRESOLVED) else f4(0)
    for r in prange(rows):
        highest = np.maximum(np.maximum(found[r], found[r + 1]), found[r + 2])
        for c in range(columns):
            out[r, c] = max(max(highest[c], highest[c + 1]), highest[c + 2])


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def match_gain_offset(nodes: np.ndarray, sums: np.ndarray, floor: float) -> None:
    """Set gain (channel 2) and offset (channel 3) so that g has the mean and standard deviation of f in every window.

    `floor` is the variance below which contrasts are not compared.
    """
    least = f4(floor)
    for r in prange(nodes.shape[1]):
        for c in range(nodes.shape[2]):
            w = sums[W, r, c]
            if not w > f4(0):
                continue
            mean_f, mean_e = sums[WF, r, c] / w, sums[WE, r, c] / w
            mean_g = mean_f - mean_e
            var_f = max(sums[WFF, r, c] / w - mean_f * mean_f, f4(0))
            second_g = (sums[WFF, r, c] - f4(2) * sums[WEF, r, c] + sums[WEE, r, c]) / w
            var_g = max(second_g - mean_g * mean_g, f4(0))
            ratio = min(max(np.sqrt((var_f + least) / (var_g + least)), f4(0.5)), f4(2))
            nodes[2, r, c] = min(max(ratio * nodes[2, r, c], f4(0.1)), f4(10))
            nodes[3, r, c] = ratio * nodes[3, r, c] + mean_f - ratio * mean_g


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _weigh_change(field: np.ndarray, before: np.ndarray, seen: np.ndarray, out: np.ndarray) -> None:
    """Multiply the change of a field (channel, node row, node column) by weights."""
    for r in prange(field.shape[1]):
        for channel in range(field.shape[0]):
            for c in range(field.shape[2]):
                out[channel, r, c] = seen[r, c] * (field[channel, r, c] - before[channel, r, c])


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def van_cittert(field: np.ndarray, before: np.ndarray, seen: np.ndarray, taps: np.ndarray, passes: int) -> None:
    """Deconvolve the change of a field by the window (van Cittert iteration), in place.

    A window K returns K c for a change c. This differs from c at an edge, where the window is one-sided, and on a
    curved shading. After n passes of x = x + K c - K x, begun at x = K c, the error is (1 - K)^(n + 1) c.

    References
    ----------
    P. H. van Cittert (1931), Zeitschrift fuer Physik 69, 298-308.
    """
    channels, rows, columns = field.shape
    weighted = np.empty((channels + 1, rows, columns), f4)
    spread = np.empty((channels + 1, rows, columns), f4)
    found = field - before
    weighted[channels] = seen
    for _ in range(passes):
        _weigh_change(field, before, seen, weighted)
        apply_window(weighted, taps, spread)
        for r in prange(rows):
            for channel in range(channels):
                for c in range(columns):
                    field[channel, r, c] += found[channel, r, c] - spread[channel, r, c] / spread[channels, r, c]


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def extrapolate(field: np.ndarray, plane: np.ndarray, seen: np.ndarray, taps: np.ndarray) -> None:
    """Extrapolate from the neighbours, around their planes (channel, 3), where little of a window is seen; in place."""
    channels, rows, columns = field.shape
    weighted = np.empty((channels + 1, rows, columns), f4)
    spread = np.empty((channels + 1, rows, columns), f4)
    weighted[channels] = seen
    for r in prange(rows):
        for channel in range(channels):
            for c in range(columns):
                flat = plane[channel, 0] + plane[channel, 1] * f4(c) + plane[channel, 2] * f4(r)
                weighted[channel, r, c] = seen[r, c] * (field[channel, r, c] - flat)
    apply_window(weighted, taps, spread)
    for r in prange(rows):
        for channel in range(channels):
            for c in range(columns):
                flat = plane[channel, 0] + plane[channel, 1] * f4(c) + plane[channel, 2] * f4(r)
                own = min(f4(2) * spread[channels, r, c], f4(1))
                others = flat + spread[channel, r, c] / spread[channels, r, c]
                field[channel, r, c] = own * field[channel, r, c] + (f4(1) - own) * others


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def subtract_planes(field: np.ndarray, plane: np.ndarray, out: np.ndarray) -> None:
    """Subtract planes (channel, 3) from a field."""
    for r in prange(field.shape[1]):
        for channel in range(field.shape[0]):
            a, b = plane[channel, 0] + plane[channel, 2] * f4(r), plane[channel, 1]
            for c in range(field.shape[2]):
                out[channel, r, c] = field[channel, r, c] - (a + b * f4(c))


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _estimate_speckle_area(variance: np.float32, energy: np.float32) -> np.float32:
    """Return the area 2 pi r^2 [px^2] of a speckle from var f and var df/dx = var f / (2 r^2)."""
    return f4(np.pi) * variance / max(energy, f4(1e-12))


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def estimate_uncertainty(
    nodes: np.ndarray,
    cells: np.ndarray,
    sums: np.ndarray,
    kept: np.ndarray,
    window: tuple[float, float],
    tau_factor: float,
    texture: float,
    out: np.ndarray,
) -> None:
    """Estimate standard deviations of the nodes and find the cells with texture, out (5, node row, node column).

    Channels of `out`: standard deviations of d_x and d_y [px]; tau, the gradient energy of noise, `tau_factor` times
    the variance of a pixel; the weight of the cells with `texture` times that energy along both axes; the share of
    agreeing pixels in the node's own cell, or in the 3 x 3 cells around it if that is smaller. `kept` is the share of
    white noise that interpolation keeps at fractions k / (kept.size - 1) of a pixel; `window` contains the variance at
    a node over that of its window in an even texture, and the effective area [px^2] of the window.
    """
    node_gain, area = f4(window[0]), f4(window[1])
    steps = f4(kept.size - 1)
    for r in prange(nodes.shape[1]):
        columns = nodes.shape[2]
        column, energy, count = np.empty(columns + 2, f4), np.empty(columns, f4), np.empty(columns, f4)
        _average_gradient_energy(cells, r, column, energy)
        own = out[4, r]
        own[:] = f4(0)
        _add_neighbours(cells[W], r, column, own)
        count[:] = f4(0)
        _add_neighbours(cells[SEEN], r, column, count)
        for c in range(columns):
            share = own[c] / max(count[c], f4(1))
            own[c] = min(share, cells[W, r, c] / cells[SEEN, r, c]) if cells[SEEN, r, c] > f4(0) else share
        for c in range(columns):
            inverse = f4(1) / max(sums[W, r, c], f4(1e-6))
            mean_e = sums[WE, r, c] * inverse
            var_e = max(sums[WEE, r, c] * inverse - mean_e * mean_e, f4(0))
            x, y = nodes[0, r, c], nodes[1, r, c]
            share = kept[int(np.rint((x - np.floor(x)) * steps))] * kept[int(np.rint((y - np.floor(y)) * steps))]
            gain = nodes[2, r, c] * nodes[2, r, c]
            pixel = var_e * (f4(1) + gain) / (f4(1) + gain * share)
            tau = f4(tau_factor) * pixel
            xx, xy, yy = sums[GXX, r, c], sums[GXY, r, c], sums[GYY, r, c]
            mean_f = sums[WF, r, c] * inverse
            var_f = max(sums[WFF, r, c] * inverse - mean_f * mean_f, f4(0))
            speckle = _estimate_speckle_area(var_f, f4(0.5) * (xx + yy) * inverse)
            uneven = f4(UNEVEN) * speckle / (area + f4(FEWEST) * speckle)
            # The noise of the reference adds tau to H, which is no information on the motion.
            xx, yy = max(xx - tau, f4(1e-12)), max(yy - tau, f4(1e-12))
            variance = pixel * (f4(1) + uneven) * node_gain / max(xx * yy - xy * xy, f4(1e-30))
            out[0, r, c] = np.sqrt(variance * yy)
            out[1, r, c] = np.sqrt(variance * xx)
            out[2, r, c] = tau
            out[3, r, c] = cells[W, r, c] if energy[c] > f4(2 * texture) * tau else f4(0)


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def measure_agreement(
    sums: np.ndarray, wide: np.ndarray, area: float, explained: np.ndarray, smallest: np.ndarray
) -> None:
    """Compute the adjusted coefficient of determination in twice the window, and the smaller eigenvalue of H.

    r^2 is adjusted for the parameters (two of motion, two of brightness) by the number of speckles in the window, whose
    effective area is `area` [px^2]: with few independent speckles any two windows can be made to agree. The adjustment
    is limited to a factor of 10.
    """
    for r in prange(sums.shape[1]):
        for c in range(sums.shape[2]):
            w = max(sums[W, r, c], f4(1e-6))
            mean_f = sums[WF, r, c] / w
            var_f = max(sums[WFF, r, c] / w - mean_f * mean_f, f4(0))
            xx, xy, yy = sums[GXX, r, c], sums[GXY, r, c], sums[GYY, r, c]
            energy = f4(0.5) * (xx + yy)
            smallest[r, c] = energy - np.sqrt(f4(0.25) * (xx - yy) * (xx - yy) + xy * xy)
            speckle = _estimate_speckle_area(var_f, energy / w)
            freedom = max(f4(2) * f4(area) / max(speckle, f4(1e-6)) - f4(1), f4(1e-6))
            inverse = f4(1) / max(wide[W, r, c], f4(1e-6))
            mean_f, mean_e = wide[WF, r, c] * inverse, wide[WE, r, c] * inverse
            var_f = max(wide[WFF, r, c] * inverse - mean_f * mean_f, f4(0))
            var_e = max(wide[WEE, r, c] * inverse - mean_e * mean_e, f4(0))
            covariance = wide[WEF, r, c] * inverse - mean_f * mean_e
            var_g = max(var_f - f4(2) * covariance + var_e, f4(0))
            correlation = (var_f - covariance) / np.sqrt(max(var_f * var_g, f4(1e-12)))
            correlation = min(max(correlation, f4(0)), f4(1))
            left = f4(1) - correlation * correlation
            explained[r, c] = f4(1) - left * freedom / max(freedom - f4(4), f4(0.1) * freedom)


@njit(nogil=True, error_model="numpy")
def _median(a: np.float32, b: np.float32, c: np.float32) -> np.float32:
    return max(min(a, b), min(max(a, b), c))


@njit(cache=True, nogil=True, error_model="numpy")
def filter_median(nodes: np.ndarray, out: np.ndarray) -> None:
    """Apply a median filter of 3 x 3 nodes to each channel; the outermost nodes are repeated.

    The median of nine is the median of the greatest of the row minima, the median of the row medians and the smallest
    of the row maxima, rows being sorted triples.
    """
    channels, rows, columns = nodes.shape
    lowest, middle, highest = np.empty(columns, f4), np.empty(columns, f4), np.empty(columns, f4)
    for channel in range(channels):
        for r in range(rows):
            above, here, below = nodes[channel, max(r - 1, 0)], nodes[channel, r], nodes[channel, min(r + 1, rows - 1)]
            for c in range(columns):
                x, y, z = above[c], here[c], below[c]
                lowest[c] = min(min(x, y), z)
                middle[c] = _median(x, y, z)
                highest[c] = max(max(x, y), z)
            for c in range(columns):
                left, right = max(c - 1, 0), min(c + 1, columns - 1)
                out[channel, r, c] = _median(
                    max(max(lowest[left], lowest[c]), lowest[right]),
                    _median(middle[left], middle[c], middle[right]),
                    min(min(highest[left], highest[c]), highest[right]),
                )
