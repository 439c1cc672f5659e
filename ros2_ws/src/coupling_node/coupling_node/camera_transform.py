"""Static transform from the reference plane to the camera, for viewers; needs tf2_msgs, which every stock ROS has."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node

from fringedic.rig.model import RigModel
from fringedic.rig.pose import camera_quaternion
from fringedic_ros.qos import LATCHED

try:
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None


class CameraTransform:
    """Publishes `reference_plane` -> `camera_optical_frame` on `/tf_static` where tf2_msgs is installed."""

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(TFMessage, "/tf_static", LATCHED) if TFMessage else None

    def publish(self, rig: RigModel, stamp: Time) -> None:
        """Publish the transform of a calibration."""
        if self._publisher is not None:
            self._publisher.publish(TFMessage(transforms=[camera_transform(rig, stamp)]))


def camera_transform(rig: RigModel, stamp: Time) -> TransformStamped:
    """Return the pose of the optical frame (z forward, x right, y down) in the rig frame (z to the camera, y up).

    The camera's pin-hole is at (0, 0, h0).
    """
    message = TransformStamped(child_frame_id="camera_optical_frame")
    message.header.frame_id = "reference_plane"
    message.header.stamp = stamp
    message.transform.translation.z = float(rig.camera_distance)
    rotation = message.transform.rotation
    rotation.x, rotation.y, rotation.z, rotation.w = camera_quaternion(rig)
    return message
