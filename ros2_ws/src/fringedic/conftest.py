"""The recording that examples in docstrings read, in the folder where they run."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

RECORDED = Path(__file__).parent / "test" / "recordings" / "version_0_1" / "bag"
NAME = "recordings/plate-7/bag"


@pytest.fixture(scope="session")
def _dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Measure the recording once for all examples."""
    from fringedic import process_bag

    return process_bag(RECORDED, output=tmp_path_factory.mktemp("examples") / "bag.nc")


@pytest.fixture(autouse=True)
def _beside_the_recording(request: pytest.FixtureRequest) -> None:
    """Run an example that names the recording beside a copy of it, and of its dataset if the example opens it."""
    if not isinstance(request.node, pytest.DoctestItem):
        return
    example = "".join(each.source for each in request.node.dtest.examples)
    if NAME not in example:
        return
    folder = request.getfixturevalue("tmp_path")
    shutil.copytree(RECORDED, folder / NAME)
    if "open_experiment" in example:
        shutil.copy(request.getfixturevalue("_dataset"), folder / "recordings" / "plate-7")
    monkeypatch = request.getfixturevalue("monkeypatch")  # only here: tests undo theirs before their folder is checked
    monkeypatch.chdir(folder)
    monkeypatch.setenv("MPLBACKEND", "agg")
