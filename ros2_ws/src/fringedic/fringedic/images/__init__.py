"""Series of image files that are measured without a rig: displacement and strain, or the phase of fringe images."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
