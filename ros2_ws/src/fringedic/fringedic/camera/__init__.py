"""The camera's lens: its distortion, measured by the grid method (2.4) and corrected in coordinates."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
