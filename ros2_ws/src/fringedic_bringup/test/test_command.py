"""The command without a rig: images, wrong input, and what it prints at an error."""

from __future__ import annotations

import io
import re
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
import xarray as xr
from rich.console import Console
from scipy.ndimage import gaussian_filter
from typer.testing import CliRunner

from fringedic.command import app, main
from fringedic.command.app import parameter_values
from fringedic.command.folders import unused_folder
from fringedic.command.progress import LiveProgress
from fringedic.errors import ConfigurationError


def test_measuring_images_finds_their_shift(tmp_path: Path) -> None:
    texture = gaussian_filter(np.random.default_rng(3).normal(size=(120, 160)), 1.5)
    image = np.clip(128 + 300 * texture, 0, 255).astype(np.uint8)
    for name, shift in (("a", 0), ("b", 2), ("c", 4)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.roll(image, shift, axis=1))
    words = [str(tmp_path / f"{name}.png") for name in "abc"]
    options = ["--window", "24", "--spacing", "4", "--output", str(tmp_path / "out")]
    done = CliRunner().invoke(main.app, ["measure", *words, *options])
    assert done.exit_code == 0, done.exception
    with xr.open_dataset(tmp_path / "out" / "displacement.nc", engine="h5netcdf") as field:
        medians = [float(field.displacement_x.sel(step=step).median()) for step in (0, 1, 2)]
        assert field.image.values.tolist() == ["a.png", "b.png", "c.png"]
    assert np.allclose(medians, [0, 2, 4], atol=0.02), medians
    written = {file.name for file in (tmp_path / "out").iterdir()}
    assert written == {"displacement.nc", "report.html"}
    assert "median x (right) 4, y (down)" in done.output.replace("\n", " ")
    assert "reference: a.png for all images" in done.output


@pytest.mark.parametrize(
    "words", [["--help"], ["measure", "--help"], ["campaign", "--help"], ["campaign", "run", "--help"]]
)
def test_help_shows_a_type_only_beside_options_with_a_value(words: list[str]) -> None:
    lines = CliRunner().invoke(main.app, words, color=False).output.splitlines()
    [help_line] = [line for line in lines if "--help " in line]
    assert help_line.split()[:3] == ["│", "--help", "Show"]
    assert "<bool>" not in "".join(lines)


def test_progress_with_both_times_fits_an_ordinary_terminal() -> None:
    console = Console(width=80, force_terminal=True, file=io.StringIO(), no_color=True)
    with LiveProgress(console) as progress:
        progress.step(3, 5, "displacement", 12, 16)
    shown = r"step 3 \(last: 5\): displacement .* frame 12 of 16 .*\d:\d\d:\d\d.* / .*-:--:--.* left"
    assert re.search(shown, console.file.getvalue())


def test_help_groups_all_commands() -> None:
    lines = CliRunner().invoke(main.app, ["--help"], color=False).output.splitlines()
    groups = [line.strip("╭─╮ ") for line in lines if line.startswith("╭")]
    assert groups == ["Options", app.SET_UP, app.MEASURE, app.RESULTS, app.IMAGES, app.MANY]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("run nowhere.yaml", "no such rig file"),
        ("info nowhere", "no such recording"),
        ("replay nowhere", "no such recording"),
        ("replay . --calibration .", "no such calibration"),
        ("process nowhere", "no such recording"),
        ("measure one.png", "no such image or folder of images"),
        ("replay nowhere --set window", "node.parameter=value"),
        ("replay nowhere --set camera.gain=1", "a replay starts phase, dic, coupling, not camera"),
        ("run open_hole_tension.yaml --images nowhere", "no such image or folder of images"),
        ("calibrate", "give a rig file"),
        ("calibrate tiny --angles-deg 0,ten", "angles 0,ten: give numbers"),
        ("live tiny --region 3,4,5", "such as 320,240,640,480"),
    ],
)
def test_errors_are_one_sentence_and_exit_code_1(
    words: str,
    sentence: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["fringedic", *words.split()])
    with pytest.raises(SystemExit) as ended:
        main.main()
    assert ended.value.code == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert sentence in line


def test_installed_command_prints_one_sentence(tmp_path: Path) -> None:
    done = subprocess.run(
        ["fringedic", "info", "nowhere"], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 1
    assert done.stderr.strip() == "nowhere: no such recording"


def test_settings_are_parsed_as_yaml() -> None:
    values = parameter_values(["dic.window=24", "coupling.z_filter_px=2.5", "dic.method=zoi", "dic.region=[1, 2]"])
    assert values == {"dic.window": 24, "coupling.z_filter_px": 2.5, "dic.method": "zoi", "dic.region": [1, 2]}
    for wrong in ("dic.window", "window=24", "rig.dic.window=24"):
        with pytest.raises(ConfigurationError, match="for example"):
            parameter_values([wrong])


def test_folders_are_not_used_twice(tmp_path: Path) -> None:
    assert unused_folder(tmp_path / "demo") == tmp_path / "demo"
    (tmp_path / "demo").mkdir()
    (tmp_path / "demo-2").mkdir()
    assert unused_folder(tmp_path / "demo") == tmp_path / "demo-3"
