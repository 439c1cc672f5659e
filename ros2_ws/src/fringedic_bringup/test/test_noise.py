"""`fringedic noise` through the nodes of a virtual rig, and on image files."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from typer.testing import CliRunner

from fringedic.command.main import app
from fringedic.errors import ConfigurationError, RigSetupError
from fringedic.metadata import NoiseFloorMetadata
from fringedic.recording.reader import BagReader

NOISE = (sys.executable, "-c", "from fringedic.command.main import main; main()", "noise")
TINY = Path(__file__).parent.parent / "config" / "tiny.yaml"


def test_steps_at_rest_of_the_virtual_rig(tmp_path: Path) -> None:
    """The camera of the preset has 1 grey level of read noise, rounds, and a variance of 0.02 per grey level."""
    done = subprocess.run(
        [*NOISE, str(TINY), "--steps", "3", "--output", str(tmp_path / "noise")],
        env=dict(os.environ),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "noise floor of 3 steps at rest" in done.stdout
    metadata = NoiseFloorMetadata.load(tmp_path / "noise" / "noise_floor.yaml")
    assert metadata.read_noise_grey_level == pytest.approx(math.sqrt(1 + 1 / 12), rel=0.02)
    assert metadata.shot_noise_grey_level == pytest.approx(0.02, rel=0.03)
    for name in ("displacement_x_px", "u_um", "v_um", "w_um"):
        assert metadata.spatial[name] == pytest.approx(metadata.predicted[name], rel=0.25), name
    assert metadata.temporal["z_um"] == pytest.approx(metadata.predicted["z_um"], rel=0.25)
    for name, found in (("displacement_x_px", metadata.spatial), ("phase_fringe", metadata.temporal)):
        assert 0.8 < found[name] / metadata.limit[name] < 1.4, name
    assert (metadata.window_px, metadata.spacing_px, metadata.strain_window_px) == (32, 1, 85)


def test_ctrl_c_ends_the_measurement_without_a_result(tmp_path: Path) -> None:
    command = [*NOISE, str(TINY), "--steps", "20", "--output", str(tmp_path / "noise")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as running:
        assert running.stdout is not None
        for line in running.stdout:
            if "step 4 " in line:
                running.send_signal(signal.SIGINT)
                break
        rest = running.stdout.read()
    assert running.returncode == 130, rest
    assert "interrupted; nothing is running any more" in rest
    assert not (tmp_path / "noise" / "noise_floor.yaml").exists()
    assert not BagReader(tmp_path / "noise" / "bag").lost


@pytest.fixture
def images(tmp_path: Path) -> list[str]:
    """Four images of 8 bits of a surface at rest, with 2 grey levels of noise."""
    rng = np.random.default_rng(3)
    texture = gaussian_filter(rng.normal(size=(160, 200)), 1.4)
    grey = 128 + 30 * texture / texture.std()
    names = []
    for k in range(4):
        names.append(str(tmp_path / f"static-{k}.png"))
        cv2.imwrite(names[-1], np.clip(np.rint(grey + rng.normal(0, 2, grey.shape)), 0, 255).astype(np.uint8))
    return names


def test_images_at_rest(images: list[str], tmp_path: Path) -> None:
    options = [word for name in images for word in ("--images", name)]
    result = CliRunner().invoke(app, ["noise", *options, "--window", "24", "--output", str(tmp_path / "noise")])
    assert result.exit_code == 0, result.exception
    metadata = NoiseFloorMetadata.load(tmp_path / "noise" / "noise_floor.yaml")
    level = 128
    variance = metadata.read_noise_grey_level**2 + metadata.shot_noise_grey_level * level
    assert math.sqrt(variance) == pytest.approx(math.sqrt(4 + 1 / 12), rel=0.02)
    assert metadata.spatial["displacement_x_px"] == pytest.approx(metadata.predicted["displacement_x_px"], rel=0.2)
    assert metadata.spatial["e_11_ustrain"] > 0


def test_too_few_images_or_steps_are_refused(images: list[str], tmp_path: Path) -> None:
    few = CliRunner().invoke(app, ["noise", "--images", images[0], "--output", str(tmp_path / "a")])
    assert isinstance(few.exception, RigSetupError)
    assert "at least 3" in str(few.exception)
    short = CliRunner().invoke(app, ["noise", str(TINY), "--steps", "2", "--output", str(tmp_path / "b")])
    assert short.exit_code == 2
    assert "equal to 3" in short.output
    nothing = CliRunner().invoke(app, ["noise"])
    assert isinstance(nothing.exception, ConfigurationError)
