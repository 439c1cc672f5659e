"""Datasets as files of other programs: VTK for ParaView, PLY, CSV, MATLAB, TIFF, NetCDF, Zarr, PNG, R3XA metadata.

Files for people (VTK, PLY, CSV, TIFF, PNG) have positions in mm, displacements in µm and strain in µstrain, with the
unit in every name; files for programs (NetCDF, Zarr, MATLAB) keep the SI units of the dataset and name them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
