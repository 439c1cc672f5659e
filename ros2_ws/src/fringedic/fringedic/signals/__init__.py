"""Signals: quantities that sensors of the rig measure over time, such as force and crosshead position.

Messages become signals in one place; everything else reads signals, so that another sensor changes none of the readers.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
