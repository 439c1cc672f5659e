"""`fringedic timing` on a virtual rig whose projector is late and pulses, as an operator runs it."""

from __future__ import annotations

import subprocess
from pathlib import Path

import yaml

RIG = """
virtual_rig:
  preset: plate
  size: tiny
  projector: {delay_ms: 37.0, refresh_hz: 60.0, refresh_duty: 0.5}
  sensor: {exposure_ms: 10.0}
camera: {source: virtual, exposure_ms: 10.0, settle_ms: 5.0}
projector: {source: virtual}
"""


def fringedic(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["fringedic", *arguments], cwd=folder, capture_output=True, text=True, check=False)


def test_delay_and_refresh_of_a_late_projector(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(RIG)
    ended = fringedic("timing", "rig.yaml", "--longest-ms", "150", folder=tmp_path)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    found = yaml.safe_load((tmp_path / "timing" / "timing.yaml").read_text())
    error = found["delay_ms"] - 37.0
    assert abs(error) < 0.5, f"delay is off by {error:.3f} ms: {found}"
    assert abs(error) < 4 * found["delay_sigma_ms"], f"delay is off by {error:.3f} ms: {found}"
    assert abs(found["refresh_hz"] - 60.0) < 0.01, found
    assert abs(found["beat_percent"] - 66.7) < 5.0, found
    assert abs(found["advised"]["exposure_ms"] - 1e3 / 60) < 0.01
    assert abs(found["advised"]["settle_ms"] - 50.0) < 0.1
    assert "settle time of 5 ms is too short" in " ".join(ended.stdout.split())
    assert "settle_ms: 50\n" in ended.stdout
    assert (tmp_path / "timing" / "timing.png").stat().st_size > 10_000


def test_a_rig_without_projector_is_refused(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text("camera: {source: virtual}\nvirtual_rig: {preset: plate, size: tiny}\n")
    ended = fringedic("timing", "rig.yaml", folder=tmp_path)
    assert ended.returncode == 1
    assert "timing needs a projector" in ended.stdout + ended.stderr


def test_a_settle_time_shorter_than_the_delay_fails_the_step_by_name(tmp_path: Path) -> None:
    late = yaml.safe_load(RIG) | {
        "calibration": "virtual_rig",
        "programme": {"experiment": "late", "steps": [{"mode": "fringes"}]},
    }
    late["virtual_rig"]["projector"] = {"delay_ms": 80.0}
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(late))
    ended = fringedic("run", "rig.yaml", "--output", "late", folder=tmp_path)
    assert ended.returncode == 1
    said = " ".join(ended.stdout.split())
    assert "(error 115)" in said, ended.stdout
    assert "fringedic timing" in said, ended.stdout
