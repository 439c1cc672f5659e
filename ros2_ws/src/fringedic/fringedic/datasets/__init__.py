"""Datasets of recorded experiments, without ROS: their layout, writing and opening.

A dataset is a NetCDF file or a Zarr folder beside the recording, written step by step. Its dimensions are ``step``,
``row`` and ``column``; the coordinates ``row`` and ``column`` are pixel positions in the reference image. All maps
share the grid of the displacement: if its spacing is above one pixel, maps of the camera's pixels are sampled at those
points.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
