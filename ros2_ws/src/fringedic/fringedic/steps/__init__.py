"""The processing steps that the nodes and the desk share: frames to phase, texture to displacement, both to 3D."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
