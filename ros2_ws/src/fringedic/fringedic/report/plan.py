"""The page of a plan."""

from __future__ import annotations

from pathlib import Path

from fringedic.planning.plan import Plan
from fringedic.planning.planned_patch import QUANTITIES
from fringedic.planning.sentences import (
    NOTE,
    change_rows,
    length_rows,
    plan_warning_sentence,
    recommendation_sentences,
    uncertainty_rows,
)
from fringedic.report.templates import base64_png, render_page


def write_plan_page(plan: Plan, path: Path, *, rig: str) -> Path:
    """Write a plan as one HTML file with its figures and return the path.

    Parameters
    ----------
    plan
        The prediction.
    path
        The file.
    rig
        Name of the rig.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    from fringedic.figures.plan import draw_fields, draw_side_view

    page = render_page(
        "plan.html.j2",
        rig=rig,
        lengths=length_rows(plan),
        rows=uncertainty_rows(plan),
        changes=change_rows(plan),
        quantities=QUANTITIES,
        recommendations=recommendation_sentences(plan),
        warnings=[plan_warning_sentence(each) for each in plan.warnings],
        note=NOTE,
        side_view=base64_png(draw_side_view(plan)),
        fields=base64_png(draw_fields(plan)),
    )
    path.write_text(page, encoding="utf-8")
    return path
