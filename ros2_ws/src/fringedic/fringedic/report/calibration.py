"""The calibration report: one HTML file with its figures inside."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from fringedic.calibration.fit_results import GOOD, USABLE, PlaneResult, Verdict
from fringedic.calibration.result import RigCalibration
from fringedic.calibration.sentences import (
    model_choice_sentence,
    problem_sentence,
    reason_sentence,
    warning_sentences,
)
from fringedic.calibration.traceability import Traceability
from fringedic.calibration.uncertainty import motion_sigma
from fringedic.calibration.variants import ModelVariant
from fringedic.report.entries import MISSING
from fringedic.report.templates import base64_png, render_page
from fringedic.wording.numbers import number_text

_DPI = 110
_STRONG = 0.95  # correlations above this are listed

CALIBRATION_REPORT = "report.html"


def write_calibration_report(
    calibration: RigCalibration, path: str | Path, traceability: Traceability | None = None
) -> Path:
    """Write the report of a calibration, one HTML file with its figures inside, and return its path.

    Parameters
    ----------
    calibration
        The calibration.
    path
        The file.
    traceability
        What the rig file says about grid, stage and operator.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    traceability = traceability or Traceability()
    rig = calibration.model
    names = [each.title for each in calibration.parameters]
    distortion = calibration.model.camera_distortion
    if distortion is None:
        lens = (
            "The distortion of the camera's lens was not measured; the camera is assumed to be ideal. One image of a "
            "printed grid is enough to measure it."
        )
    else:
        lens = (
            f"The distortion of the lens was measured by a printed grid (polynomial of order {distortion.order}). "
            "Every pixel has the line of sight of its ideal pixel; images are not resampled."
        )
    content = {
        "calibration": calibration,
        "rig": rig,
        "colour": _COLOURS[calibration.verdict],
        "word": str(calibration.verdict),
        "sentence": reason_sentence(calibration),
        "warnings": warning_sentences(calibration),
        "choice": model_choice_sentence(calibration),
        "created": f"{calibration.created:%Y-%m-%d %H:%M} UTC",
        "pictures": _pictures(calibration),
        "figures": _figures(calibration),
        "thresholds": _thresholds(calibration),
        "traceability": traceability_entries(traceability),
        "planes": [_plane(each) for each in calibration.planes],
        "candidates": [
            {
                "name": _MODELS[each.name],
                "chosen": each.name is calibration.variant,
                "parameters": each.parameters,
                "chi_square": number_text(each.chi_square, 3),
                "systematic": _micro(each.systematic),
                "criterion": number_text(each.criterion, 3),
            }
            for each in calibration.candidates
        ],
        "parameters": [
            {
                "title": each.title,
                "unit": "" if each.unit == "1" else each.unit,
                "value": (
                    f"{each.value:.6g}"
                    if not each.sigma > 0
                    else f"{each.value:.{max(0, min(8, 1 - math.floor(math.log10(each.sigma))))}f}"
                ),
                "sigma": number_text(each.sigma, 2),
            }
            for each in calibration.parameters
        ],
        "strong": [
            f"{names[i]} and {names[j]}: {calibration.correlation[i, j]:+.3f}"
            for i in range(len(names))
            for j in range(i)
            if abs(calibration.correlation[i, j]) > _STRONG
        ],
        "advice": _advice(calibration),
        "lens": lens,
    }
    path.write_text(render_page("calibration.html.j2", **content), encoding="utf-8")
    return path


_MODELS = {
    ModelVariant.SIX_PARAMETER: "six-parameter model (Molimard; Breque)",
    ModelVariant.GENERAL: "general: free direction and lens distortion (Brown) of the projector, free rotation axis",
}
_COLOURS = {Verdict.GO: "green", Verdict.GO_WITH_CARE: "yellow", Verdict.NO_GO: "red"}


def _figures(calibration: RigCalibration) -> list[tuple[str, str, str]]:
    """Return (title, value, meaning) of the key figures."""
    held_out = "none" if math.isnan(calibration.held_out) else _micro(calibration.held_out)
    figures = [
        (
            "Residual of the model",
            _micro(calibration.systematic),
            "RMS of the block means: the error that remains when the noise of single pixels is averaged.",
        ),
        (
            "Noise of one pixel",
            f"{_micro(calibration.residual)} found, {_micro(calibration.predicted)} predicted",
            "Predicted from the noise of the grey levels and the contrast of the fringes; both values should agree. A "
            "residual of the model far below this noise is negligible.",
        ),
        (
            "Planes kept out of the fit",
            held_out,
            "The largest residual of a plane that the fit did not use. It should be about that of the others."
            + ("" if calibration.tested else " A repeated plane shows drift; it does not test the model."),
        ),
        (
            "Uncertainty of z due to the calibration",
            f"up to {_micro(calibration.height_sigma)}",
            "Standard deviation due to the noise of the calibration planes, within the calibrated volume.",
        ),
        (
            "Uncertainty of u and v due to the calibration",
            f"{number_text(1e3 * motion_sigma(calibration.model, calibration.orientation), 2)} µm per mm",
            "Standard uncertainty of the displacement in the plane for each millimetre of motion towards the camera.",
        ),
        (
            "chi square of the block means",
            number_text(calibration.chi_square, 3),
            "1: noise alone. More: a systematic residual, whose size is in the first line.",
        ),
    ]
    if not math.isnan(calibration.principal_effect):
        figures.append(
            (
                "If the projector's axis is 1 px off the middle of its image",
                f"z changes by {_micro(calibration.principal_effect)}",
                "Rotated planes do not determine the position of the axis; the middle is assumed. Grids on the tilted "
                "plane, translated planes or a measured camera distance determine it.",
            )
        )
    return figures


