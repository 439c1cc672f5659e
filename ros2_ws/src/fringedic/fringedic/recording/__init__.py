"""MCAP recordings: written crash-safe, read and repaired without ROS.

Messages are stored as serialised CDR bytes together with their definitions, so that a recording is readable on systems
without ROS.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
