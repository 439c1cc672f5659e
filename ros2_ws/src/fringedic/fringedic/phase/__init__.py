"""From fringe frames to the absolute phase: demodulation (eq. 11), fringe orders, single images, lens blur."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
