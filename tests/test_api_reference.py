"""The API reference has a page for every package with public names, and names every public name of the root."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
LIBRARY = ROOT / "ros2_ws/src/fringedic/fringedic"
PAGES = ROOT / "docs" / "api"


def test_every_package_has_a_page() -> None:
    packages = {file.parent.name for file in LIBRARY.glob("*/__init__.pyi")}
    pages = {page.stem for page in PAGES.glob("*.md")} - {"index", "errors", "accessor"}
    assert pages == packages


def test_every_public_name_of_the_root_is_listed() -> None:
    public = set(re.findall(r"import \w+ as (\w+)", (LIBRARY / "__init__.pyi").read_text(encoding="utf-8")))
    listed = set(re.findall(r"\{py:obj\}`(\w+) <", (PAGES / "index.md").read_text(encoding="utf-8")))
    assert listed == public
