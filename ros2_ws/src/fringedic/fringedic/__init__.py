"""Shape and 3D displacement of a surface with one camera and one fringe projector.

The public names are listed in ``__init__.pyi`` and loaded on first use: most nodes need only a few of them.
"""

import os
import sys
import tempfile
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import lazy_loader


def replacement_of(folder: str) -> str | None:
    """Return a temporary folder for files that usually are in a folder of the user.

    Parameters
    ----------
    folder
        The usual folder; it is made if it does not exist.

    Returns
    -------
    str or None
        None when the usual folder can be written. Otherwise the same temporary folder for all processes of this user,
        which others cannot write: files such as compiled functions are executed.

    Raises
    ------
    ImportError
        No temporary folder can be written either; it is asked for while packages are imported.
    """
    try:
        os.makedirs(folder, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        user = os.getuid() if hasattr(os, "getuid") else 0
        try:
            temporary = os.path.join(tempfile.gettempdir(), f"fringedic-{user}")
        except FileNotFoundError:
            raise ImportError(
                f"neither {folder} nor a temporary folder can be written; set TMPDIR to one that can"
            ) from None
        os.makedirs(temporary, mode=0o700, exist_ok=True)
        return temporary if os.stat(temporary).st_uid == user else tempfile.mkdtemp(prefix="fringedic-")
    return None


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
    """Load a public name, the methods ``dataset.fringedic`` with xarray, and the announcement of a compilation."""
    value = _public_name(name)
    _register()
    return value


def _register() -> None:
    if "xarray" in sys.modules:
        import_module("fringedic.accessor")
    if "numba" in sys.modules:
        import_module("fringedic.warm_up.announcement")


_register()
