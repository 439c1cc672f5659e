"""ROS domains of their own for the tests of the running system, and one recorded experiment for all of them."""

from __future__ import annotations

import gc
import shutil
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect, sync_playwright
from running_system import CONFIG, RecordedExperiment, processes_of, record_experiment, shared_result

from fringedic.command.outcome import RunReport
from fringedic_bringup.launch.environment import node_environment, private_domain
from fringedic_ros import middleware

SHOWN_MS = 30_000  # until the page shows what a test waits for, on a busy computer


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--pictures", type=Path, help="Folder for pictures of the operator's page; docs/pictures renews them."
    )


@pytest.fixture(scope="module", autouse=True)
def domain() -> Iterator[str]:
    """Give each module a ROS domain of its own, without nodes of other modules, and check that nothing is left."""
    middleware.remove_leftovers()
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
def recorded(tiny: Path, tmp_path_factory: pytest.TempPathFactory) -> RecordedExperiment:
    """Return `fringedic run tiny`: three steps of a plate in tension; one run for all workers of pytest-xdist."""
    return shared_result(tmp_path_factory, "experiment", lambda folder: record_experiment(tiny, folder / "tiny"))


@pytest.fixture(scope="session")
def experiment(recorded: RecordedExperiment) -> RunReport:
    """Return the report of the recorded experiment."""
    return recorded.report


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Return chromium; a test that needs it is skipped where it is not installed."""
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("chromium is not installed: sudo apt-get install chromium")
    arguments = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=chromium, args=arguments)
        expect.set_options(timeout=SHOWN_MS)
        yield running
        running.close()


@pytest.fixture(scope="module")
def collected_from_module() -> Iterator[None]:
    """Collect the connections that the fixtures of a module have cut: this one ends last."""
    yield
    _collect()


@pytest.fixture
def collected() -> Iterator[None]:
    """Collect the connections that a test has cut: they would be reported in a later one."""
    yield
    _collect()


def _collect() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()
