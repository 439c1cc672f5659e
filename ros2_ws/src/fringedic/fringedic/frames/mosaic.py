"""Colour mosaic (Bayer) of a sensor that was saved as grey levels: detection and removal."""

from __future__ import annotations

import cv2
import numpy as np

_TILE = 8  # cells of 2 x 2 pixels, along each side of a tile
# Standard deviations of the mean over the tiles: grey images exceed them with a probability of 1e-9.
_CLEAR = 6.1
# Part of the mean grey level: the channels of a colour sensor differ by 20 % and more; the harmonics of printed grids
# remain below; test_a_colour_mosaic_is_detected
_SMALLEST = 0.02
_FEWEST = 16  # tiles whose spread is known


def has_mosaic(image: np.ndarray) -> bool:
    """Return whether an image contains the pixels of a colour sensor as they are, each behind its own colour filter.

    The green pixels of each 2 x 2 pixels lie on one diagonal. If they differ from red and blue, the image contains the
    Nyquist frequency of both axes with the same sign everywhere. Its amplitude in tiles is compared with their spread:
    textures and noise contain it with any sign.

    Parameters
    ----------
    image
        Grey levels (row, column).

    Returns
    -------
    bool
        False for a grey image with a probability of error of 1e-9, for one of less than 64 x 64 pixels, and for a
        mosaic with white balance of a grey surface, which needs no correction.

    References
    ----------
    B. E. Bayer (1976), Color imaging array, US patent 3971065.

    Examples
    --------
    >>> grey = np.random.default_rng(1).normal(100, 20, (128, 128))
    >>> gains = np.tile([[0.6, 1.0], [1.0, 0.7]], (64, 64))
    >>> has_mosaic(grey), has_mosaic(gains * grey)
    (False, True)
    """
    rows, columns = (size // (2 * _TILE) for size in image.shape)
    if rows * columns < _FEWEST:
        return False
    used = image[: 2 * _TILE * rows, : 2 * _TILE * columns]
    pair = used[:, ::2].astype(np.float32) - used[:, 1::2]
    tiles = cv2.resize(pair[::2] - pair[1::2], (columns, rows), interpolation=cv2.INTER_AREA) / 4
    mean, level = float(tiles.mean()), float(used[::4, ::4].mean())
    return bool(abs(mean) > max(_SMALLEST * level, _CLEAR * float(tiles.std()) / np.sqrt(tiles.size)))


def smooth_mosaic(image: np.ndarray) -> np.ndarray:
    """Return the mean of the colours around each pixel of a mosaic, float32: the binomial filter 1-2-1 along both axes.

    Each mean contains a quarter of red and blue and half of green. The positions of the pixels stay.

    Parameters
    ----------
    image
        Grey levels (row, column) of a mosaic.

    Examples
    --------
    >>> smooth_mosaic(np.tile([[60.0, 100.0], [100.0, 70.0]], (2, 2)))[0]
    array([82.5, 82.5, 82.5, 82.5], dtype=float32)
    """
    weights = np.array([0.25, 0.5, 0.25], np.float32)
    grey = image.astype(np.float32)
    return np.asarray(cv2.sepFilter2D(grey, -1, weights, weights, borderType=cv2.BORDER_REFLECT_101))
