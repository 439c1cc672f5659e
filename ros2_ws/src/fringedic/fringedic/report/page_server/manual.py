"""The pages of the manual, which the page serves itself: a rig has no internet."""

from __future__ import annotations

import os
import re
from functools import lru_cache
from html import escape
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import urlsplit

from markdown_it import MarkdownIt
from markdown_it.token import Token

from fringedic.errors import OperatorError

_INSTALLED = Path(__file__).with_name("manual_pages")  # of a wheel, see setup.py
_SOURCE = Path(__file__).resolve().parents[6] / "docs"
_PICTURES = {".png", ".svg"}
_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark"><title>{title}</title>
<link rel="stylesheet" href="/page/style.css"></head>
<body class="manual"><nav aria-label="Manual"><a href="/manual/index">Manual</a><a href="/">Page of the rig</a></nav>
<main><article>{body}</article></main></body></html>"""


def manual_file(path: str) -> Path:
    """Return the file of a page (without suffix) or of a picture of the manual.

    Parameters
    ----------
    path
        As in addresses: ``operator``, ``nodes/camera``, ``pictures/plan.png``.

    Raises
    ------
    OperatorError
        There is none.
    """
    folder = _INSTALLED if _INSTALLED.is_dir() else _SOURCE
    named = PurePosixPath(path)
    file = folder / (named if named.suffix in _PICTURES else f"{named}.md")
    if ".." in named.parts or not file.is_file() or folder.resolve() not in file.resolve().parents:
        raise OperatorError(f"the manual has no page {path[:60]}: begin with /manual/index")
    return file


@lru_cache(maxsize=200)  # a page has more than one address
def manual_page(path: str) -> str:
    """Return a page of the manual as HTML; text that looks like HTML is escaped.

    Raises
    ------
    OperatorError
        There is no such page.
    """
    text = manual_file(path).read_text("utf-8")
    markdown = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens = markdown.parse(text)
    folder = PurePosixPath(path).parent
    title = path
    for token, following in zip(tokens, [*tokens[1:], Token("", "", 0)], strict=True):
        if token.type == "heading_open":
            token.attrSet("id", _anchor(following.content))
            title = following.content if token.tag == "h1" else title
        for child in token.children or []:
            for name in {"href", "src"} & set(child.attrs):
                address = _address(str(child.attrs.pop(name)), folder)
                child.attrs |= {name: address} if address else {}
    body: Any = markdown.renderer.render(tokens, markdown.options, {})
    return _PAGE.format(title=escape(title), body=body)


def _anchor(heading: str) -> str:
    """Return the anchor of a heading, as the built manual has it.

    Examples
    --------
    >>> _anchor("Maps, curves, 3D"), _anchor("`run` with *until*")
    ('maps-curves-3d', 'run-with-until')
    """
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def _address(link: str, folder: PurePosixPath) -> str:
    """Return the address at this server of a link between pages; addresses of other servers stay as they are."""
    parts = urlsplit(link)
    if parts.scheme or parts.netloc or not parts.path:
        return link
    place = os.path.normpath(folder / parts.path.removesuffix(".md"))
    try:
        manual_file(place)
    except OperatorError:
        return ""  # a file of the repository that is no page of the manual
    return f"/manual/{place}{parts.fragment and f'#{parts.fragment}'}"
