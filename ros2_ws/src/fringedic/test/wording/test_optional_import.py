"""A package that only some tasks need and that is not installed."""

import importlib

import pytest

from fringedic.errors import FringedicError
from fringedic.wording.optional_packages import optional_import


def test_a_package_that_is_missing_is_named_with_its_extra() -> None:
    with (
        pytest.raises(FringedicError, match=r"a Zarr dataset needs nobody_has_it: pip install 'fringedic\[zarr\]'"),
        optional_import("zarr"),
    ):
        importlib.import_module("nobody_has_it.at_all")
