"""ROS domains of their own for the tests of the running system, and one recorded experiment."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from running_system import CONFIG, Told, processes_of

from fringedic_bringup.processes import node_environment, private_domain, remove_stale_segments
from fringedic_bringup.report import RunReport
from fringedic_bringup.run import load_rig, run_experiment


@pytest.fixture(scope="module", autouse=True)
def domain() -> Iterator[str]:
    """Give each module a ROS domain of its own: no killed node of another is listed there, and nothing may be left."""
    remove_stale_segments()
    with private_domain() as number, pytest.MonkeyPatch.context() as patch:
        for name, value in {**node_environment(number), "ROS_PYTHON_CHECK_FIELDS": "1"}.items():
            patch.setenv(name, value)
        yield str(number)
        assert not processes_of(str(number))


@pytest.fixture(scope="session")
def tiny() -> Path:
    """Return the rig file of the tiny virtual rig."""
    return CONFIG / "tiny.yaml"


@pytest.fixture(scope="session")
def experiment(tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> RunReport:
    """Return a recorded experiment: three steps of the tiny virtual plate in tension, run by the real nodes."""
    folder = tmp_path_factory.mktemp("experiment")
    rig, programme = load_rig(tiny, None, None)
    with private_domain() as number:
        return run_experiment(rig, tiny, programme, folder / "run", Told(), domain=number)
