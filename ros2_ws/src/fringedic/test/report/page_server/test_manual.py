"""The manual that the page serves: the help of every view leads to a heading of it, and nothing else is served."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from fringedic.errors import OperatorError
from fringedic.report.page_server import app
from fringedic.report.page_server.manual import manual_file, manual_page

STATIC = Path(app.__file__).with_name("static")


def test_every_view_has_a_help_whose_page_and_heading_exist() -> None:
    views = re.findall(r"(\w+): (?:t\()?\"", (STATIC / "main.js").read_text().split("OF_A_RIG = {")[1].split("}")[0])
    helps = dict(re.findall(r"^  (\w+): \[t\(\".*\"\), \"([\w#/-]+)\"\],$", (STATIC / "help.js").read_text(), re.M))
    assert set(views) <= set(helps)
    for address in helps.values():
        page, _, anchor = address.partition("#")
        assert not anchor or f'id="{anchor}"' in manual_page(page), address


@pytest.mark.parametrize("page", sorted(file.stem for file in manual_file("index").parent.glob("*.md")))
def test_links_and_pictures_of_a_page_are_served(page: str) -> None:
    html = manual_page(page)
    for address in re.findall(r'(?:href|src)="([^"]*)"', html.split("<main>")[1]):
        assert address.startswith(("/manual/", "https://", "http://", "#")), address
        if address.startswith("/manual/"):
            assert manual_file(address.removeprefix("/manual/").partition("#")[0]).is_file()


@pytest.mark.parametrize(
    "page", ["../README", "nodes/../../README", "/etc/passwd", "conf.py", "none", "pictures/../conf.png"]
)
def test_other_files_are_refused(page: str) -> None:
    with pytest.raises(OperatorError, match="the manual has no page"):
        manual_page(page)
