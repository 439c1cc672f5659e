"""The one template environment of all HTML pages: every page extends ``base.html.j2``, which holds the common style."""

from __future__ import annotations

from functools import cache
from typing import Any

from fringedic.errors import optional_import

with optional_import("report"):
    import jinja2


def render_page(template: str, **content: Any) -> str:
    """Return an HTML page from a template of this folder.

    Text is escaped, and a name that the template uses but `content` lacks is an error.

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
    page: str = _environment().get_template(template).render(**content)
    return page


@cache
def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.PackageLoader("fringedic.report", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
