"""A ROS domain of its own for every test module that starts nodes: modules and whole test runs go side by side."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as in the nodes, and before NumPy is loaded
LIBRARY = Path(__file__).parent / "fringedic"  # imports no ROS


@pytest.fixture(scope="module", autouse=True)
def domain(request: pytest.FixtureRequest) -> Iterator[int | None]:
    """Set aside a ROS domain, which contexts and processes of this module's tests take from the environment."""
    if request.path.is_relative_to(LIBRARY):
        yield None
        return
    from fringedic_bringup.processes import private_domain

    with private_domain() as number, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(number))
        yield number
