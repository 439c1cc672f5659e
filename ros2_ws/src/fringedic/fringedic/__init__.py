"""Shape and 3D displacement of a surface with one camera and one fringe projector.

The public names are listed in ``__init__.pyi`` and loaded on first use: most nodes need only a few of them.
"""

import os
import sys
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import lazy_loader

from fringedic.inputs.user_folder import replacement_of

if "NUMBA_CACHE_DIR" not in os.environ and not os.access(os.path.dirname(__file__), os.W_OK):
    # Numba keeps compiled functions beside the source or in the home folder, and fails where it can write neither
    _cache = replacement_of(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    if _cache is not None:
        os.environ["NUMBA_CACHE_DIR"] = _cache
os.environ.setdefault("NUMBA_THREADING_LAYER", "omp")
# Threads that wait by spinning take the processor from the other nodes: three times slower on a busy machine.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
# OpenCV refuses larger images by their header, before it takes memory for them: 268 million pixels
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**28))

try:
    __version__ = version(__name__)  # of package.xml
except PackageNotFoundError:
    __version__ = "not installed"

_public_name, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """Load a public name, and the methods ``dataset.fringedic`` as soon as xarray is there."""
    value = _public_name(name)
    _register_methods()
    return value


def _register_methods() -> None:
    if "xarray" in sys.modules:
        import_module("fringedic.accessor")


_register_methods()
