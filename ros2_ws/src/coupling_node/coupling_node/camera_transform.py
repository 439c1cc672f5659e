"""Static transform from the reference plane to the camera, for viewers; needs tf2_msgs, which every stock ROS has."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from scipy.spatial.transform import Rotation

from fringedic.rig import RigModel
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
    """Pose of the optical frame (z forward, x right, y down) in the rig's frame (z towards the camera, y up).

    The camera sits at (0, 0, h0); its axes are the rig's, turned by the tilts about x and y, then by half a turn about
    x that makes z look at the plane.
    """
    turn = (
        Rotation.from_euler("x", rig.camera_tilt_x)
        * Rotation.from_euler("y", rig.camera_tilt_y)
        * Rotation.from_euler("x", 180, degrees=True)
    )
    message = TransformStamped(child_frame_id="camera_optical_frame")
    message.header.frame_id = "reference_plane"
    message.header.stamp = stamp
    message.transform.translation.z = float(rig.camera_distance)
    rotation = message.transform.rotation
    rotation.x, rotation.y, rotation.z, rotation.w = map(float, turn.as_quat())
    return message
