"""What people read and write: numbers and causes in sentences, arguments, YAML text, packages that are not installed.

A sentence about a result stands in the room of that result, in a module with the name ``sentences``.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
