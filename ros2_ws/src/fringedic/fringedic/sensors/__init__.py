"""Several sensors in one frame: their registration by common objects, and one surface of all of them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
