"""Figures as parts of an HTML page that needs no other file."""

from __future__ import annotations

import base64
import io
from typing import TYPE_CHECKING

from fringedic.wording.optional_packages import optional_import

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
