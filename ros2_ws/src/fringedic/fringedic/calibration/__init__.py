"""Calibration of the rig by a plane at known angles or heights (3.2), and the check that it still holds."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
