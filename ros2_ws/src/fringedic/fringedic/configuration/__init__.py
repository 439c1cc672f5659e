"""What a person writes: rig file and programme; and the forecast of a programme's time and disk space."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
