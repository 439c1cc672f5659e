"""Where a measured displacement is valid, and its standard uncertainty, from the residuals of the fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fringedic.correlation import cell_kernels, node_kernels
from fringedic.correlation.dense import TEXTURE, Field
from fringedic.correlation.pyramid import DERIVATIVE_NOISE, Level, count_nodes
from fringedic.correlation.window import Window
from fringedic.errors import CorrelationError, ErrorCode
from fringedic.frames.interpolation import tabulate_noise_gain

f4 = np.float32

REFUSED = "the deformed image does not correlate with the reference"
NOISE_GAIN = tabulate_noise_gain()
# Smallest adjusted coefficient of determination of a valid point, and smallest share of the textured windows that has
# to agree; test_another_scene_is_refused_by_every_window and test_patch_that_changed.
SMALLEST_EXPLAINED = 0.25
SMALLEST_AGREEMENT = 0.1
# Share of a window with texture, share of agreeing pixels next to a point, and share of the gradient energy of its
# window that these pixels have, of a valid point; test_a_bare_patch_is_not_measured,
# test_a_still_surface_beside_the_specimen and test_blocks_of_dark_jpeg_images_are_no_texture.
SMALLEST_COVERAGE = 1 / 2
SMALLEST_SHARE = 1 / 3
SMALLEST_ENERGY_SHARE = 1 / 3
# Part of the difference between the displacement (without its plane) and its mean over a one-sided window that remains
# as an error; twice this part where hardly more than half of the window is covered (benchmarks/edges.py).
TRUNCATED = 0.95  # covered part of a window below which it is one-sided
HALVED = 0.66  # as at the outermost nodes along a straight edge
TRUNCATION = 0.15
FEW = 20  # values from which a variance is known to 30 %: sqrt(2 / 20)


@dataclass(frozen=True)
class Nodes:
    """Result at the nodes.

    Attributes
    ----------
    displacement, sigma : (2, node row, node column) float32
        Displacement and its standard uncertainty [px].
    valid : (node row, node column) bool
        Where they hold.
    """

    displacement: np.ndarray
    sigma: np.ndarray
    valid: np.ndarray


@dataclass(frozen=True)
class Texture:
    """Texture of a reference at the nodes.

    Attributes
    ----------
    energy : (node row, node column) float32
        Sum of (df/dx)^2 + (df/dy)^2 over each cell.
    rich : (node row, node column) bool
        Cells with a tenth of the gradient energy of the richest parts: a match is expected there.
    """

    energy: np.ndarray
    rich: np.ndarray


def adjust_determination(correlation: np.ndarray, speckles: np.ndarray) -> np.ndarray:
    """Return r^2 of a fit, adjusted for its parameters (two of motion, two of brightness).

    With few independent speckles any two windows can be made to agree. The adjustment is limited to a factor of 10.

    Parameters
    ----------
    correlation
        Correlation coefficients, any shape.
    speckles
        Numbers of independent values.
    """
    freedom = np.maximum(speckles - 1, 1e-6)
    return np.asarray(1 - (1 - np.clip(correlation, 0, 1) ** 2) * freedom / np.maximum(freedom - 4, freedom / 10))


def measure_texture(level: Level, cell: int) -> Texture:
    """Measure the gradient energy of a reference, and where it is rich enough for a match."""
    cells = np.empty((cell_kernels.GYY + 1, *count_nodes(level.shape, cell)), f4)
    cell_kernels.accumulate_gradients(level.along_x, level.along_y, cell, cells)
    average = np.empty(cells.shape[1:], f4)
    node_kernels.average_gradient_energy(cells, average)
    energy = cells[cell_kernels.GXX] + cells[cell_kernels.GYY]
    return Texture(energy, average > 0.1 * np.quantile(average, 0.95))


def check_agreement(agreed: int, offered: int) -> None:
    """Refuse a pair of images of which less than a tenth of the textured reference agrees.

    Raises
    ------
    CorrelationError
        With the code NO_CORRELATION.
    """
    if agreed <= SMALLEST_AGREEMENT * offered:
        raise CorrelationError(
            f"{REFUSED}: {agreed} of {offered} windows with texture "
            "agree. Check that both show the same surface, in focus, and that it has not left the image; take more "
            "images in between if it changes much",
            code=ErrorCode.NO_CORRELATION,
        )


def assess(field: Field, window: Window, texture: Texture) -> Nodes:
    """Estimate the uncertainty of a finished field and decide where it is valid.

    The covariance of a point is s^2 (H - H_n)^-1 times the mean of T^2 (Sutton, Orteu, Schreier 2009, section 5.6, with
    the window's weights), where H_n is what the noise of the reference alone adds to H. s^2 is the local variance of
    the residual, corrected for the noise that interpolation averages out, times the ratio of
    `_compare_with_white_noise`; uneven textures (few speckles per window) and one-sided windows
    (`_estimate_truncation`) add to it. A point is valid where at least half of its window is seen and has texture
    beyond that of noise alone, where a third of its neighbourhood agrees (a window that extends over a border also
    contains the motion of the other side) and has a third of its gradient energy, and where f and g correlate. Without
    the limit of the energy, the dark surroundings of bright spots agree in compressed images of different scenes,
    because their blocks resemble one another; the spots are outliers there.

    Parameters
    ----------
    field
        From `estimate_nodes`.
    window
        It was measured with.
    texture
        Of the reference.

    Raises
    ------
    CorrelationError
        Hardly any point agrees.

    References
    ----------
    M. A. Sutton, J.-J. Orteu, H. W. Schreier (2009), Image correlation for shape, motion and deformation measurements,
    Springer.
    """
    cells, sums, cell2 = field.cells, field.sums, window.cell**2
    shape = sums.shape[1:]
    estimate = np.empty((5, *shape), f4)
    gain, area = window.gains.noise, 4 * np.pi * window.deviation**2
    tau_factor = DERIVATIVE_NOISE / 2 * cell2
    # a motion with a frame of its own passes all parts of a pixel within a window
    kept = NOISE_GAIN if field.frame.motion is None else np.full_like(NOISE_GAIN, NOISE_GAIN.mean())
    node_kernels.estimate_uncertainty(field.nodes, cells, sums, kept, (gain, area), tau_factor, TEXTURE, estimate)
    sigma, tau, rich, own = estimate[:2], estimate[2], estimate[3:4], estimate[4]
    covered = np.empty_like(rich)
    node_kernels.apply_window(rich, window.taps, covered)
    # Agreement is evaluated in a window twice as large: a few speckles can always be made to agree.
    wide = np.empty_like(sums)
    node_kernels.apply_window(sums, window.taps, wide)
    share, smallest = np.empty(shape, f4), np.empty(shape, f4)
    node_kernels.measure_agreement(sums, wide, area, share, smallest)
    valid = (covered[0] >= f4(cell2 * SMALLEST_COVERAGE)) & (own > f4(SMALLEST_SHARE))
    valid &= (smallest > f4(TEXTURE) * tau) & (share > SMALLEST_EXPLAINED)
    valid &= _measure_energy_share(cells, texture, window) > SMALLEST_ENERGY_SHARE
    check_agreement(int(np.count_nonzero(valid & texture.rich)), int(np.count_nonzero(texture.rich)))
    noise = f4(np.sqrt(_compare_with_white_noise(field, window, tau / f4(tau_factor), valid)))
    sigma = np.hypot(noise * sigma, _estimate_truncation(field.nodes[:2], rich[0], covered[0], window))
    # What is not valid keeps a usual value, so that interpolation between nodes does not overshoot next to it.
    usual = np.median(sigma[:, valid][:, ::8])
    sigma = field.frame.turn_sigma(np.where(valid, sigma, usual))
    return Nodes(field.frame.total(field.nodes[:2], 0, window.cell), sigma, valid)


def _measure_energy_share(cells: np.ndarray, texture: Texture, window: Window) -> np.ndarray:
    """Return the share of the gradient energy in each window that its agreeing pixels have (node row, node column).

    Pixels that are not seen in the deformed image, or saturated there, count as those of their cell that are seen.
    """
    seen = cells[cell_kernels.SEEN] * f4(1 / window.cell**2)
    energies = np.stack([cells[cell_kernels.GXX] + cells[cell_kernels.GYY], texture.energy * seen])
    sums = np.empty_like(energies)
    node_kernels.apply_window(energies, window.taps, sums)
    return np.asarray(sums[0] / np.maximum(sums[1], f4(1e-12)))


def _estimate_truncation(displacement: np.ndarray, rich: np.ndarray, covered: np.ndarray, window: Window) -> np.ndarray:
    """Return the standard uncertainty (2, node row, node column) [px] that a one-sided window adds.

    The mean over a window that an edge cuts is displaced: where the displacement without its plane differs from its
    mean over the covered part, the fixed point cannot recover all of the difference. Whole windows have no such error.
    """
    plane, rest = np.empty((2, 3), f4), np.empty_like(displacement)
    node_kernels.fit_planes(displacement, rich, plane)
    node_kernels.subtract_planes(displacement, plane, rest)
    mean = np.empty_like(rest)
    node_kernels.apply_window(rest * rich, window.taps, mean)
    mean /= np.maximum(covered, f4(1e-6))
    part = covered / f4(window.cell**2)
    factor = f4(TRUNCATION) * ((part < f4(TRUNCATED)).astype(f4) + (part < f4(HALVED)))
    return np.asarray(factor * np.abs(rest - mean))


def _compare_with_white_noise(field: Field, window: Window, pixel: np.ndarray, valid: np.ndarray) -> float:
    """Return the variance of the sums of gradient times residual over that for independent residuals.

    Only these sums move the displacement. Residuals of noise are independent. Residuals of interpolation, where grey
    levels change faster than pixels follow, alternate from pixel to pixel and hardly change the sums; residuals of a
    blurred or compressed noise agree and change the sums more. The sums that the fit left are compared with those that
    it leaves of independent residuals, both through V: about the frequencies that T passes.

    `pixel` is the local variance of the residual. Few values are uncertain and count as independent.
    """
    u, v = field.moved
    gxx, gxy, gyy = field.cells[[cell_kernels.GXX, cell_kernels.GXY, cell_kernels.GYY]]
    left = np.stack(
        [field.cells[cell_kernels.GXE] - gxx * u - gxy * v, field.cells[cell_kernels.GYE] - gxy * u - gyy * v]
    )
    white = pixel * np.stack([gxx, gyy])
    taps = np.zeros(node_kernels.REACH + 1, f4)
    taps[: window.narrow_taps.size] = window.narrow_taps
    through, expected = np.empty_like(left), np.empty_like(white)
    node_kernels.apply_window(left, taps, through)
    node_kernels.apply_window(white, taps**2, expected)
    values = through[:, valid] ** 2 / np.maximum(expected[:, valid], f4(1e-30))
    number = 2 * window.gains.independent * values.shape[1]
    return float((number * float(values.mean()) / window.gains.left + FEW) / (number + FEW))
