"""Contribution of the calibration's uncertainty to that of a displacement: (J' - J) Sigma_p (J' - J)^T."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates

from fringedic.patterns.pattern import Orientation
from fringedic.rig.model import RigModel
from fringedic.rig.uncertainty import position_errors

_NODES = 48  # along the longer side of the cloud: the errors of a calibration are smooth


def calibration_covariance(
    calibration: RigModel,
    before: tuple[np.ndarray, np.ndarray, np.ndarray],
    after: tuple[np.ndarray, np.ndarray, np.ndarray],
    orientation: Orientation,
) -> np.ndarray:
    """Return variances of u, v, w and covariances uv, uw, vw [m^2] that the calibration's own error causes.

    Parameters
    ----------
    calibration
        With the covariance of its parameters.
    before, after
        (column [px], row [px], z [m]) of material points in the reference and in the deformed image, (row, column).
    orientation
        Direction of the fringes.

    Returns
    -------
    ndarray
        Shape (6, row, column), float64, interpolated between points on a coarse grid.
    """
    shape = before[0].shape
    step = max(1, max(shape) // _NODES)
    coarse = [np.stack([np.asarray(each[::step, ::step], float) for each in place]) for place in (before, after)]
    known = np.asarray(np.isfinite(coarse).all(axis=(0, 1)))
    if not known.any():
        return np.zeros((6, *shape))
    errors = [
        position_errors(calibration, place[0, known], place[1, known], place[2, known], orientation) for place in coarse
    ]
    difference = errors[1] - errors[0]
    nodes = np.empty((6, *known.shape))
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    for node, (a, b) in zip(nodes, ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)), strict=True):
        values = np.zeros(known.shape)
        values[known] = np.sum(difference[:, a] * difference[:, b], axis=0)
        node[:] = values[nearest[0], nearest[1]]
    where = np.meshgrid(*(np.arange(length) / step for length in shape), indexing="ij")
    return np.stack([map_coordinates(node, where, order=1, mode="nearest") for node in nodes])
