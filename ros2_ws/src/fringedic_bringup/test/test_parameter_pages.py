"""The pages of the nodes list their parameters as they are declared."""

from __future__ import annotations

from pathlib import Path

import pytest

from fringedic_ros.parameter_docs import documented

PAGES = sorted((Path(__file__).parents[4] / "docs" / "nodes").glob("*.md"))


@pytest.mark.parametrize("page", [page for page in PAGES if page.stem != "index"], ids=lambda page: page.stem)
def test_page_is_up_to_date(page: Path) -> None:
    text = page.read_text()
    assert "<!-- parameters: " in text
    assert documented(text) == text, f"run python -m fringedic_ros.parameter_docs {page}"
