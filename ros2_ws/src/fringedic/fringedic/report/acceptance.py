"""The page of an acceptance test."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

from fringedic.calibration.acceptance import Acceptance
from fringedic.calibration.acceptance_sentences import error_rows, place_rows, size_sentences, verdict_sentence
from fringedic.report.templates import base64_png, render_page

ACCEPTANCE_PAGE = "acceptance.html"
GUIDELINE = "VDI/VDE 2634 part 2"


def write_acceptance_page(acceptance: Acceptance, path: Path, *, rig: str, created: datetime) -> Path:
    """Write the page of an acceptance test and return its path.

    Parameters
    ----------
    acceptance
        The result.
    path
        The file.
    rig
        Name of the calibration.
    created
        Time of the test.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    from fringedic.figures.acceptance import draw_errors, draw_residuals

    page = render_page(
        "acceptance.html.j2",
        rig=rig,
        created=f"{created:%Y-%m-%d %H:%M} UTC",
        guideline=GUIDELINE,
        sentences=[verdict_sentence(acceptance), *size_sentences(acceptance)],
        errors=error_rows(acceptance),
        places=place_rows(acceptance),
        volume=" x ".join(f"{1e3 * each:g}" for each in acceptance.artefacts.volume),
        artefacts=acceptance.artefacts,
        error_picture=base64_png(draw_errors(acceptance)),
        residual_picture=base64_png(draw_residuals(acceptance)),
    )
    path.write_text(page, encoding="utf-8")
    return path
