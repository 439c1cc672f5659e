"""Camera drivers without ROS: each turns one call into one frame."""

from camera_node.drivers.driver import Driver, Frame, Scene
from camera_node.drivers.files import FilesDriver
from camera_node.drivers.virtual import VirtualDriver

__all__ = ["Driver", "FilesDriver", "Frame", "Scene", "VirtualDriver"]
