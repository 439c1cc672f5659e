"""Camera of a rig as a pin-hole with Brown's distortion, for programs that know no other lens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fringedic.rig.model import RigModel


@dataclass(frozen=True)
class PinholeCamera:
    """Camera matrix and distortion coefficients.

    Attributes
    ----------
    matrix : (3, 3)
        From normalised coordinates to pixels of the distorted image.
    ideal_matrix : (3, 3)
        From normalised coordinates to pixels of the undistorted image.
    coefficients
        Distortion (k1, k2, p1, p2, k3).
    residual
        Root mean square over the image of the distortion that the coefficients do not describe [px].

    References
    ----------
    D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37 (1971) 855-866.
    """

    matrix: np.ndarray
    ideal_matrix: np.ndarray
    coefficients: tuple[float, ...]
    residual: float


def pinhole_camera(rig: RigModel) -> PinholeCamera:
    """Return the camera of a rig with the nearest model of Brown for its lens.

    Parameters
    ----------
    rig
        Calibration of the rig.

    Examples
    --------
    >>> from fringedic.virtual_rig import VirtualRig
    >>> camera = pinhole_camera(RigModel(**VirtualRig.from_preset("plate", size="tiny").optics()))
    >>> camera.ideal_matrix.shape, len(camera.coefficients)
    ((3, 3), 5)
    """
    focal = rig.camera_distance / rig.pixel_size
    ideal = np.array(
        [
            [focal * rig.pixel_aspect, 0.0, rig.principal_column],
            [0.0, focal, rig.principal_row],
            [0.0, 0.0, 1.0],
        ]
    )
    if rig.camera_distortion is None:
        return PinholeCamera(ideal, ideal, (0.0,) * 5, 0.0)
    coefficients, matrix, _, residual = rig.camera_distortion.brown(ideal)
    return PinholeCamera(matrix, ideal, tuple(coefficients), residual)
