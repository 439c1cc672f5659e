"""`fringedic response` on a virtual rig with a gamma, as an operator runs it; then the rig with its correction."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np

from fringedic.patterns.response import ResponseCurve

RIG = """
virtual_rig: {preset: plate, size: small, projector: {gamma: 2.2}}
camera: {source: virtual}
projector: {source: virtual}
sequence: {pitches_px: [400.0, 40.0, 10.0], shifts: 3}
"""


def fringedic(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["fringedic", *arguments], cwd=folder, capture_output=True, text=True, check=False)


def test_curve_of_a_rig_and_the_phase_error_without_and_with_correction(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(RIG)
    ended = fringedic("response", "rig.yaml", folder=tmp_path)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    curve = ResponseCurve.load(tmp_path / "response" / "response.yaml")
    error = np.abs(np.array(curve.brightness) - np.linspace(0, 1, 256) ** 2.2).max()
    assert error < 0.005, f"the curve is off by {error:.4f}"
    words = " ".join(ended.stdout.split())
    found = re.search(r"3 shifts: ([\d.]+) fringe without correction, ([\d.]+) fringe with corrected", words)
    assert found is not None, words
    before, after = map(float, found.groups())
    assert 0.020 < before < 0.028, f"gamma 2.2 causes an error of 0.024 fringe with three shifts, not {before}"
    assert after < 0.0006, f"an error of {after} fringe remains"
    assert "Three shifts need the correction" in words
    assert "response_curve: response/response.yaml" in words
    assert (tmp_path / "response" / "response.png").stat().st_size > 10_000


def test_a_rig_without_projector_is_refused(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text("camera: {source: virtual}\nvirtual_rig: {preset: plate, size: tiny}\n")
    ended = fringedic("response", "rig.yaml", folder=tmp_path)
    assert ended.returncode == 1
    assert "needs a projector" in ended.stdout + ended.stderr


def test_saturation_of_twelve_bits_is_seen(tmp_path: Path) -> None:
    """Grey levels of 12 bits come in 16: their largest value is 4095."""
    twelve = RIG.replace("size: small", "size: tiny, sensor: {bits: 12, exposure_ms: 1}").replace(
        "source: virtual}\nprojector", "source: virtual, exposure_ms: 500}\nprojector"
    )
    (tmp_path / "rig.yaml").write_text(twelve)
    ended = fringedic("response", "rig.yaml", folder=tmp_path)
    assert ended.returncode == 1, ended.stdout
    assert "saturates: shorten the exposure" in ended.stdout + ended.stderr
