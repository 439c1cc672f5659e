"""Pages as PDF: by the browser that is there, and one sentence where there is none."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from fringedic.errors import FringedicError
from fringedic.report.printing import print_page

PAGE = """<style>@media print { .screen { display: none } p { break-after: page } }</style>
<p>one</p><p>two</p><div class="screen" style="height: 5000px">three</div>"""


def test_without_a_browser_the_sentence_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(FringedicError, match=r"install chromium .*, or print .*page\.html from any browser"):
        print_page(tmp_path / "page.html", tmp_path / "page.pdf")


@pytest.mark.browser
def test_page_is_printed_with_its_style_for_paper(tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text(PAGE)
    printed = print_page(tmp_path / "page.html", tmp_path / "page.pdf").read_bytes()
    assert printed.startswith(b"%PDF")
    assert re.findall(rb"/Count (\d+)", printed) == [b"2"]
