"""Colour previews (rgb8) of phase maps and displacement images."""

from __future__ import annotations

import cv2
import numpy as np

NOT_MEASURED = (128, 128, 128)
LONGEST_SIDE = 512  # [px] of the preview of a displacement, which is smooth; every pixel would take 0.1 s


def phase_preview(phase: np.ndarray) -> np.ndarray:
    """Colour a phase map, one turn of the colour circle per fringe.

    Parameters
    ----------
    phase
        Phase [rad], shape (row, column), NaN where not measured.

    Returns
    -------
    ndarray
        uint8 (row, column, 3), red green blue; grey where not measured.

    Examples
    --------
    >>> phase_preview(np.array([[0.0, np.nan]])).tolist()
    [[[255, 55, 55], [128, 128, 128]]]
    """
    turns = np.mod(np.nan_to_num(phase) / (2 * np.pi), 1.0)
    circle = np.stack([turns * 180, np.full_like(turns, 200), np.full_like(turns, 255)], axis=-1)
    return _coloured(circle, np.isfinite(phase))


def displacement_preview(displacement: np.ndarray) -> np.ndarray:
    """Colour an in-plane displacement.

    Parameters
    ----------
    displacement
        x (right) and y (down) [px], shape (row, column, 2), NaN where not measured.

    Returns
    -------
    ndarray
        uint8 (row, column, 3), red green blue; grey where not measured. The hue is the direction (red to the right,
        green-yellow upwards), the saturation the length relative to its 99th percentile. Of a larger displacement every
        second, third ... row and column are coloured, so that neither side is longer than `LONGEST_SIDE`.

    Examples
    --------
    >>> displacement_preview(np.array([[[2.0, 0.0], [0.0, 0.0]]])).tolist()
    [[[255, 0, 0], [255, 255, 255]]]
    """
    every = -(-max(displacement.shape[:2]) // LONGEST_SIDE)
    along, down = np.moveaxis(displacement[::every, ::every], -1, 0)
    measured = np.isfinite(along) & np.isfinite(down)
    length = np.hypot(np.nan_to_num(along), np.nan_to_num(down))
    longest = max(float(np.percentile(length[measured], 99)) if measured.any() else 0.0, 1e-6)
    turns = np.mod(np.arctan2(-np.nan_to_num(down), np.nan_to_num(along)) / (2 * np.pi), 1.0)
    circle = np.stack([turns * 180, np.clip(length / longest, 0, 1) * 255, np.full_like(length, 255)], axis=-1)
    return _coloured(circle, measured)


def _coloured(hue_saturation_value: np.ndarray, measured: np.ndarray) -> np.ndarray:
    hsv = np.minimum(hue_saturation_value, (179, 255, 255)).astype(np.uint8)
    colours = np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB))
    colours[~measured] = NOT_MEASURED
    return colours
