"""Shape and 3D displacement of a surface with one camera and one fringe projector.

The public names are listed in ``__init__.pyi`` and loaded on first use: most nodes need only a few of them.
"""

import os
from importlib.metadata import PackageNotFoundError, version

import lazy_loader

os.environ.setdefault("NUMBA_THREADING_LAYER", "omp")
# Threads that wait by spinning take the processor from the other nodes: three times slower on a busy machine.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

try:
    __version__ = version(__name__)  # of package.xml
except PackageNotFoundError:
    __version__ = "not installed"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
