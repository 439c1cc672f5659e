"""`fringedic advise` on image files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from typer.testing import CliRunner

from fringedic.command.main import app
from fringedic.errors import ImageError, RigSetupError


@pytest.fixture
def files(tmp_path: Path) -> list[str]:
    """Three images of 8 bits of the same surface, with independent noise of 2 grey levels."""
    rng = np.random.default_rng(3)
    texture = gaussian_filter(rng.normal(size=(240, 320)), 1.4)
    grey = 128 + 38 * texture / texture.std()
    names = []
    for k in range(3):
        names.append(str(tmp_path / f"static-{k}.png"))
        cv2.imwrite(names[-1], np.clip(np.rint(grey + rng.normal(0, 2, grey.shape)), 0, 255).astype(np.uint8))
    return names


def test_the_report_is_printed(files: list[str]) -> None:
    options = ["--wanted-noise-px", "0.006", "--pixel-size-mm", "0.05", "--strain-window-points", "7"]
    result = CliRunner().invoke(app, ["advise", *files, *options])
    assert result.exit_code == 0
    report = {line[:30].strip(): line[30:].strip() for line in result.output.splitlines() if line.startswith("  ")}
    assert report["image resolution"] == "320 x 240 px"
    assert report["full scale"] == "255 in steps of 1"
    assert report["image noise"].startswith(("1.9", "2.0"))
    # 8 bits add 1/12 to the variance of the noise.
    assert float(report["displacement, spatial"].split()[0]) == pytest.approx(0.006, rel=0.2)
    window, spacing = (
        int(report[name].split()[0]) for name in ("window (width of the subset)", "spacing (of the points)")
    )
    strain_window = 6 * spacing + 1
    assert report["strain window"] == f"{strain_window} px (7 points)"
    assert report["with them"].endswith(f"--window {window} --spacing {spacing} --strain-window {strain_window}")
    assert report["virtual strain gauge"].startswith(
        f"{6 * spacing + window} px ({0.05 * (6 * spacing + window):.3g} mm)"
    )


def test_impossible_requests_are_refused(files: list[str], tmp_path: Path) -> None:
    negative = CliRunner().invoke(app, ["advise", *files, "--wanted-noise-px", "-1"])
    assert isinstance(negative.exception, RigSetupError)
    assert "positive" in str(negative.exception)
    missing = CliRunner().invoke(app, ["advise", *files[:2], str(tmp_path / "none.png")])
    assert isinstance(missing.exception, ImageError)
    assert "none.png" in str(missing.exception)
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((20, 30), np.uint8))
    small = CliRunner().invoke(app, ["advise", *files[:2], str(tmp_path / "small.png")])
    assert isinstance(small.exception, ImageError)
    assert str(small.exception) == (
        f"{tmp_path / 'small.png'} has 30x20 px, {files[0]} has 320x240 px: give images of one size"
    )
