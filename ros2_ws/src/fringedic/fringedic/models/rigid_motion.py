"""Rigid motion of the specimen between two steps, which is in the measured displacement and not in the model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from fringedic.models.shift import rigid_motions

RIGID_MOTION = {
    **{f"rigid_translation_{axis}": ("m", f"translation along {axis} of the specimen as a whole") for axis in "xyz"},
    **{f"rigid_rotation_{axis}": ("rad", f"rotation about {axis} of the specimen as a whole") for axis in "xyz"},
}
_ITERATIONS = 4
_MOST_POINTS = 100_000  # of each map; neighbours share their noise


@dataclass(frozen=True)
class RigidMotion:
    """Motion of the specimen as a whole, beside the displacement of a model.

    Attributes
    ----------
    rotation : (3,)
        Rotation vector about the centre [rad].
    translation : (3,)
        Of the centre [m].
    centre : (3,)
        Middle of the surface [m].
    seen : (6,)
        Whether the compared maps show the translations and rotations along and about x, y and z.
    """

    rotation: np.ndarray
    translation: np.ndarray
    centre: np.ndarray
    seen: np.ndarray

    @property
    def parts(self) -> list[float]:
        """Values of `RIGID_MOTION`; NaN for a motion that no compared map shows."""
        values = (*self.translation, *self.rotation)
        return [float(value) if seen else math.nan for value, seen in zip(values, self.seen, strict=True)]

    def removed(self, positions: np.ndarray, displacement: np.ndarray) -> np.ndarray:
        """Return a displacement without the motion (3, row, column) [m]; the rotation may be large."""
        turn = Rotation.from_rotvec(self.rotation).as_matrix()
        offset = positions - self.centre[:, None, None]
        moved = offset + displacement - self.translation[:, None, None]
        return np.asarray(np.einsum("ji,jrc->irc", turn, moved) - offset)


def fit_rigid_motion(
    positions: np.ndarray, axes: Sequence[int], displacement: np.ndarray, modelled: np.ndarray, sigma: np.ndarray
) -> RigidMotion:
    """Fit the rigid motion, beside a multiple of the model's maps, by least squares (Gauss-Newton).

    Parameters
    ----------
    positions, displacement : (3, row, column)
        Of the surface [m].
    axes
        Axis of each compared map: 0, 1, 2 for u, v, w.
    modelled, sigma : (map, row, column)
        Displacement of the model, and standard uncertainty of the measured one [m]. NaN where not known.

    Examples
    --------
    >>> y, x = np.mgrid[0.05:-0.05:60j, -0.05:0.05:60j]
    >>> positions, strain = np.stack([x, y, 0 * x]), np.stack([1e-3 * x, -3e-4 * y, 0 * x])
    >>> turn = Rotation.from_rotvec([0, 0, 0.02]).as_matrix()
    >>> moved = np.einsum("ij,jrc->irc", turn, positions + strain) - positions + 1e-4
    >>> found = fit_rigid_motion(positions, [0, 1, 2], moved, strain, np.full(strain.shape, 1e-7))
    >>> [round(part, 6) + 0.0 for part in found.parts]
    [0.0001, 0.0001, 0.0001, 0.0, 0.0, 0.02]
    >>> bool(np.abs(found.removed(positions, moved) - strain).max() < 1e-9)
    True
    """
    step = max(1, math.ceil(math.sqrt(positions[0].size / _MOST_POINTS)))
    positions, displacement, modelled, sigma = (
        each[:, ::step, ::step].astype(float) for each in (positions, displacement, modelled, sigma)
    )
    unseen = [axis for axis in range(3) if axis not in axes]
    displacement[unseen] = 0.0
    basis = np.stack([modelled, *rigid_motions(positions, axes)])
    known = np.isfinite(displacement[list(axes)]) & np.isfinite(basis).all(axis=0) & (sigma > 0)
    weighted = basis[:, known] / sigma[known]
    lengths = np.linalg.norm(weighted, axis=1)
    present = lengths > 0
    motion = RigidMotion(np.zeros(3), np.zeros(3), np.nanmean(positions, axis=(1, 2)), present[1:])
    for _ in range(_ITERATIONS if known.any() else 0):
        rest = motion.removed(positions, displacement)[list(axes)][known] / sigma[known]
        found = np.zeros(len(basis))
        found[present] = np.linalg.lstsq((weighted[present] / lengths[present, None]).T, rest, rcond=None)[0]
        found[present] /= lengths[present]
        turn = Rotation.from_rotvec(motion.rotation)
        motion = RigidMotion(
            (turn * Rotation.from_rotvec(found[4:])).as_rotvec(),
            motion.translation + turn.apply(found[1:4]),
            motion.centre,
            motion.seen,
        )
    return motion
