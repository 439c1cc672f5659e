"""The Python blocks of the README and of the pages run, in the order of each page, on data of the virtual rig."""

from __future__ import annotations

import itertools
import re
import shutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import fringedic
from fringedic.datasets import process_bag
from fringedic.rig_setup.response import response_patterns
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

ROOT = Path(__file__).parents[4]
RECORDING = Path(__file__).parent / "recordings" / "version_0_1" / "bag"
BLOCK = re.compile(r"```python\n(.*?)```", re.DOTALL)
WHITE = 250
GRID_PITCH = 2e-3  # [m]; 10 px of the small rig


def blocks(page: str) -> str:
    """Return the Python blocks of a page, one after the other."""
    return "\n".join(BLOCK.findall((ROOT / page).read_text(encoding="utf-8")))


@cache
def rig_with_grid() -> VirtualRig:
    return VirtualRig(
        VirtualRigConfiguration.from_dict(
            {
                "preset": "plate",
                "size": "small",
                "stage": {"grid_pitch_mm": 2.0, "grid_blur_um": 110.0, "grid_turned_degree": 3.0},
            }
        )
    )


def grid_image(angle_degree: float) -> np.ndarray:
    """Return the printed grid on the reference plane at an angle, as the camera sees it in white light."""
    twin = rig_with_grid().with_specimen({"kind": "reference_plane", "surface": "grid", "angle_degree": angle_degree})
    return twin.expose(np.full(twin.projector_shape, WHITE, np.uint8), 0.0, int(angle_degree) + 100)


def planes(angles_degree: Iterator[float] | list[float]) -> list[Any]:
    """Return absolute phases of the reference plane at these angles."""
    rig = rig_with_grid()
    rows, columns = rig.projector_shape
    sequence = fringedic.fringe_sequence(columns, rows, [200.0, 40.0, 10.0], 4)
    measured = []
    for number, angle in enumerate(angles_degree):
        twin = rig.with_specimen({"kind": "reference_plane", "angle_degree": angle})
        frames = np.array([twin.expose(image, 0.0, 100 * number + k) for k, image in enumerate(sequence)])
        measured.append(fringedic.absolute_phase(frames, sequence.patterns))
    return measured


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the dataset of a small recorded experiment."""
    return process_bag(RECORDING, output=tmp_path_factory.mktemp("recorded") / "results.nc")


def place_recording(results: Path, run: Path) -> None:
    """Leave a recording and its dataset as a run does."""
    run.mkdir(parents=True)
    shutil.copytree(RECORDING, run / "bag")
    shutil.copy(results, run / "bag.nc")


def speckle_pair() -> tuple[np.ndarray, np.ndarray]:
    rig = VirtualRig.from_preset("plate", size="tiny")
    white = np.full(rig.projector_shape, WHITE, np.uint8)
    return rig.expose(white, 0.0, 0), rig.expose(white, 0.2e-3, 1)


def test_readme(folder: Path, results: Path) -> None:
    place_recording(results, folder / "my_test")
    reference, deformed = speckle_pair()
    names: dict[str, Any] = {"reference": reference, "deformed": deformed}
    exec(blocks("README.md"), names)
    assert names["experiment"].sizes["step"] == 3
    assert np.isfinite(names["displacement"].displacement_x).mean() > 0.8


def test_calibration_page(folder: Path) -> None:
    angles = [-15.0, -10.0, -5.0, 0.0, 5.0, 10.0, 15.0, 7.5]
    measured = planes(angles)
    grid = fringedic.measure_distortion(grid_image(0.0), pitch=GRID_PITCH)
    code = blocks("docs/calibration.md").replace("(800, 600)", "size").replace("0.5e-3", str(GRID_PITCH))
    names: dict[str, Any] = {
        "phases": [plane.phase for plane in measured],
        "sigmas": [plane.sigma for plane in measured],
        "phase": measured[0].phase,
        "sigma": measured[0].sigma,
        "grid": grid,
        "size": rig_with_grid().projector_shape[::-1],
        "image": grid_image(0.0),
        "left": grid_image(-12.0),
        "right": grid_image(12.0),
    }
    exec(code, names)
    assert names["calibration"].go
    assert (folder / "report.html").exists()
    assert (folder / "calibration" / "calibration.yaml").exists()
    assert names["grid"].plane.pin_hole is not None


def test_distortion_page(folder: Path) -> None:
    cv2.imwrite("grid.tif", grid_image(0.0))
    names: dict[str, Any] = {}
    exec(blocks("docs/distortion.md").replace("0.5e-3", str(GRID_PITCH)), names)
    assert names["straight"].shape == names["image"].shape
    assert (folder / "lens.yaml").exists()


def test_mechanics_page(folder: Path, results: Path) -> None:
    shutil.copy(results, folder / "results.nc")
    # the positions of the page are those of an image of 1280x960 px, the recording has 160x120
    code = re.sub(r"\((\d+), (\d+)\)", lambda m: f"({int(m[1]) // 8}, {int(m[2]) // 8})", blocks("docs/mechanics.md"))
    names: dict[str, Any] = {"images": [*speckle_pair(), speckle_pair()[1]], "itertools": itertools}
    exec(code.replace("subset=21", "subset=5"), names)
    assert np.isfinite(names["gauge"].strain.values).all()
    assert np.isfinite(names["curve"].force.values).all()
    assert names["total"].displacement_y.shape == names["parts"][0].displacement_y.shape


def test_response_page(folder: Path) -> None:
    patterns = response_patterns()
    level = np.array([pattern.shift / pattern.shifts for pattern in patterns])
    frames = np.broadcast_to(20 + 180 * level[:, None, None] ** 2.2, (len(patterns), 40, 50))
    noise = np.random.default_rng(1).normal(0, 0.5, frames.shape)
    names: dict[str, Any] = {"frames": (frames + noise).round().astype(np.uint8)}
    exec(blocks("docs/nodes/projector.md"), names)
    assert names["curve"].gamma == pytest.approx(2.2, abs=0.1)
    assert (folder / "response.yaml").exists()


def test_results_page(folder: Path, results: Path) -> None:
    place_recording(results, folder / "recordings" / "plate-7")
    names: dict[str, Any] = {}
    code = blocks("docs/results.md").replace("step=3", "step=2")
    exec(code, names)
    assert names["experiment"].force.values[2] > 500


def test_tutorial(folder: Path, results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place_recording(results, folder / "my_test")
    # the rig file of the tutorial states the cross-section, the small recording does not
    code = blocks("docs/tutorial.md").replace('("row", "column")))', '("row", "column")), section=20e-6)')
    exec(code, {})
    ratio = re.search(r"Poisson's ratio ([-\d.]+)", capsys.readouterr().out)
    assert ratio is not None
    assert 0.1 < float(ratio[1]) < 0.5
