"""The wheel that is published: its metadata, licence and command."""

from __future__ import annotations

import email
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
ROOT = PACKAGE.parents[2]


def test_the_wheel_has_licence_readme_addresses_and_command(tmp_path: Path) -> None:
    copy = tmp_path / "repository" / PACKAGE.relative_to(ROOT)
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("test", "build", "__pycache__", "*.egg-info"))
    shutil.copy(ROOT / "README.md", tmp_path / "repository")
    shutil.copytree(ROOT / "docs", tmp_path / "repository" / "docs", ignore=shutil.ignore_patterns("_build"))
    pip = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--no-index", "--quiet"]
    subprocess.run([*pip, "--wheel-dir", str(tmp_path), str(copy)], check=True)
    [wheel] = tmp_path.glob("fringedic-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        [place] = [name for name in names if name.endswith(".dist-info/METADATA")]
        metadata = email.message_from_bytes(archive.read(place))
        commands = archive.read(place.replace("METADATA", "entry_points.txt")).decode()
        [licence] = [name for name in names if name.endswith("LICENSE")]
        assert b"Apache License" in archive.read(licence)
    manual = "fringedic/report/page_server/manual_pages"
    assert {f"{manual}/operator.md", f"{manual}/nodes/camera.md", f"{manual}/pictures/plan.png"} <= set(names)
    assert metadata["Name"] == "fringedic"
    assert "maintainers" in metadata["Author"]
    assert any(each.startswith("Repository, https://") for each in metadata.get_all("Project-URL", []))
    assert "Topic :: Scientific/Engineering :: Physics" in metadata.get_all("Classifier", [])
    assert "# fringedic" in str(metadata.get_payload())
    assert "fringedic = fringedic.command.main:main" in commands
