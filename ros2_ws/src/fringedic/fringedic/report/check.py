"""The page of a check of the rig: result, figures with their limits, and the map of the plate."""

from __future__ import annotations

import math
from datetime import datetime
from pathlib import Path

from fringedic.calibration.check import SCALE_TOLERANCE, RigCheck
from fringedic.calibration.sentences import check_sentence, check_warning_sentences, measured_distance
from fringedic.calibration.traceability import Traceability
from fringedic.report.calibration import traceability_entries
from fringedic.report.templates import base64_png, render_page
from fringedic.wording.numbers import number_text

CHECK_PAGE = "check.html"


def write_check_page(
    check: RigCheck, path: Path, *, rig: str, created: datetime, traceability: Traceability | None = None
) -> Path:
    """Write the page of a check and return its path.

    Parameters
    ----------
    check
        The result.
    path
        The file.
    rig
        Name of the calibration.
    created
        Time of the check.
    traceability
        What the rig file says about grid, stage and operator.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    from fringedic.figures.calibration import draw_flatness

    noise = f"up to {_micro(check.noise)} (noise of a pixel)"
    rows = [("flatness of the plate, RMS of block means", _micro(check.flatness), noise)]
    if not math.isnan(check.expected):
        rows.append(
            (
                f"known distance of {1e3 * check.expected:.3f} mm",
                measured_distance(check),
                f"within {100 * SCALE_TOLERANCE:g} %",
            )
        )
    if not math.isnan(check.drift):
        rows.append(("change of the plate since its first measurement", _micro(check.drift), noise))
    if not math.isnan(check.age):
        rows.append(("age of the calibration", f"{check.age / 86400:.1f} days", "30 days"))
    page = render_page(
        "check.html.j2",
        rig=rig,
        created=f"{created:%Y-%m-%d %H:%M} UTC",
        sentences=[check_sentence(check), *check_warning_sentences(check)],
        figures=rows,
        traceability=traceability_entries(traceability or Traceability()),
        picture=base64_png(draw_flatness(check)),
    )
    path.write_text(page, encoding="utf-8")
    return path


def _micro(value: float) -> str:
    return f"{number_text(1e6 * value, 3)} µm"
