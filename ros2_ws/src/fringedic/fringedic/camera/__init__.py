"""The camera's lens: what it does to the image, measured by the grid method and corrected in coordinates (2.4)."""

from fringedic.camera.distortion import BrownModel, DistortionMap

__all__ = ["BrownModel", "DistortionMap"]
