"""Shape and 3D displacement of a surface with one camera and one fringe projector.

The public names are listed in ``__init__.pyi`` and loaded on first use: most nodes need only a few of them.
"""

import os
import tempfile
from importlib.metadata import PackageNotFoundError, version

import lazy_loader


def _choose_cache() -> None:
    """Give compiled functions a folder where neither the installation nor the user's own folder can be written.

    Numba keeps them beside the source or in the home folder, and refuses to compile where it can write neither.
    """
    if "NUMBA_CACHE_DIR" in os.environ or os.access(os.path.dirname(__file__), os.W_OK):
        return
    home_cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    try:
        os.makedirs(home_cache, exist_ok=True)
        tempfile.TemporaryFile(dir=home_cache).close()
    except OSError:
        # of this user alone: who can write the cache decides which functions run
        user = os.getuid() if hasattr(os, "getuid") else 0
        folder = os.path.join(tempfile.gettempdir(), f"fringedic-{user}")
        os.makedirs(folder, mode=0o700, exist_ok=True)
        if os.stat(folder).st_uid != user:
            folder = tempfile.mkdtemp(prefix="fringedic-")
        os.environ["NUMBA_CACHE_DIR"] = folder


_choose_cache()
os.environ.setdefault("NUMBA_THREADING_LAYER", "omp")
# Threads that wait by spinning take the processor from the other nodes: three times slower on a busy machine.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
# OpenCV refuses larger images by their header, before it takes memory for them: 268 million pixels
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**28))

try:
    __version__ = version(__name__)  # of package.xml
except PackageNotFoundError:
    __version__ = "not installed"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
