"""Pages at the top of the repository: their links exist, and the version is the library's."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

import fringedic

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("page", ["README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md"])
def test_links_exist(page: str) -> None:
    targets = re.findall(r"\]\(([^)#]+)", (ROOT / page).read_text(encoding="utf-8"))
    for target in targets:
        assert target.startswith("https://") or (ROOT / target).exists(), target


def test_citation_and_changelog_name_the_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == fringedic.__version__
    heading = f"## {fringedic.__version__} ({citation['date-released']})"
    assert heading in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").splitlines()


def test_readme_lists_the_rooms_of_the_library() -> None:
    rooms = {path.parent.name for path in (ROOT / "ros2_ws/src/fringedic/fringedic").glob("*/__init__.py")}
    listed = re.findall(r"^ {8}(\w+)/ ", (ROOT / "README.md").read_text(encoding="utf-8"), re.M)
    assert sorted(listed) == sorted(rooms)


def test_messages_of_the_troubleshooting_page_exist() -> None:
    """Their words between placeholders and numbers are in the source, where strings can continue in the next line."""
    files = [*ROOT.glob("ros2_ws/src/*/*_node/**/*.py"), *ROOT.glob("ros2_ws/src/fringedic*/fringedic*/**/*.py")]
    files += ROOT.glob("setup/*.sh")
    source = " ".join("".join(path.read_text(encoding="utf-8") for path in files).split())
    source = re.sub(r'" f?"', "", source)
    page = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    parts = {part.strip() for words in re.findall(r'"([^"]+)"', page) for part in re.split(r"\.\.\.|\d+", words)}
    assert len(parts) > 40
    assert [part for part in sorted(parts) if part not in source] == []
