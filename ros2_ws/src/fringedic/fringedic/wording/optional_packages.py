"""Packages that only some tasks need, and the sentence about one that is not installed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from fringedic.errors import FringedicError

_EXTRAS = {
    "figures": "drawing",
    "report": "a report",
    "operator": "the operator's page",
    "foxglove": "a server for Foxglove",
    "paraview": "a file for ParaView",
    "models": "reading a model",
    "zarr": "a Zarr dataset",
    "campaign": "a campaign",
    "timestamp": "a time stamp",
}


@contextmanager
def optional_import(extra: str) -> Iterator[None]:
    """Say how to install a package that only some tasks need, when its import fails.

    Parameters
    ----------
    extra
        The extra of this library that installs the package: ``figures``, ``report``, ``operator``, ``foxglove``,
        ``paraview``, ``models``, ``zarr``, ``campaign`` or ``timestamp``.

    Raises
    ------
    FringedicError
        The package is not installed.

    Examples
    --------
    >>> with optional_import("figures"):
    ...     import a_package_that_nobody_has
    Traceback (most recent call last):
    fringedic.errors.FringedicError: drawing needs a_package_that_nobody_has: pip install 'fringedic[figures]'
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = str(error.name).partition(".")[0]
        raise FringedicError(f"{_EXTRAS[extra]} needs {package}: pip install 'fringedic[{extra}]'") from error
