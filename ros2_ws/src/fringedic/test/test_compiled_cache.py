"""An installation that cannot be written, of a user without a home folder, keeps its compiled functions elsewhere."""

import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

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
