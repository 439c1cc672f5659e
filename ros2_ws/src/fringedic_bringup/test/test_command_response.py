"""`fringedic response` on a virtual rig with a gamma, as an operator runs it; then the rig with its correction."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np

from fringedic.response import ResponseCurve

RIG = """
virtual_rig: {preset: plate, size: small, projector: {gamma: 2.2}}
camera: {source: virtual}
projector: {source: virtual}
sequence: {pitches_px: [400.0, 40.0, 10.0], shifts: 3}
"""


def fringedic(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["fringedic", *arguments], cwd=folder, capture_output=True, text=True, check=False)


def test_the_curve_of_a_rig_and_what_it_does_for_the_phase(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(RIG)
    ended = fringedic("response", "rig.yaml", folder=tmp_path)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    curve = ResponseCurve.load(tmp_path / "response" / "response.yaml")
    error = np.abs(np.array(curve.brightness) - np.linspace(0, 1, 256) ** 2.2).max()
    assert error < 0.005, f"the curve is off by {error:.4f}"
    words = " ".join(ended.stdout.split())
    told = re.search(r"3 shifts: ([\d.]+) fringe as it is, ([\d.]+) fringe with corrected", words)
    assert told is not None, words
    before, after = map(float, told.groups())
    assert 0.020 < before < 0.028, f"gamma 2.2 bends the phase of three shifts by .024 fringe, not {before}"
    assert after < 0.0006, f"{after} fringe are left"
    assert "three shifts need the correction" in words
    assert "response_curve: response/response.yaml" in words
    assert (tmp_path / "response" / "response.png").stat().st_size > 10_000


def test_a_rig_without_projector_is_refused(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text("camera: {source: virtual}\nvirtual_rig: {preset: plate, size: tiny}\n")
    ended = fringedic("response", "rig.yaml", folder=tmp_path)
    assert ended.returncode == 1
    assert "needs a projector" in ended.stdout + ended.stderr
