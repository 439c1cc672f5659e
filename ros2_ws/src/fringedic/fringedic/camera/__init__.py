"""The camera's lens: what it does to the image, measured by the grid method and corrected in coordinates (2.4).

`measure_distortion` lives in `fringedic.camera.grid`, the printed grid in `fringedic.camera.target`: nodes that only
correct a distortion need not load them.
"""

from fringedic.camera.distortion import BrownModel, DistortionMap

__all__ = ["BrownModel", "DistortionMap"]
