"""An installation that cannot be written, of a user without a home folder, keeps its compiled functions elsewhere."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from fringedic import warm_up

# A package folder that cannot be written, for every user of the computer, also the one who may write everything.
PROGRAM = """
import os
os.access = lambda *_, **__: False
import fringedic
print(os.environ.get("NUMBA_CACHE_DIR", ""))
"""


NOWHERE = "import tempfile; tempfile._candidate_tempdir_list = lambda: ['/proc/nowhere']\n"  # also not where it runs


def imported(program: str, **environment: str) -> subprocess.CompletedProcess[str]:
    kept = {name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    command = [sys.executable, "-c", program]
    return subprocess.run(command, env={**kept, **environment}, capture_output=True, text=True, check=False)


def cache_folder(**environment: str) -> str:
    done = imported(PROGRAM, **environment)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_computer_without_any_folder_to_write_is_told():
    error = imported(NOWHERE + PROGRAM, HOME="/proc/nowhere").stderr.splitlines()[-1]
    assert error == (
        "ImportError: neither /proc/nowhere/.cache nor a temporary folder can be written; set TMPDIR to one that can"
    )


def test_without_any_other_folder_the_cache_is_a_temporary_one_of_this_user(tmp_path):
    folder = Path(cache_folder(HOME="/proc/nowhere", TMPDIR=str(tmp_path)))
    assert folder.parent == tmp_path
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert cache_folder(HOME="/proc/nowhere", TMPDIR=str(tmp_path)) == str(folder), "the next process finds it again"


@pytest.mark.parametrize("variable", ["HOME", "XDG_CACHE_HOME"])
def test_folders_that_can_be_written_are_used_as_usual(variable, tmp_path):
    environment = {"HOME": "/proc/nowhere", variable: str(tmp_path / "home")}
    assert cache_folder(**environment) == ""


def test_a_chosen_folder_stays(tmp_path):
    assert cache_folder(HOME="/proc/nowhere", NUMBA_CACHE_DIR=str(tmp_path)) == str(tmp_path)


COMPILE = "from fringedic.warm_up import require_kernels; require_kernels(print)"


def test_kernels_are_compiled_once_and_again_for_a_changed_file(tmp_path):
    """The kernels of a package with one of them; the real ones take a minute."""
    package = tmp_path / "fringedic"
    (package / "warm_up").mkdir(parents=True)
    source = Path(warm_up.__file__).parent
    (package / "__init__.py").touch()
    for name in ("__init__.py", "__main__.py"):
        (package / "warm_up" / name).write_text((source / name).read_text())
    (package / "warm_up" / "pipeline.py").write_text("from fringedic.kernels import twice\ndef warm_up(): twice(1.0)\n")
    kernels = package / "kernels.py"
    kernels.write_text("from numba import njit\n@njit(cache=True)\ndef twice(x):\n    return 2 * x\n")

    def said() -> str:
        done = imported(COMPILE, PYTHONPATH=str(tmp_path))
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert "are being compiled" in said()
    assert list(package.rglob("*.nbi"))
    assert said() == ""
    os.utime(kernels, (1, 1))
    assert "are being compiled" in said()
    kernels.write_text("from numba import njit\nraise SystemExit('no compiler')\n")
    assert "could not be compiled (no compiler)" in said()
