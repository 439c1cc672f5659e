"""Pin-hole model of camera and projector, reconstruction of the surface, its uncertainty."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
