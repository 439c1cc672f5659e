"""The one template environment of all HTML pages, which extend ``base.html.j2``, and figures as parts of a page."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fringedic.errors import DatasetError
from fringedic.evidence.changes import noted
from fringedic.provenance import git_commit, software
from fringedic.wording.causes import cause_of
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
    with noted(target, "page"), write_errors_named(target):
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
        raise DatasetError(f"{target}: cannot be written: {cause_of(error)}") from error


@cache
def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.PackageLoader("fringedic.report", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


if TYPE_CHECKING:
    import plotly.graph_objects as go
    from matplotlib.figure import Figure


def base64_text(data: bytes) -> str:
    """Return data as the text of a ``data:`` address."""
    return base64.b64encode(data).decode()


def base64_png(figure: Figure, *, dpi: float | None = None) -> str:
    """Return a figure as PNG, encoded for a ``data:`` address; by default with the resolution of the figure."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi or figure.dpi)
    return base64_text(stream.getvalue())


def chart_html(chart: go.Figure) -> str:
    """Return an interactive chart as HTML that needs the script of `chart_script` in the page."""
    with optional_import("report"):
        from plotly.io import to_html
    options = {"displaylogo": False, "responsive": True}
    return str(to_html(chart, include_plotlyjs=False, full_html=False, config=options))


def chart_script() -> str:
    """Return the JavaScript that draws the charts of a page."""
    with optional_import("report"):
        from plotly.offline import get_plotlyjs
    return str(get_plotlyjs())
