"""Camera drivers: each call returns one frame."""

from camera_node.drivers.driver import Driver, Frame, LocalDriver, PlacedPlane, Scene, ShownPattern, StreamingDriver

__all__ = ["Driver", "Frame", "LocalDriver", "PlacedPlane", "Scene", "ShownPattern", "StreamingDriver"]
