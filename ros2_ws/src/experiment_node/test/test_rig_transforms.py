"""The transforms for viewers agree with the lines of sight and the phase of the rig model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from scipy.spatial.transform import Rotation

from experiment_node.rig_transforms import rig_transforms
from fringedic.rig.model import RigModel
from fringedic.sensors.poses import SensorPose
from fringedic.virtual_rig import VirtualRig
from fringedic_ros.rig_node import RigNode

PITCH = 40.0  # [projector px]


@pytest.fixture(scope="module")
def rig() -> RigModel:
    optics = VirtualRig.from_preset("plate", size="tiny").optics()
    return replace(RigModel(**optics), camera_tilt_x=0.02, camera_tilt_y=-0.03, projector_rotation=(0.01, 0.02, 0.03))


@pytest.fixture(scope="module")
def node() -> Iterator[RigNode]:
    rclpy.init()
    node = RigNode("viewer", namespace="left/rig")
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture(scope="module")
def transforms(node: RigNode, rig: RigModel) -> dict[str, TransformStamped]:
    return {each.child_frame_id: each for each in rig_transforms(node, rig, Time(sec=1))}


def rotation(message: TransformStamped) -> Rotation:
    turn = message.transform.rotation
    return Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])


def position(message: TransformStamped) -> np.ndarray:
    place = message.transform.translation
    return np.array([place.x, place.y, place.z])


def test_the_tree_is_complete_and_has_the_prefix_of_the_rig(transforms: dict[str, TransformStamped]) -> None:
    names = {"camera_optical_frame", "projector_optical_frame", "load_frame"}
    assert transforms.keys() == {f"left/rig/{name}" for name in names}
    assert {each.header.frame_id for each in transforms.values()} == {"left/rig/reference_plane"}


def test_a_sensor_has_a_pose_in_the_frame_of_another_one(node: RigNode, rig: RigModel) -> None:
    pose = SensorPose((0.1, -0.2, 0.3), (0.02, 0.0, -0.01))
    *own, placed = rig_transforms(node, rig, Time(), ("right/rig/reference_plane", pose))
    assert len(own) == 3
    assert (placed.header.frame_id, placed.child_frame_id) == ("right/rig/reference_plane", "left/rig/reference_plane")
    point = np.array([0.01, 0.02, 0.03])
    found = rotation(placed).apply(point) + position(placed)
    np.testing.assert_allclose(found, pose.apply(point[:, None]).ravel(), atol=1e-15)


def test_without_calibration_the_load_frame_is_there(node: RigNode) -> None:
    (only,) = rig_transforms(node, None, Time())
    assert only.child_frame_id == "left/rig/load_frame"
    np.testing.assert_allclose(rotation(only).apply([[0, 0, 1], [1, 0, 0]]), [[0, 1, 0], [1, 0, 0]], atol=1e-12)


def test_lines_of_sight_in_the_optical_frame(rig: RigModel, transforms: dict[str, TransformStamped]) -> None:
    message = transforms["left/rig/camera_optical_frame"]
    np.testing.assert_allclose(position(message), [0, 0, rig.camera_distance])
    right, down = 30, 20  # of the principal point [px]
    optical = [
        rig.pixel_size / rig.pixel_aspect * right / rig.camera_distance,
        rig.pixel_size * down / rig.camera_distance,
        1.0,
    ]
    seen = rig.ray_matrix @ [rig.principal_column + right, rig.principal_row + down, 1.0]
    np.testing.assert_allclose(rotation(message).apply(optical), seen, atol=1e-12)


def test_fringes_in_the_optical_frame_of_the_projector(rig: RigModel, transforms: dict[str, TransformStamped]) -> None:
    message = transforms["left/rig/projector_optical_frame"]
    np.testing.assert_allclose(position(message), rig.projector_position)
    right, down = 0.05, -0.03  # at distance 1
    point = position(message) + 0.4 * rotation(message).apply([right, down, 1.0])
    expected = rig.phase_towards(np.array([right, -down, -1.0]), PITCH)
    assert rig.phase(*point, PITCH) == pytest.approx(float(expected), abs=1e-9)
