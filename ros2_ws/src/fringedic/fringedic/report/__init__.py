"""The pages: reports of experiments, calibrations, checks, plans and comparisons; all from one template environment."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
