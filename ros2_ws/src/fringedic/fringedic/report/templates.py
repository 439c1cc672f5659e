"""The one template environment of all HTML pages: every page extends ``base.html.j2``, which holds the common style."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from fringedic.errors import DatasetError
from fringedic.provenance import git_commit, software
from fringedic.wording.optional_packages import optional_import

with optional_import("report"):
    import jinja2


def render_page(template: str, **content: Any) -> str:
    """Return an HTML page from a template of this folder.

    Text is escaped, and a name that the template uses but `content` lacks is an error. The template knows the
    ``software`` that writes the page.

    Parameters
    ----------
    template
        File name, for example ``"calibration.html.j2"``.
    **content
        Values by the names that the template uses.

    Raises
    ------
    jinja2.UndefinedError
        The template uses a name that `content` does not contain.
    """
    page: str = _environment().get_template(template).render(software=f"{software()}, commit {git_commit()}", **content)
    return page


def require_new(target: Path, overwrite: bool) -> None:
    """Refuse to replace a page unasked, before the work of rendering.

    Raises
    ------
    DatasetError
        It exists already.
    """
    if target.exists() and not overwrite:
        raise DatasetError(f"{target} exists already; choose another --output or ask to overwrite it")


def write_page(page: str, target: Path) -> Path:
    """Write a page as a whole, and return its path: the one before stays when the writing fails.

    Raises
    ------
    DatasetError
        It cannot be written.
    """
    temporary = target.with_name(f".{target.name}.writing")
    with write_errors_named(target):
        try:
            temporary.write_text(page, encoding="utf-8")
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)
    return target


@contextmanager
def write_errors_named(target: Path) -> Iterator[None]:
    """Name a page that cannot be written.

    Raises
    ------
    DatasetError
        In place of an error of the file system.
    """
    try:
        yield
    except OSError as error:
        raise DatasetError(f"{target}: cannot be written: {error.strerror}") from error


@cache
def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.PackageLoader("fringedic.report", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
