"""The rig file that ``init`` writes can be planned and used, whatever the camera."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from fringedic.command.rig_setup import CameraKind
from fringedic.configuration.new_rig import Answers, write_rig_file
from fringedic.configuration.rig_file import load_rig_file
from fringedic.planning import PlannedRig, make_plan

ADDRESS = {"v4l2": "/dev/video0", "files": "images/*.tif", "video": "test.mp4", "topic": "/cam/image_raw"}


def written(file: Path, kind: str) -> Path:
    write_rig_file(file, Answers(kind, ADDRESS.get(kind, ""), "1280x960", 1, "1920x1080", 0.5, "Ada"))
    return file


@pytest.mark.parametrize("kind", list(CameraKind))
def test_every_kind_of_camera_gives_a_rig_file_that_is_read(tmp_path: Path, kind: CameraKind) -> None:
    rig = load_rig_file(written(tmp_path / "my bench v2.yaml", kind.value))
    assert rig.camera.source == kind.value
    assert rig.programme is not None
    assert rig.programme.experiment == "my-bench-v2"
    assert (rig.calibration is not None) == (kind is CameraKind.VIRTUAL)


def test_the_rig_file_is_planned(tmp_path: Path) -> None:
    plan = make_plan(PlannedRig.of(load_rig_file(written(tmp_path / "bench.yaml", "aravis"))))
    assert plan is not None


def test_a_question_without_an_answer_ends_in_a_sentence(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "fringedic", "init", str(tmp_path / "bench.yaml")]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    assert done.returncode == 130
    assert "ended at a question without an answer, nothing was written" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())
