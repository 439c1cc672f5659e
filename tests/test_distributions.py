"""The smoke test of the distribution that is not installed, without its set-up: what it copies, and how it ends."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
STATE = "from fringedic import warm_up as w; print(w._marked(w._cache_folder()) == w._fingerprint())"


@pytest.fixture
def distributions(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import distributions

    return distributions


@pytest.fixture
def checkout(distributions: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A checkout with the sources of the library and one compiled kernel, marked as current."""
    root = tmp_path / "checkout"
    (root / "setup").mkdir(parents=True)
    (root / "Makefile").write_text(".PHONY: setup\nsetup:\n\t@setup/setup.sh\n")
    (root / "setup" / "environment.sh").write_text("")
    library = root / "ros2_ws" / "src" / "fringedic" / "fringedic"
    package = distributions.ROOT / "ros2_ws" / "src" / "fringedic" / "fringedic"
    (library / "warm_up").mkdir(parents=True)
    (library / "__init__.py").touch()
    (library / "warm_up" / "__init__.py").write_text((package / "warm_up" / "__init__.py").read_text())
    (library / "kernels.py").write_text("from numba import njit\n")
    (library / "__pycache__").mkdir()
    (library / "__pycache__" / "kernels.twice-1.py311.nbi").write_text("machine code")
    _python(root, "from fringedic.warm_up import mark_compiled; mark_compiled()")
    subprocess.run(["git", "init", "--quiet"], cwd=root, check=True)
    subprocess.run(["git", "add", "Makefile", "setup", "*.py"], cwd=root, check=True)
    (root / ".venv" / "lib" / "python3.11" / "site-packages" / "rclpy").mkdir(parents=True)
    (root / ".venv" / "stamps").mkdir()
    (root / ".venv" / "stamps" / "distribution").write_text("jazzy")
    monkeypatch.setattr(distributions, "ROOT", root)
    return root


def _python(checkout: Path, statements: str) -> str:
    environment = os.environ | {"PYTHONPATH": str(checkout / "ros2_ws" / "src" / "fringedic")}
    environment.pop("NUMBA_CACHE_DIR", None)
    return subprocess.check_output([sys.executable, "-c", statements], env=environment, text=True)


def _set_up(checkout: Path, script: str) -> None:
    """Let set-up of the copy be these lines."""
    file = checkout / "setup" / "setup.sh"
    file.write_text(f"#!/usr/bin/env bash\n{script}\n")
    file.chmod(0o755)
    subprocess.run(["git", "add", "setup"], cwd=checkout, check=True)


@pytest.mark.usefixtures("checkout")
def test_kernels_of_the_copy_are_current(distributions: ModuleType, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    distributions.copy_sources(copy)
    assert _python(copy, STATE).strip() == "True", "they would be compiled again"
    assert [file.read_text() for file in copy.rglob("*.nbi")] == ["machine code"]


def test_an_index_that_cannot_be_reached_leaves_the_test_out(distributions: ModuleType, checkout: Path) -> None:
    _set_up(checkout, f"echo 'set-up: {distributions.UNREACHABLE}: connect this computer' >&2; exit 1")
    assert distributions.smoke().endswith(f"is left out: {distributions.UNREACHABLE}")


def test_beside_a_sourced_distribution_the_test_is_left_out(distributions: ModuleType, checkout: Path) -> None:
    next((checkout / ".venv").rglob("rclpy")).rmdir()
    assert distributions.smoke().startswith("is left out: ROS 2 jazzy is sourced")


def test_another_failure_is_told_with_the_end_of_the_log(distributions: ModuleType, checkout: Path) -> None:
    _set_up(checkout, "echo 'fatal error: rcl.h' >setup.log; echo 'set-up: workspace failed' >&2; exit 1")
    with pytest.raises(distributions.CommandError, match=r"workspace failed.* the end of its log: fatal error: rcl\.h"):
        distributions.smoke()


def test_the_sentence_about_the_index_is_that_of_set_up(distributions: ModuleType) -> None:
    assert f'stop "{distributions.UNREACHABLE}: ' in (distributions.ROOT / "setup" / "setup.sh").read_text()
