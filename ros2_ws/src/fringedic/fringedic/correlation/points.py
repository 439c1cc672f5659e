"""Displacement at the points of a result by the dense method.

A first measurement follows the motion of the image as a whole. Of a periodic texture it finds one of several possible
displacements, which are compared then. Where texture is left without a result, `other_motions` are sought.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fringedic.correlation import resampling_kernels
from fringedic.correlation.affine import fit_motion
from fringedic.correlation.agreement import REFUSED, Nodes
from fringedic.correlation.blocks import explain_compression
from fringedic.correlation.images import Photometry
from fringedic.correlation.lattice import Lattice, choose_displacement, shift_by_repetition
from fringedic.correlation.other_motions import (
    fill_a_window,
    find_unmatched,
    keep_wide,
    leave_out_rims,
    measure_other_motions,
    separate,
)
from fringedic.correlation.periodic_start import start_of_lattice
from fringedic.correlation.prepared import Prepared
from fringedic.correlation.pyramid import build_pyramid, inpaint, sample_initial
from fringedic.correlation.texture_noise import TextureNoise
from fringedic.errors import CorrelationError, ErrorCode

f4 = np.float32

_MOST = 0.75  # of the points; where fewer are measured of a faint texture, pixels are averaged


@dataclass(frozen=True, eq=False)
class Points:
    """Result at the points.

    Attributes
    ----------
    displacement, sigma : (2, row, column) float32
        Displacement and its standard uncertainty [px]; NaN where not valid.
    valid : (row, column) bool
        Where they hold.
    attributes
        What is to be known of the result besides, see `measure_displacement`.
    """

    displacement: np.ndarray
    sigma: np.ndarray
    valid: np.ndarray
    attributes: dict[str, Any] = field(default_factory=dict)


def measure_points(
    reference: Prepared, deformed: np.ndarray, photometry: Photometry, start: np.ndarray | None, spacing: int
) -> Points:
    """Measure the displacement at every `spacing`-th pixel.

    Parameters
    ----------
    deformed
        Grey levels (row, column) in standard deviations of the reference; NaN where nothing is known.
    photometry
        Their brightness and saturation.
    start
        Expected displacement (2, row, column) [px] at the points, NaN where unknown; None searches globally.

    Raises
    ------
    CorrelationError
        The images do not show the same surface.
    """
    try:
        points = _measure_motions(reference, deformed, photometry, start, spacing)
    except CorrelationError as error:
        if error.code is not ErrorCode.NO_CORRELATION:
            raise
        binned = _measure_binned(reference, deformed, photometry, start, spacing)
        if binned is not None:
            return binned
        if cause := _explain(reference, str(error)):
            raise CorrelationError(cause, code=error.code) from error
        raise
    wanted = np.isfinite(reference.values[::spacing, ::spacing])
    if np.count_nonzero(points.valid) < _MOST * np.count_nonzero(wanted):
        binned = _measure_binned(reference, deformed, photometry, start, spacing)
        if binned is not None and np.count_nonzero(binned.valid) > np.count_nonzero(points.valid):
            return binned
    return points


def _explain(reference: Prepared, refusal: str) -> str:
    """Return the message of a refusal with the texture as its cause, or as a possible one; empty where it is none."""
    level = reference.levels[0]
    faint = TextureNoise.of(level).sentence
    if faint and reference.binned() is None:
        return f"{REFUSED}: {faint}"
    # averaged pixels, or less compression, would show the texture: either image may be the cause
    possible = faint or explain_compression(level, reference.deviation)
    return f"{refusal}. Besides, {possible}" if possible else ""


def _measure_binned(
    reference: Prepared, deformed: np.ndarray, photometry: Photometry, start: np.ndarray | None, spacing: int
) -> Points | None:
    """Measure with averaged pixels where the texture is faint; None where it is not, or where this does not help."""
    binned = reference.binned()
    if binned is None:
        return None
    try:
        points = _measure_motions(binned, deformed, photometry, start, spacing)
    except CorrelationError as error:
        if error.code is not ErrorCode.NO_CORRELATION:
            raise
        return None
    return replace(points, attributes=points.attributes | {"binning_px": binned.binning, "window_px": binned.width})


def _measure_motions(
    reference: Prepared, deformed: np.ndarray, photometry: Photometry, start: np.ndarray | None, spacing: int
) -> Points:
    """Measure all motions of the image with the binning of the reference."""
    prediction = None
    if start is not None and np.isfinite(start).any():
        rows, columns = reference.levels[0].shape
        shape = (rows * reference.binning, columns * reference.binning)
        prediction = sample_initial(start, shape, reference.cell, spacing)
    attributes: dict[str, Any] = {}
    if reference.lattice is None:
        nodes = reference.measure(deformed, photometry, prediction)
    else:
        nodes, unique = _measure_periodic(reference, reference.lattice, deformed, photometry, prediction)
        if not unique:
            attributes["repeats_px"] = [float(each) for each in reference.lattice.vectors.ravel()]
    unmatched = find_unmatched(reference, nodes)
    if not fill_a_window(reference, unmatched):
        return replace(_evaluate(leave_out_rims(nodes, unmatched), reference, spacing), attributes=attributes)
    motions = [nodes, *measure_other_motions(reference, deformed, photometry, nodes)]
    if len(motions) > 1:
        apart = separate(reference, deformed, photometry, motions)
        points = _join(reference, apart, spacing)
        unmatched = keep_wide(reference, unmatched & ~np.any([each.valid for each, _ in apart], axis=0))
    else:
        points = _evaluate(leave_out_rims(nodes, unmatched), reference, spacing)
    part = float(np.count_nonzero(unmatched) / np.count_nonzero(reference.texture.rich))
    return replace(points, attributes=attributes | {"motions": len(motions), "unmatched_fraction": part})


def _measure_periodic(
    reference: Prepared,
    lattice: Lattice,
    deformed: np.ndarray,
    photometry: Photometry,
    prediction: np.ndarray | None,
) -> tuple[Nodes, bool]:
    """Return the displacement of those that a periodic texture allows, and whether the texture decides."""
    expected = np.zeros(2) if prediction is None else prediction.mean(axis=(1, 2), dtype=float)
    if prediction is None:
        prediction = start_of_lattice(
            reference.values, deformed, build_pyramid(deformed), lattice, reference.window.cell
        )
    nodes = reference.measure(deformed, photometry, prediction)
    everywhere = reference.at_pixels(nodes.displacement)
    everywhere[:, ~reference.spread(nodes.valid)] = np.nan
    gradient = fit_motion(nodes.displacement, reference.window.cell)[:, 1:]
    choice = choose_displacement(reference.values, deformed, everywhere, gradient, lattice, expected)
    if choice.shift.any():
        known = np.where(nodes.valid, nodes.displacement, f4(np.nan))
        prediction = inpaint(shift_by_repetition(known, gradient, choice.shift, reference.cell).astype(f4))
        nodes = reference.measure(deformed, photometry, prediction)
    return nodes, choice.unique


def _evaluate(nodes: Nodes, reference: Prepared, spacing: int) -> Points:
    """Return the result at every `spacing`-th pixel from that at the nodes."""
    cell, values = reference.cell, reference.values
    rows, columns = ((np.arange(0, n, spacing) - 0.5 * (cell - 1)) / cell for n in values.shape)
    near_rows, near_columns = (
        np.clip(np.rint(each).astype(np.intp), 0, n - 1)
        for each, n in zip((rows, columns), nodes.valid.shape, strict=True)
    )
    lines = np.empty((4, nodes.valid.shape[0] + 4, values.shape[1]), f4)
    resampling_kernels.upsample_nodes(np.concatenate([nodes.displacement, nodes.sigma]), cell, lines)
    lines = np.ascontiguousarray(lines[:, :, ::spacing])
    fields = np.empty((4, rows.size, columns.size), f4)
    valid = np.empty((rows.size, columns.size), np.bool_)
    measured = np.ascontiguousarray(values[::spacing, ::spacing])
    resampling_kernels.evaluate_points(lines, rows, nodes.valid, near_rows, near_columns, measured, fields, valid)
    return Points(fields[:2], fields[2:], valid)


def _join(reference: Prepared, motions: list[tuple[Nodes, np.ndarray]], spacing: int) -> Points:
    """Return at each point the first of the motions that holds there."""
    values = np.full((4, *reference.values[::spacing, ::spacing].shape), np.nan, f4)
    for nodes, holds in motions:
        points = _evaluate(nodes, reference, spacing)
        taken = points.valid & holds[::spacing, ::spacing] & np.isnan(values[0])
        values[:, taken] = np.concatenate([points.displacement, points.sigma])[:, taken]
    return Points(values[:2], values[2:], np.isfinite(values[0]))
