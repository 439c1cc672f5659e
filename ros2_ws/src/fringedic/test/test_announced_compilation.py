"""The first call of a function that is not compiled yet says why it takes long."""

from __future__ import annotations

import sys

import numba
import pytest

import fringedic


def test_the_first_compilation_of_the_library_is_announced_once(caplog: pytest.LogCaptureFixture) -> None:
    assert fringedic.measure_displacement is not None
    announcement = sys.modules["fringedic.warm_up.announcement"]
    announcement.ANNOUNCEMENT.__init__()

    def compiled(module: str) -> None:
        def kernel(value: int) -> int:
            return value + 1

        kernel.__module__ = module
        assert numba.njit(kernel)(1) == 2

    compiled("of_the_user")
    assert caplog.messages == []
    compiled("fringedic.correlation")
    compiled("fringedic.correlation")
    assert caplog.messages == [announcement.SENTENCE]
