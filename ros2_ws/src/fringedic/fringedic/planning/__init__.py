"""What a rig that does not exist yet will measure: uncertainties, resolution, and warnings before it is bought."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
