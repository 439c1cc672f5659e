"""The calibration report: one HTML file that someone can read who did not write it."""

from __future__ import annotations

import base64
import io
import math
from typing import TYPE_CHECKING, Any

from jinja2 import Environment
from matplotlib.figure import Figure

from fringedic.calibration import drawing
from fringedic.calibration.page import PAGE

if TYPE_CHECKING:
    from fringedic.calibration.result import RigCalibration

_DPI = 110
_STRONG = 0.95  # correlation that is named


def report_html(calibration: RigCalibration) -> str:
    """Return the report of a calibration as one HTML page, pictures inside."""
    environment = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True)
    page: str = environment.from_string(PAGE).render(**_content(calibration))
    return page


def _content(calibration: RigCalibration) -> dict[str, Any]:
    rig = calibration.model
    angles = [plane.angle for plane in calibration.planes]
    pictures = {
        "geometry": drawing.draw_geometry(rig, angles, calibration.orientation),
        "planes": drawing.draw_planes(calibration),
        "residuals": drawing.draw_residuals(calibration),
        "correlation": drawing.draw_correlation(calibration),
        "uncertainty": drawing.draw_uncertainty(calibration),
    }
    if rig.camera_distortion is not None:
        pictures["distortion"] = drawing.draw_distortion(rig)
    colour, word = _light(calibration)
    return {
        "calibration": calibration,
        "rig": rig,
        "colour": colour,
        "word": word,
        "sentence": calibration.verdict.split(". ", 1)[-1],
        "created": f"{calibration.created:%Y-%m-%d %H:%M} UTC",
        "pictures": {name: _picture(figure) for name, figure in pictures.items()},
        "figures": _figures(calibration),
        "planes": [_plane(each) for each in calibration.planes],
        "candidates": [
            {
                "name": _MODELS.get(each.name, each.name),
                "chosen": abs(each.criterion) < 1e-9,
                "parameters": each.parameters,
                "chi_square": f"{each.chi_square:.3g}",
                "systematic": _micro(each.systematic),
                "criterion": f"{each.criterion:.3g}",
            }
            for each in calibration.candidates
        ],
        "parameters": [
            {
                "title": each.title,
                "unit": "" if each.unit == "1" else each.unit,
                "value": _with_digits(each.value, each.sigma),
                "sigma": f"{each.sigma:.2g}",
            }
            for each in calibration.parameters
        ],
        "strong": _strong(calibration),
        "advice": _advice(calibration),
        "lens": _lens(calibration),
    }


_MODELS = {
    "paper": "paper: six parameters",
    "general": "general: projector's direction and roll, rotation axis free",
    "general + k1": "... and the projector's radial distortion",
    "general + k1 + y": "... and the centre of that distortion along the fringes",
}


def _light(calibration: RigCalibration) -> tuple[str, str]:
    if not calibration.go:
        return "red", "NO-GO"
    return ("yellow", "GO, with care") if calibration.verdict.startswith("GO, with care") else ("green", "GO")


def _figures(calibration: RigCalibration) -> list[tuple[str, str, str]]:
    """Return (title, value, meaning) of what decides."""
    held_out = "none" if math.isnan(calibration.held_out) else _micro(calibration.held_out)
    figures = [
        (
            "Residual of the model",
            _micro(calibration.systematic),
            "How far the planes deviate from the fitted rig after the noise of single pixels has been averaged out: "
            "the error that stays.",
        ),
        (
            "Noise of one pixel",
            f"{_micro(calibration.residual)} found, {_micro(calibration.predicted)} predicted",
            "Predicted from the grey levels' noise and the fringes' contrast. Both should agree; a residual far below "
            "this noise does no harm.",
        ),
        (
            "Planes kept out of the fit",
            held_out,
            "The same residual on planes that the fit did not see. It should be about as small as that of the others.",
        ),
        (
            "Uncertainty of z by the calibration",
            f"up to {_micro(calibration.height_sigma)}",
            "Standard deviation that the noise of the calibration planes leaves, within the calibrated volume.",
        ),
        (
            "chi square of the block means",
            f"{calibration.chi_square:.3g}",
            "1: noise alone. More: something systematic is left, as large as the first line says.",
        ),
    ]
    if not math.isnan(calibration.principal_effect):
        figures.append(
            (
                "If the projector's axis is 1 px beside its image's middle",
                f"z changes by {_micro(calibration.principal_effect)}",
                "Planes that only turn cannot tell where that axis is; the middle is assumed. Translated planes or a "
                "measured camera distance can.",
            )
        )
    return figures


def _plane(plane: Any) -> dict[str, str]:
    ripple = max(range(len(plane.ripple)), key=lambda i: plane.ripple[i])
    return {
        "name": plane.name,
        "role": "bad" if plane.problem else "in the fit" if plane.fitted else "kept out",
        "residual_fringe": f"{plane.residual_phase / (2 * math.pi):.4f}",
        "predicted_fringe": f"{plane.predicted_phase / (2 * math.pi):.4f}",
        "residual": _micro(plane.residual),
        "predicted": _micro(plane.predicted),
        "chi_square": f"{plane.chi_square:.2f}",
        "systematic": _micro(plane.systematic),
        "systematic_noise": _micro(plane.systematic_noise),
        "valid": f"{100 * plane.valid:.1f} %",
        "ripple": f"{plane.ripple[ripple] / (2 * math.pi):.4f} ({ripple + 1}×)",
        "problem": plane.problem,
    }


def _strong(calibration: RigCalibration) -> list[str]:
    """Return sentences about pairs of parameters that the planes hardly tell apart."""
    names = [each.title for each in calibration.parameters]
    return [
        f"{names[i]} and {names[j]}: {calibration.correlation[i, j]:+.3f}"
        for i in range(len(names))
        for j in range(i)
        if abs(calibration.correlation[i, j]) > _STRONG
    ]


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
        steps.append("Do not measure with this calibration: its heights would be wrong by an unknown amount.")
        return steps
    steps = ["Calibrate again when anything of camera, lens, projector or their clamps has been touched."]
    steps.append("Before a series of tests, check a flat plane and a known distance (fringedic check).")
    if calibration.warnings:
        steps.insert(0, "Read the warnings; the calibration can be used.")
    return steps


def _lens(calibration: RigCalibration) -> str:
    distortion = calibration.model.camera_distortion
    if distortion is None:
        return (
            "No distortion of the camera's lens was measured: its pixels are taken as those of an ideal camera. One "
            "image of a printed grid measures it."
        )
    return (
        f"The lens's distortion was measured by a printed grid (polynomial of order {distortion.order}). Every pixel "
        "is given the line of sight of the ideal pixel that it stands for; images are not resampled."
    )


def _picture(figure: Figure) -> str:
    stored = io.BytesIO()
    figure.savefig(stored, format="png", dpi=_DPI)
    return base64.b64encode(stored.getvalue()).decode()


def _micro(value: float) -> str:
    return "not known" if math.isnan(value) else f"{1e6 * value:.3g} µm"


def _with_digits(value: float, sigma: float) -> str:
    """Return a value to the second digit of its standard deviation."""
    if not sigma > 0:
        return f"{value:.6g}"
    return f"{value:.{max(0, min(8, 1 - math.floor(math.log10(sigma))))}f}"
