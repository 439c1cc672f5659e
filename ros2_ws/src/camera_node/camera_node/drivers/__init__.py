"""Camera drivers without ROS: each turns one call into one frame."""

from camera_node.drivers.aravis import AravisDriver, AravisSettings, Trigger
from camera_node.drivers.driver import Driver, Frame, PlacedPlane, Scene, ShownPattern, StreamingDriver
from camera_node.drivers.files import FilesDriver
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
    "StreamingDriver",
    "Trigger",
    "VirtualDriver",
]
