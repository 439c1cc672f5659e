"""Camera drivers: each call returns one frame."""

from camera_node.drivers.aravis import AravisDriver
from camera_node.drivers.aravis_settings import AravisSettings, Trigger
from camera_node.drivers.driver import Driver, Frame, PlacedPlane, Scene, ShownPattern, StreamingDriver
from camera_node.drivers.files import FilesDriver
from camera_node.drivers.stamp_of import StampOf
from camera_node.drivers.topic import TopicDriver, TopicSettings
from camera_node.drivers.v4l2 import V4l2Driver, V4l2Settings
from camera_node.drivers.video import VideoDriver
from camera_node.drivers.virtual import VirtualDriver

__all__ = [
    "AravisDriver",
    "AravisSettings",
    "Driver",
    "FilesDriver",
    "Frame",
    "PlacedPlane",
    "Scene",
    "ShownPattern",
    "StampOf",
    "StreamingDriver",
    "TopicDriver",
    "TopicSettings",
    "Trigger",
    "V4l2Driver",
    "V4l2Settings",
    "VideoDriver",
    "VirtualDriver",
]
