"""What `sensor_msgs/CameraInfo` can say of a calibrated camera: the pin-hole, and Brown's model nearest to its lens."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import CameraInfo

from fringedic.rig import RigModel


def camera_info(rig: RigModel) -> tuple[CameraInfo, float]:
    """Return a rig's camera for tools that know no other lens, and what that model leaves of the lens.

    ``k`` belongs to the image as it is, ``p`` to the undistorted one; the rectification is the identity.

    Parameters
    ----------
    rig
        Calibration of the rig.

    Returns
    -------
    message, residual
        The message without its header, and the root mean square over the image of what it cannot describe [px].
    """
    focal = rig.camera_distance / rig.pixel_size
    ideal = np.array(
        [
            [focal * rig.pixel_aspect, 0.0, rig.principal_column],
            [0.0, focal, rig.principal_row],
            [0.0, 0.0, 1.0],
        ]
    )
    matrix, coefficients, residual = ideal, (0.0,) * 5, 0.0
    if rig.camera_distortion is not None:
        coefficients, matrix, _, residual = rig.camera_distortion.brown(ideal)
    message = CameraInfo(
        width=rig.camera_width,
        height=rig.camera_height,
        distortion_model="plumb_bob",
        d=list(coefficients),
        k=matrix.ravel().tolist(),
        r=np.eye(3).ravel().tolist(),
        p=np.hstack([ideal, np.zeros((3, 1))]).ravel().tolist(),
    )
    return message, residual
