"""The transform for viewers agrees with the rig model's own lines of sight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from builtin_interfaces.msg import Time
from scipy.spatial.transform import Rotation

from coupling_node.camera_transform import camera_transform
from fringedic.rig.model import RigModel
from fringedic.virtual_rig import VirtualRig


def test_lines_of_sight_in_the_optical_frame() -> None:
    optics = VirtualRig.from_preset("plate", size="tiny").optics()
    rig = replace(RigModel(**optics), camera_tilt_x=0.02, camera_tilt_y=-0.03)
    message = camera_transform(rig, Time(sec=1))
    assert (message.header.frame_id, message.child_frame_id) == ("reference_plane", "camera_optical_frame")
    assert message.transform.translation.z == rig.camera_distance
    turn = message.transform.rotation
    rotation = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])
    right, down = 30, 20  # of the principal point [px]
    optical = [
        rig.pixel_size / rig.pixel_aspect * right / rig.camera_distance,
        rig.pixel_size * down / rig.camera_distance,
        1.0,
    ]
    seen = rig.ray_matrix @ [rig.principal_column + right, rig.principal_row + down, 1.0]
    np.testing.assert_allclose(rotation.apply(optical), seen, atol=1e-12)
