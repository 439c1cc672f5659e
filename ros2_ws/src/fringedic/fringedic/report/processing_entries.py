"""Entries of a report about the processing: correlation, strain, projector, fringes and calibration."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

import numpy as np
import xarray as xr

from fringedic.metadata import CheckMetadata
from fringedic.report.data import ReportData
from fringedic.report.entries import VIRTUAL, Entry, entered, without
from fringedic.wording.numbers import number_text

_CORRELATION = {
    "dense": {
        "matching criterion": "sum of squared grey-level differences, weighted by the window; gain and offset fitted",
        "shape function": "the displacement itself, smoothed, warps the image (no polynomial per subset)",
        "interpolant": "six pixels of the deformed image: quintic B-spline, its 2nd and 4th derivative, prefiltered",
    },
    "zoi": {
        "matching criterion": "amplitude-weighted phase differences of the zones' spectra",
        "shape function": "translation of each zone",
        "interpolant": "none: windows move by whole pixels, the phases give the remainder",
    },
}


def analysis_entries(data: ReportData) -> list[Entry]:
    """Return how displacement and strain were computed."""
    attributes = data.dataset.attrs
    entries = [
        Entry("software", attributes.get("software")),
        Entry("commit", attributes.get("commit")),
        Entry("image filtering", "none before the correlation"),
    ]
    dic, coupling = data.parameters.get("dic", {}), data.parameters.get("coupling", {})
    if not dic:
        return [*entries, Entry("settings of the correlation", None, "the dataset contains no parameters")]
    z_filter = coupling.get("z_filter_px")
    if z_filter is not None:
        smoothed = f"Gaussian, {z_filter:g} px standard deviation" if z_filter else "none"
        filtering = [Entry("filter of the heights before their difference", smoothed)]
    else:
        filtering = []
    width = data.parameters.get("strain", coupling).get("strain_window_px", 0)
    strain = _strain_entries(data, width, dic["spacing"], dic["window"])
    model = [] if data.images_alone else [_camera_model(data.calibration)]
    return [*entries, *_correlation_entries(data, dic), *filtering, *strain, *model]


def _correlation_entries(data: ReportData, dic: dict[str, Any]) -> list[Entry]:
    window, spacing, method = dic["window"], dic["spacing"], dic.get("method", "dense")
    return [
        Entry("method", method),
        Entry("subset", f"{window} px{data.length(window)}", "bi-triangular window with the same noise"),
        Entry("step (spacing)", f"{spacing} px{data.length(spacing)}"),
        *(Entry(name, value) for name, value in _CORRELATION.get(method, {}).items()),
        Entry("regularisation", "none beyond the window"),
        *_new_references(dic.get("rereference_fraction")),
    ]


def _new_references(fraction: float | None) -> list[Entry]:
    if fraction is None:
        return []
    condition = (
        f"when fewer than {100 * fraction:g} % of the usual points agree with the reference" if fraction else "never"
    )
    return [Entry("new reference image", condition, "displacements are then composed in the initial configuration")]


def _strain_entries(data: ReportData, width: int, spacing: int, window: int) -> list[Entry]:
    if not width:
        return [Entry("strain", "not computed")]
    points = 2 * round((width - 1) / 2 / spacing) + 1
    covered = (points - 1) * spacing
    gauge = covered + window
    return [
        Entry("strain window", f"{points} points ({covered} px){data.length(covered)}"),
        Entry("virtual strain gauge", f"{gauge} px{data.length(gauge)}", "(L_window - 1) L_step + L_subset"),
        Entry(
            "strain formulation",
            f"Green-Lagrange in the {'image' if data.images_alone else 'tangent plane of the surface'}, from "
            "least-squares planes",
        ),
        Entry("strain post-filter", "none"),
    ]


def _camera_model(rig: dict[str, Any]) -> Entry:
    if not rig:
        return Entry("camera model", None)
    distortion = "with" if rig.get("camera_distortion") else "without"
    return Entry("camera model", f"pin-hole ('{rig['model']}'), {distortion} distortion of the camera")


def fringe_entries(data: ReportData) -> list[Entry]:
    """Return projector, fringes and calibration."""
    rig, phase = data.calibration, data.parameters.get("phase", {})
    projector = data.metadata.hardware.projector or (VIRTUAL if data.simulated else "")
    threshold = phase.get("minimum_modulation_grey_level")
    return [
        entered("projector", projector, "hardware.projector"),
        Entry("resolution", f"{rig['projector_width']} x {rig['projector_height']} px" if rig else None),
        *_pattern_entries(data, phase),
        *_base_entries(rig),
        Entry(
            "modulation threshold",
            None if threshold is None else f"{threshold:g} grey levels above the threshold of the pixel's noise",
        ),
        Entry("phase noise", _phase_noise(data.dataset), "median of the stated standard deviation"),
        *_calibration_entries(data, rig),
    ]


def _pattern_entries(data: ReportData, phase: dict[str, Any]) -> list[Entry]:
    exposures = data.exposures
    if exposures is None or not exposures.pitches:
        return without(("pitches", "frames per pitch", "unwrapping"), "needs the recording")
    return [
        Entry("pitches", ", ".join(f"{pitch:g}" for pitch in exposures.pitches) + " projector px"),
        Entry("frames per pitch", ", ".join(map(str, exposures.shifts)), f"{exposures.orientation} fringes"),
        Entry("phase method", _phase_method(phase.get("method", "steps"), sum(exposures.shifts))),
        Entry("unwrapping", _unwrapping(phase, len(exposures.pitches))),
    ]


def _phase_method(method: str, fringe_images: int) -> str:
    one_image = method == "one_image" or (method == "auto" and fringe_images == 1)
    return "last fringe image alone" if one_image else "phase stepping"


def _unwrapping(phase: dict[str, Any], pitches: int) -> str:
    if pitches > 1:
        return "hierarchical, from coarse to fine"
    if phase.get("relative_phase") == "accept":
        return "spatial: the phase is known except for a constant number of fringes"
    return "none: one fringe covers the view"


def _base_entries(rig: dict[str, Any]) -> list[Entry]:
    if not rig:
        return without(("base camera to projector", "angle"), "no calibration")
    base, angle = base_and_angle(rig)
    degrees = f"{math.degrees(angle):.2f}°"
    return [
        Entry("base camera to projector", f"{1e3 * base:.4g} mm"),
        Entry("angle between camera and projector", degrees, "seen from the origin of the rig"),
    ]


def base_and_angle(rig: dict[str, Any]) -> tuple[float, float]:
    """Return the distance of the two pin-holes [m] and the angle between the lines to the rig's origin [rad].

    Parameters
    ----------
    rig
        ``camera_distance`` and ``projector_position`` [m] of a calibration.

    Examples
    --------
    >>> base, angle = base_and_angle({"camera_distance": 0.3, "projector_position": (0.3, 0.0, 0.3)})
    >>> round(base, 3), round(math.degrees(angle), 1)
    (0.3, 45.0)
    """
    camera, projector = np.array([0.0, 0.0, rig["camera_distance"]]), np.array(rig["projector_position"])
    cosine = camera @ projector / np.linalg.norm(camera) / np.linalg.norm(projector)
    return float(np.linalg.norm(projector - camera)), float(np.arccos(np.clip(cosine, -1, 1)))


def _phase_noise(dataset: xr.Dataset) -> str | None:
    if "phase_sigma" not in dataset:
        return None
    medians = []
    for index in range(dataset.sizes["step"]):
        values = dataset["phase_sigma"].isel(step=index).values
        if np.isfinite(values).any():
            medians.append(float(np.nanmedian(values)))
    return f"{1e3 * float(np.median(medians)):.3g} mrad" if medians else None


def _calibration_entries(data: ReportData, rig: dict[str, Any]) -> list[Entry]:
    if not rig:
        return [Entry("calibration", None, "the recording contains none")]
    known = data.metadata.calibration
    source = f"{rig.get('identifier') or 'without name'}, from {rig.get('source') or 'an unknown source'}"
    exact = rig.get("source") == "virtual_rig"
    note = (
        "the exact parameters of the virtual rig, no calibration was made"
        if exact
        else "nothing was found beside the calibration file"
    )
    response = known.response_fringe
    return [
        Entry("calibration", source, known.verdict),
        *_residual_entries(data, note),
        Entry(
            "response (gamma) residual",
            None if response is None else f"{response:.4f} fringe",
            "not measured" if response is None else "ripple of the calibration's planes",
        ),
        _known_distance(known.checks),
    ]


def _residual_entries(data: ReportData, note: str) -> list[Entry]:
    """Return date and residual of the calibration; the note says why they are missing."""
    known = data.metadata.calibration
    if known.residual_um is None or known.predicted_um is None:
        return [Entry("date of the calibration", known.created or None, note), Entry("plane residual", None, note)]
    held_out = (
        "" if known.held_out_um is None else f"; planes kept out of the fit: {number_text(known.held_out_um, 3)} µm"
    )
    noise = f"noise alone would leave {number_text(known.predicted_um, 3)} µm{held_out}"
    return [
        Entry(
            "date of the calibration",
            f"{datetime.fromisoformat(known.created).astimezone(UTC):%Y-%m-%d %H:%M} UTC",
            _age(data.dataset, known.created),
        ),
        Entry("plane residual", f"{number_text(known.residual_um, 3)} µm RMS", noise),
    ]


def _known_distance(checks: list[CheckMetadata]) -> Entry:
    """Return the latest check of the calibration by a flat plane and a known distance."""
    if not checks:
        return Entry("known-distance check", None, "none was made; `fringedic check` does it")
    last = checks[-1]
    distance, expected = last.distance_mm, last.expected_mm
    found = "no distance measured"
    if distance is not None and expected is not None:
        found = f"{number_text(distance)} mm for {number_text(expected)} mm"
    return Entry("known-distance check", f"{found}, {last.created}", last.verdict)


def _age(dataset: xr.Dataset, created: str) -> str:
    first = str(np.datetime_as_string(dataset["time"].values.min(), unit="s"))
    begin = datetime.fromisoformat(first).replace(tzinfo=UTC)
    return f"{(begin - datetime.fromisoformat(created)).total_seconds() / 3600:.1f} hours before the test"
