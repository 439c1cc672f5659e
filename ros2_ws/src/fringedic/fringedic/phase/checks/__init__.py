"""Checks that the frames of a stack show their patterns and that neither light nor surface changed."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
