"""`sensor_msgs/CameraInfo` of a calibrated camera."""

from __future__ import annotations

import numpy as np
from sensor_msgs.msg import CameraInfo

from fringedic.rig.model import RigModel
from fringedic.rig.pinhole import pinhole_camera


def camera_info(rig: RigModel) -> tuple[CameraInfo, float]:
    """Return the camera of a rig as a pin-hole with Brown's distortion, and the residual of that model.

    ``k`` belongs to the distorted image, ``p`` to the undistorted one; the rectification is the identity.

    Parameters
    ----------
    rig
        Calibration of the rig.

    Returns
    -------
    message, residual
        The message without its header, and the root mean square of the lens that it does not describe [px].
    """
    camera = pinhole_camera(rig)
    message = CameraInfo(
        width=rig.camera_width,
        height=rig.camera_height,
        distortion_model="plumb_bob",
        d=list(camera.coefficients),
        k=camera.matrix.ravel().tolist(),
        r=np.eye(3).ravel().tolist(),
        p=np.hstack([camera.ideal_matrix, np.zeros((3, 1))]).ravel().tolist(),
    )
    return message, camera.residual
