"""Connections that these tests cut are collected here, not in a later test."""

from __future__ import annotations

import gc
import warnings
from collections.abc import Iterator

import pytest


@pytest.fixture(scope="module", autouse=True)
def collected_from_module() -> Iterator[None]:
    """Collect what the fixtures of a module have left: this one ends last."""
    yield
    _collect()


@pytest.fixture(autouse=True)
def collected() -> Iterator[None]:
    """Collect what a test has left."""
    yield
    _collect()


def _collect() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # of connections that were cut
        gc.collect()
