"""One declaration of each setting: sections of the rig file, parameters of the nodes, and tables of the pages."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