def _thresholds(calibration: RigCalibration) -> list[tuple[str, str, str, str]]:
    """Return (figure, value, limit of GO, limit of GO with care) of the figures that decide."""
    worst, noise = calibration.worst_plane, calibration.predicted
    care = f"up to {_micro(USABLE * noise)}"
    rows = [
        (
            f"largest residual of a fitted plane: {worst.name}",
            _micro(worst.systematic),
            f"up to {_micro(GOOD * worst.predicted)}",
            f"up to {_micro(USABLE * worst.predicted)}",
        ),
        ("uncertainty of z due to the calibration", _micro(calibration.height_sigma), care, care),
        ("images that contradict the others", str(len(calibration.bad_images)), "none", "none"),
    ]
    if not math.isnan(calibration.held_out):
        limit = f"up to {_micro(GOOD * noise)}"
        rows.insert(1, ("largest residual of planes kept out", _micro(calibration.held_out), limit, care))
    return rows


def traceability_entries(known: Traceability) -> list[tuple[str, str, str]]:
    """Return (name, value, note) of what the lengths are traced to; the note names the key of what is not known."""
    angle, height = math.degrees(known.sigma_angle), 1e3 * known.sigma_height
    return [
        _entry("pitch of the printed grid", _known(known.grid_pitch, 1e3, "mm"), "reference_plane.grid_pitch_mm"),
        _entry("stage", known.stage, ""),
        _entry("standard uncertainty of an angle", _known(angle, 1, "degree"), "reference_plane.sigma_angle_degree"),
        _entry("standard uncertainty of a height", _known(height, 1, "mm"), "reference_plane.sigma_height_mm"),
        _entry("plane and grid", known.target, "hardware.calibration_target"),
        _entry("operator", known.operator, "specimen.operator"),
    ]


def _known(value: float | None, factor: float, unit: str) -> str:
    return f"{value * factor:g} {unit}" if value else ""


def _entry(name: str, value: str, key: str) -> tuple[str, str, str]:
    return (name, value, "") if value else (name, MISSING, key and f"enter it as {key}")


def _plane(plane: PlaneResult) -> dict[str, Any]:
    ripple = max(range(len(plane.ripple)), key=lambda i: plane.ripple[i])
    return {
        "name": plane.name,
        "role": "bad" if plane.problem else "in the fit" if plane.fitted else "kept out",
        "cells": [
            f"{plane.residual_phase / (2 * math.pi):.4f}",
            f"{plane.predicted_phase / (2 * math.pi):.4f}",
            _micro(plane.residual),
            _micro(plane.predicted),
            f"{plane.chi_square:.2f}",
            _micro(plane.systematic),
            _micro(plane.systematic_noise),
            f"{100 * plane.valid:.1f} %",
            f"{plane.ripple[ripple] / (2 * math.pi):.4f} ({ripple + 1}×)",
        ],
        "problem": problem_sentence(plane),
    }


def _advice(calibration: RigCalibration) -> list[str]:
    if not calibration.go:
        steps = []
        if calibration.bad_images:
            steps.append(
                f"Repeat {', '.join(calibration.bad_images)} and calibrate again; the figures below are those of the "
                "other images."
            )
        else:
            steps.append("Check that camera, projector and stage are clamped, and that the projector is warm.")
            steps.append(
                "Check the angles that were entered and that the plane is flat; then measure all planes again."
            )
        steps.append("Do not measure with this calibration: its heights have an unknown error.")
        return steps
    steps = ["Calibrate again when camera, lens, projector or their clamps have been touched."]
    steps.append("Before a series of tests, check a flat plane and a known distance (fringedic check).")
    if calibration.warnings:
        steps.insert(0, "Read the warnings; the calibration can be used.")
    return steps


def _pictures(calibration: RigCalibration) -> dict[str, str]:
    """Return the figures of the page by their names, as base64 PNG."""
    # not at the top: nodes and commands that only name the report need no plotting library
    from fringedic.figures import calibration as drawing

    rig = calibration.model
    angles = [plane.angle for plane in calibration.planes]
    figures = {
        "geometry": drawing.draw_geometry(rig, angles, calibration.orientation),
        "planes": drawing.draw_planes(calibration),
        "residuals": drawing.draw_residuals(calibration),
        "correlation": drawing.draw_correlation(calibration),
        "uncertainty": drawing.draw_uncertainty(calibration),
    }
    if rig.camera_distortion is not None:
        figures["distortion"] = drawing.draw_distortion(rig)
    return {name: base64_png(figure, dpi=_DPI) for name, figure in figures.items()}


def _micro(value: float) -> str:
    return "unknown" if math.isnan(value) else f"{number_text(1e6 * value, 3)} µm"
