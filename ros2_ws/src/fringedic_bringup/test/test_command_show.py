"""`fringedic show` holds a pattern until Enter."""

from __future__ import annotations

import subprocess
from pathlib import Path


def show(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    (folder / "rig.yaml").write_text(
        "virtual_rig: {preset: plate, size: tiny}\ncamera: {source: virtual}\nprojector: {source: virtual}\n"
    )
    return subprocess.run(
        ["fringedic", "show", "rig.yaml", *arguments],
        cwd=folder,
        input="\n",
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_pattern_is_held_until_enter(tmp_path: Path) -> None:
    ended = show("focus", folder=tmp_path)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "the projector shows focus; Enter ends it" in ended.stdout


def test_an_unknown_pattern_is_refused(tmp_path: Path) -> None:
    ended = show("stars", folder=tmp_path)
    assert ended.returncode == 1
    assert "pattern stars is unknown; use one of crosshair, grid" in " ".join((ended.stdout + ended.stderr).split())
