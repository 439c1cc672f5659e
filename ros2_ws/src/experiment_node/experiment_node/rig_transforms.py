"""Static transforms of the frames of a rig, for viewers; they need tf2_msgs, which every stock ROS has."""

from __future__ import annotations

from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node

from fringedic.rig.model import RigModel
from fringedic.rig.pose import LOAD_FRAME_QUATERNION, Quaternion, camera_quaternion, projector_quaternion
from fringedic_ros.qos import LATCHED
from fringedic_ros.rig_node import CAMERA_FRAME, LOAD_FRAME, PROJECTOR_FRAME, RIG_FRAME, frame_id

if TYPE_CHECKING:  # a rig of one sensor does not load it
    from fringedic.sensors.poses import SensorPose

try:
    from tf2_msgs.msg import TFMessage
except ImportError:
    TFMessage = None

Pose = tuple[tuple[float, float, float], Quaternion]


class RigTransforms:
    """Publishes the frames of a rig on `/tf_static` where tf2_msgs is installed.

    Parameters
    ----------
    node
        A node of the rig.
    common
        Frame in which the frame of the rig has a pose, and this pose; None without one.
    """

    def __init__(self, node: Node, common: tuple[str, SensorPose] | None = None) -> None:
        self._node = node
        self._common = common
        self._publisher = node.create_publisher(TFMessage, "/tf_static", LATCHED) if TFMessage else None

    def publish(self, rig: RigModel | None, stamp: Time) -> None:
        """Publish the transforms of a calibration; without one, that of the load frame alone."""
        if self._publisher is not None:
            self._publisher.publish(TFMessage(transforms=rig_transforms(self._node, rig, stamp, self._common)))


def rig_transforms(
    node: Node, rig: RigModel | None, stamp: Time, common: tuple[str, SensorPose] | None = None
) -> list[TransformStamped]:
    """Return the poses of load frame, camera and projector in the frame of the rig.

    The optical frames have z forward, x to the right and y down. The load frame has z in the direction of loading,
    which is taken to be upwards in the image (y of the rig); only its direction is meaningful, not its origin.

    Parameters
    ----------
    node
        A node of the rig, for the prefix of the frames.
    rig
        Calibration; without one, camera and projector have no pose.
    stamp
        Of the messages.
    common
        A further frame, and the pose of the frame of the rig in it, which is returned as well.
    """
    poses: dict[str, Pose] = {LOAD_FRAME: ((0.0, 0.0, 0.0), LOAD_FRAME_QUATERNION)}
    if rig is not None:
        poses[CAMERA_FRAME] = (0.0, 0.0, rig.camera_distance), camera_quaternion(rig)
        poses[PROJECTOR_FRAME] = rig.projector_position, projector_quaternion(rig)
    own = frame_id(node, RIG_FRAME)
    transforms = [_transform(own, frame_id(node, name), pose, stamp) for name, pose in poses.items()]
    if common is not None:
        frame, placed = common
        transforms.append(_transform(frame, own, (placed.translation, placed.quaternion), stamp))
    return transforms


def _transform(parent: str, child: str, pose: Pose, stamp: Time) -> TransformStamped:
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, stamp
    position, turn = message.transform.translation, message.transform.rotation
    (position.x, position.y, position.z), (turn.x, turn.y, turn.z, turn.w) = pose
    return message
