"""Virtual rig (digital twin): renders the images of a rig together with the exact shape and displacement.

It imports nothing from the other rooms (own matrices, own ray tracing): an error in them cannot be repeated here.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
