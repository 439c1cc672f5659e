"""Entries of a report about the processing: correlation, strain, projector, fringes and calibration."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime
from typing import Any

import numpy as np
import xarray as xr

from fringedic.datasets.quantities import ATTACHMENTS, strain_measure_of
from fringedic.evaluation.elasticity import strain_curve
from fringedic.evaluation.named import EvaluationSettings
from fringedic.evaluation.rates import rates
from fringedic.report.data import ReportData
from fringedic.report.entries import VIRTUAL, Entry, entered, without
from fringedic.surface.strain_measures import TENSORS
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
        *_attachment_entries(data),
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
    window, spacing, method = dic["window"], dic["spacing"], dic.get("method", "dense")
    if not width:
        strain = [Entry("strain", "not computed")]
    else:
        points = 2 * round((width - 1) / 2 / spacing) + 1
        covered = (points - 1) * spacing
        gauge = covered + window
        measure = TENSORS[strain_measure_of(data.dataset)]
        strain = [
            Entry("strain window", f"{points} points ({covered} px){data.length(covered)}"),
            Entry("virtual strain gauge", f"{gauge} px{data.length(gauge)}", "(L_window - 1) L_step + L_subset"),
            Entry(
                "strain formulation",
                f"{measure.title} ({measure.definition}) in the "
                f"{'image' if data.images_alone else 'tangent plane of the surface'}, from least-squares planes; "
                f"{'e_xy' if data.images_alone else 'e_12'} is the tensor shear, half the engineering shear",
            ),
            Entry("strain post-filter", "none"),
        ]
    model = [] if data.images_alone else [_camera_model(data.calibration)]
    fraction = dic.get("rereference_fraction")
    if fraction is None:
        references = []
    else:
        condition = (
            f"when fewer than {100 * fraction:g} % of the usual points agree with the reference"
            if fraction
            else "never"
        )
        references = [
            Entry("new reference image", condition, "displacements are then composed in the initial configuration")
        ]
    return [
        *entries,
        Entry("method", method),
        Entry("subset", f"{window} px{data.length(window)}", "bi-triangular window with the same noise"),
        Entry("step (spacing)", f"{spacing} px{data.length(spacing)}"),
        *(Entry(name, value) for name, value in _CORRELATION.get(method, {}).items()),
        Entry("regularisation", "none beyond the window"),
        *references,
        *filtering,
        *strain,
        *model,
    ]


def _attachment_entries(data: ReportData) -> list[Entry]:
    """Return the files of other programs whose signals are used; without one there is no entry."""
    attached = json.loads(data.dataset.attrs.get(ATTACHMENTS, "{}"))
    files = ", ".join(f"{name} (description: SHA-256 {digest[:12]}...)" for name, digest in attached.items())
    return [Entry("attached files", files, "fringedic attach BAG shows their clocks")] if files else []


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
    exposures = data.exposures
    if exposures is None or not exposures.pitches:
        patterns = without(("pitches", "frames per pitch", "unwrapping"), "needs the recording")
    else:
        method = phase.get("method", "steps")
        fringe_images = sum(exposures.shifts)
        one_image = method == "one_image" or (method == "auto" and fringe_images == 1)
        pitches = len(exposures.pitches)
        if pitches > 1:
            unwrapping = "hierarchical, from coarse to fine"
        elif phase.get("relative_phase") == "accept":
            unwrapping = "spatial: the phase is known except for a constant number of fringes"
        else:
            unwrapping = "none: one fringe covers the view"
        patterns = [
            Entry("pitches", ", ".join(f"{pitch:g}" for pitch in exposures.pitches) + " projector px"),
            Entry("frames per pitch", ", ".join(map(str, exposures.shifts)), f"{exposures.orientation} fringes"),
            Entry("phase method", "last fringe image alone" if one_image else "phase stepping"),
            Entry("unwrapping", unwrapping),
        ]
    if not rig:
        base = without(("base camera to projector", "angle"), "no calibration")
    else:
        distance, angle = base_and_angle(rig)
        degrees = f"{math.degrees(angle):.2f}°"
        base = [
            Entry("base camera to projector", f"{1e3 * distance:.4g} mm"),
            Entry("angle between camera and projector", degrees, "seen from the origin of the rig"),
        ]
    dataset, noise = data.dataset, None
    if "phase_sigma" in dataset:
        medians = []
        for index in range(dataset.sizes["step"]):
            values = dataset["phase_sigma"].isel(step=index).values
            if np.isfinite(values).any():
                medians.append(float(np.nanmedian(values)))
        noise = f"{1e3 * float(np.median(medians)):.3g} mrad" if medians else None
    return [
        entered("projector", projector, "hardware.projector"),
        Entry("resolution", f"{rig['projector_width']} x {rig['projector_height']} px" if rig else None),
        *patterns,
        *base,
        Entry(
            "modulation threshold",
            None if threshold is None else f"{threshold:g} grey levels above the threshold of the pixel's noise",
        ),
        Entry("phase noise", noise, "median of the stated standard deviation"),
        *_motion_entries(data),
        *_calibration_entries(data, rig),
    ]


def _motion_entries(data: ReportData) -> list[Entry]:
    """Return how many steps were measured in motion, at which speed, and the points that this cost."""
    if data.exposures is None or not data.exposures.moving:
        return []
    dataset = data.dataset
    moving = np.isin(dataset["step"].values, data.exposures.moving)
    entries = [Entry("steps measured in motion", f"{moving.sum()} of {moving.size}", "at the middle of their stacks")]
    if "position" in dataset and moving.sum() > 1:
        passed = np.diff(dataset["time"].values[moving].astype("datetime64[ns]")) / np.timedelta64(1, "s")
        speeds = 1e3 * np.diff(dataset["position"].values[moving]) / passed
        entries.append(
            Entry(
                "speed of the crosshead",
                f"{number_text(float(np.nanmedian(speeds)), 3)} mm/s",
                f"{number_text(float(np.nanmin(speeds)), 3)} to {number_text(float(np.nanmax(speeds)), 3)} mm/s "
                "between neighbouring stacks",
            )
        )
    if moving.sum() > 1 and {"sigma_e_22", "reference_step"} <= {*dataset.variables}:
        entries.append(_strain_rate_entry(dataset.isel(step=moving)))
    part, known = dataset["valid_fraction"].values, np.isfinite(dataset["valid_fraction"].values)
    if (known & moving).any() and (known & ~moving).any():
        in_motion, at_rest = (100 * float(np.median(part[known & which])) for which in (moving, ~moving))
        entries.append(
            Entry(
                "points lost to motion",
                f"{at_rest - in_motion:.1f} %",
                f"{in_motion:.1f} % measured, at rest {at_rest:.1f} %",
            )
        )
    return entries


def _strain_rate_entry(moving: xr.Dataset) -> Entry:
    """Return the rate of the mean strain along the load between neighbouring stacks in motion."""
    found = rates(strain_curve(moving).assign(time=moving["time"].variable))
    percent = {name: 100 * found[f"{name}_rate"].values for name in ("e_11", "e_22")}
    if not all(np.isfinite(each).any() for each in percent.values()):
        return Entry("strain rate", None)
    axial = max(percent, key=lambda name: float(np.nanmedian(np.abs(percent[name]))))
    sigma = float(np.nanmedian(100 * found[f"sigma_{axial}_rate"].values))
    low, middle, high = (number_text(float(each), 3) for each in np.nanquantile(percent[axial], [0, 0.5, 1]))
    return Entry(
        f"strain rate ({axial})",
        f"{middle} %/s",
        f"mean of all points; {low} to {high} %/s between neighbouring stacks, standard uncertainty "
        f"{number_text(sigma, 2)} %/s",
    )


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
    if not known.checks:
        distance = Entry("known-distance check", None, "none was made; `fringedic check` does it")
    else:
        last = known.checks[-1]
        found = "no distance measured"
        if last.distance_mm is not None and last.expected_mm is not None:
            found = f"{number_text(last.distance_mm)} mm for {number_text(last.expected_mm)} mm"
        distance = Entry("known-distance check", f"{found}, {last.created}", last.verdict)
    return [
        Entry("calibration", source, known.verdict),
        *_residual_entries(data, note),
        Entry(
            "response (gamma) residual",
            None if response is None else f"{response:.4f} fringe",
            "not measured" if response is None else "ripple of the calibration's planes",
        ),
        distance,
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
    first = str(np.datetime_as_string(data.dataset["time"].values.min(), unit="s"))
    begin = datetime.fromisoformat(first).replace(tzinfo=UTC)
    return [
        Entry(
            "date of the calibration",
            f"{datetime.fromisoformat(known.created).astimezone(UTC):%Y-%m-%d %H:%M} UTC",
            f"{(begin - datetime.fromisoformat(known.created)).total_seconds() / 3600:.1f} hours before the test",
        ),
        Entry("plane residual", f"{number_text(known.residual_um, 3)} µm RMS", noise),
    ]


def changes_text(settings: EvaluationSettings) -> str:
    """Return what a named evaluation changes, for people; empty when that is nothing."""
    words = [f"sensor {settings.sensor}"] if settings.sensor else []
    words += [f"{name} = {value}" for name, value in settings.overrides.items()]
    words += [f"reference step {settings.reference}"] if settings.reference is not None else []
    words += ["another region"] if settings.region else []
    words += ["other extensometers"] if settings.gauges is not None else []
    words += [settings.note] if settings.note else []
    return "; ".join(words)
