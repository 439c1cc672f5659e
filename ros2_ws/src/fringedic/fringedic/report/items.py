"""The facts that a report must tell, each known or named as missing.

The list follows what is known of the Good Practices Guide for Digital Image Correlation of the International Digital
Image Correlation Society (edition 2, doi 10.58720/idics/gpg.ed2), with a part on the fringes; conformity is not
claimed.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
import xarray as xr

from fringedic.advice import Advice
from fringedic.facts import NoiseFacts
from fringedic.report.recorded import Exposures

MISSING = "not known"
_CORRELATION = {
    "dense": {
        "matching criterion": "sum of squared grey-level differences, weighted by the window; gain and offset fitted",
        "shape function": "the displacement itself, smoothed, warps the image (no polynomial per subset)",
        "interpolant": "six pixels of the deformed image: quintic B-spline, its 2nd and 4th derivative, prefiltered",
    },
    "zoi": {
        "matching criterion": "amplitude-weighted phase differences of the zones' spectra",
        "shape function": "translation of each zone",
        "interpolant": "none: windows move by whole pixels, phases give the rest",
    },
}


@dataclass(frozen=True)
class Item:
    """One line of a report.

    Attributes
    ----------
    name
        What it is.
    value
        The value with its unit, None when it is not known.
    note
        Where it comes from, or how to make it known.
    """

    name: str
    value: str | None
    note: str = ""


@dataclass(frozen=True)
class Known:
    """Everything that a report may draw on.

    Attributes
    ----------
    dataset
        The experiment.
    exposures
        From the recording, None without one.
    advice
        What the static images tell about the texture, None without them.
    """

    dataset: xr.Dataset
    exposures: Exposures | None
    advice: Advice | None

    def attribute(self, name: str) -> Any:
        """Return an attribute of the dataset, unpacked; an empty dict when it is not there."""
        return json.loads(self.dataset.attrs.get(name, "{}"))

    @property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """Parameters of the processing nodes at the last step."""
        recorded = self.attribute("parameters")
        return dict(recorded[-1]["parameters"]) if recorded else {}

    @property
    def specimen(self) -> dict[str, Any]:
        """Facts of the specimen."""
        return dict(self.attribute("facts").get("specimen", {}))

    @property
    def hardware(self) -> dict[str, Any]:
        """Facts of the hardware."""
        return dict(self.attribute("facts").get("hardware", {}))

    @property
    def noise(self) -> NoiseFacts:
        """The noise floor that was measured before the experiment; empty when none was."""
        return NoiseFacts.model_validate(self.attribute("facts").get("noise", {}))

    @property
    def node(self) -> dict[str, dict[str, Any]]:
        """Parameters of the other nodes."""
        return dict(self.attribute("rig"))

    @property
    def simulated(self) -> bool:
        """Whether a virtual rig took the place of camera and projector."""
        return self.node.get("camera", {}).get("source") == "virtual"


def specimen_items(known: Known) -> list[Item]:
    """Return what the specimen is and how its load is counted."""
    facts = known.specimen
    section = facts.get("section_mm2")
    tare = facts.get("force_tare_newton", 0.0)
    return [
        _entered("specimen", facts.get("name"), "specimen.name"),
        _entered("material", facts.get("material"), "specimen.material"),
        _entered("section", None if section is None else f"{section:g} mm²", "specimen.section_mm2"),
        _entered("operator", facts.get("operator"), "specimen.operator"),
        _entered("notes", facts.get("notes"), "specimen.notes"),
        Item("force tare", "mean reading of the first step" if tare == "first_step" else f"{tare:g} N"),
        Item(
            "sign of the load cell",
            "tension positive" if facts.get("force_sign", 1) == 1 else "tension negative, turned",
        ),
    ]


def hardware_items(known: Known) -> list[Item]:
    """Return camera, lens, light, and what the camera sees."""
    facts, rig = known.hardware, known.attribute("calibration")
    camera = facts.get("camera") or ("virtual rig (simulated)" if known.simulated else "")
    focal = facts.get("focal_length_mm")
    items = [
        _entered("camera", camera, "hardware.camera"),
        Item("image resolution", f"{rig['camera_width']} x {rig['camera_height']} px" if rig else None),
        _entered("lens", facts.get("lens"), "hardware.lens"),
        _entered("focal length", None if focal is None else f"{focal:g} mm", "hardware.focal_length_mm"),
        _entered("aperture", facts.get("aperture"), "hardware.aperture"),
        _entered("filters", facts.get("filters"), "hardware.filters"),
        _entered("lighting", facts.get("lighting"), "hardware.lighting"),
    ]
    if rig:
        scale, across = rig["pixel_size"], rig["pixel_size"] / rig["pixel_aspect"]
        width, height = 1e3 * across * rig["camera_width"], 1e3 * scale * rig["camera_height"]
        items += [
            Item("field of view", f"{width:.4g} x {height:.4g} mm", "on the reference plane, from the calibration"),
            Item("image scale", f"{1e-3 / scale:.4g} px/mm ({1e6 * scale:.4g} µm/px)", "from the calibration"),
            Item("stand-off", f"{1e3 * rig['camera_distance']:.4g} mm", "from the calibration"),
        ]
    else:
        items += [Item(name, None, "no calibration") for name in ("field of view", "image scale", "stand-off")]
    return [*items, *_exposure_items(known), *_texture_items(known), _target(known)]


def _exposure_items(known: Known) -> list[Item]:
    exposures = known.exposures
    time = known.node.get("camera", {}).get("exposure_time_s") if exposures is None else exposures.exposure_time
    items = [Item("exposure time", None if time is None else f"{1e3 * time:.4g} ms")]
    if exposures is None:
        return [*items, *(Item(name, None, "only the recording tells") for name in ("acquisition rate", "lost frames"))]
    frames = "one frame per step" if exposures.frames == 1 else f"{exposures.frames} frames per step"
    rate = (
        frames if math.isnan(exposures.frame_rate) else f"{frames}, {exposures.frame_rate:.3g} frames/s within a step"
    )
    return [*items, Item("acquisition rate", rate), Item("lost frames", str(exposures.dropped))]


def _texture_items(known: Known) -> list[Item]:
    advice, dataset = known.advice, known.dataset
    pattern = _entered("patterning technique", known.specimen.get("pattern"), "specimen.pattern")
    if advice is None:
        hint = "needs two static steps and the recorded textures"
        return [
            pattern,
            Item("feature size", None, hint),
            Item("image noise", None, hint),
            Item("coverage", None, hint),
        ]
    size = float(np.nanmean(advice.feature_size))
    rig = known.attribute("calibration")
    length = f" ({1e3 * rig['pixel_size'] * size:.3g} mm)" if rig else ""
    frames = "" if known.exposures is None else f" of {known.exposures.frames} frames"
    level = dataset["texture"].attrs.get("units", "grey level") if "texture" in dataset else "grey level"
    return [
        pattern,
        Item("feature size", f"{size:.2f} px{length}", "half-height width of the texture's autocorrelation"),
        Item("image noise", f"{advice.image_noise:.3g} {level}", f"of the texture, the mean{frames}"),
        Item("contrast", f"{advice.contrast:.3g} {level}", "standard deviation of the texture"),
        Item("mean gradient", f"{advice.mean_gradient:.3g} {level}/px"),
        Item("coverage", f"{100 * advice.coverage:.0f} % dark"),
    ]


def _target(known: Known) -> Item:
    return _entered("calibration target", known.hardware.get("calibration_target"), "hardware.calibration_target")


def analysis_items(known: Known) -> list[Item]:
    """Return how displacement and strain were computed."""
    attributes, nodes = known.dataset.attrs, known.parameters
    dic, coupling = nodes.get("dic", {}), nodes.get("coupling", {})
    items = [
        Item("software", attributes.get("software")),
        Item("commit", attributes.get("commit")),
        Item("image filtering", "none before the correlation"),
    ]
    if not dic:
        return [*items, Item("settings of the correlation", None, "the dataset tells no parameters")]
    window, step = dic["window"], dic["spacing"]
    method = dic.get("method", "dense")
    items += [
        Item("method", method),
        Item("subset", f"{window} px{_length(known, window)}", "bi-triangular window with the same noise"),
        Item("step (spacing)", f"{step} px{_length(known, step)}"),
        *(Item(name, value) for name, value in _CORRELATION.get(method, {}).items()),
        Item("regularisation", "none beyond the window"),
        *_rereferencing(dic.get("rereference_fraction")),
    ]
    z_filter = coupling.get("z_filter_px")
    if z_filter is not None:
        smoothed = f"Gaussian, {z_filter:g} px standard deviation" if z_filter else "none"
        items.append(Item("filter of the heights before their difference", smoothed))
    strain = coupling.get("strain_window_px", 0)
    if strain:
        points = 2 * round((strain - 1) / 2 / step) + 1
        gauge = (points - 1) * step + window
        items += [
            Item("strain window", f"{points} points ({(points - 1) * step} px){_length(known, (points - 1) * step)}"),
            Item("virtual strain gauge", f"{gauge} px{_length(known, gauge)}", "(L_window - 1) L_step + L_subset"),
            Item("strain formulation", "Green-Lagrange in the tangent plane of the surface, from least-squares planes"),
            Item("strain post-filter", "none"),
        ]
    else:
        items.append(Item("strain", "not computed"))
    rig = known.attribute("calibration")
    distortion = "with" if rig.get("camera_distortion") else "without"
    model = f"pin-hole ('{rig['model']}'), {distortion} distortion of the camera" if rig else None
    return [*items, Item("camera model", model)]


def _rereferencing(fraction: float | None) -> list[Item]:
    if fraction is None:
        return []
    below = (
        f"when fewer than {100 * fraction:g} % of the usual points agree with the reference" if fraction else "never"
    )
    return [Item("new reference image", below, "displacements are then composed in the initial configuration")]


def fringe_items(known: Known) -> list[Item]:
    """Return projector, fringes and calibration."""
    rig, exposures, phase = known.attribute("calibration"), known.exposures, known.parameters.get("phase", {})
    projector = known.hardware.get("projector") or ("virtual rig (simulated)" if known.simulated else "")
    items = [_entered("projector", projector, "hardware.projector")]
    items.append(Item("resolution", f"{rig['projector_width']} x {rig['projector_height']} px" if rig else None))
    if exposures is None or not exposures.pitches:
        items += [
            Item(name, None, "only the recording tells") for name in ("pitches", "frames per pitch", "unwrapping")
        ]
    else:
        items += [
            Item("pitches", ", ".join(f"{pitch:g}" for pitch in exposures.pitches) + " projector px"),
            Item("frames per pitch", ", ".join(map(str, exposures.shifts)), f"{exposures.orientation} fringes"),
            Item("phase method", _phase_method(phase.get("method", "steps"), sum(exposures.shifts))),
            Item("unwrapping", _unwrapping(phase, len(exposures.pitches))),
        ]
    if rig:
        base, angle = base_and_angle(rig)
        items += [
            Item("base camera to projector", f"{1e3 * base:.4g} mm"),
            Item(
                "angle between camera and projector", f"{math.degrees(angle):.2f}°", "seen from the origin of the rig"
            ),
        ]
    else:
        items += [Item(name, None, "no calibration") for name in ("base camera to projector", "angle")]
    threshold = phase.get("minimum_modulation_grey_level")
    beyond = "" if threshold is None else f"{threshold:g} grey levels beyond what the noise of the pixel asks for"
    items.append(Item("modulation threshold", beyond or None))
    items.append(Item("phase noise", _phase_noise(known.dataset), "median of the stated standard deviation"))
    return [*items, *_calibration_items(known, rig)]


def _phase_method(method: str, fringe_images: int) -> str:
    one_image = method == "one_image" or (method == "auto" and fringe_images == 1)
    return "last fringe image alone" if one_image else "phase stepping"


def _unwrapping(phase: dict[str, Any], pitches: int) -> str:
    if pitches > 1:
        return "hierarchical, from coarse to fine"
    if phase.get("relative_phase") == "accept":
        return "spatial: the phase is true up to whole fringes only"
    return "none: one fringe covers the view"


def _calibration_items(known: Known, rig: dict[str, Any]) -> list[Item]:
    if not rig:
        return [Item("calibration", None, "the recording holds none")]
    facts = known.attribute("facts").get("calibration", {})
    exact = rig.get("source") == "virtual_rig"
    given = "the exact parameters of the virtual rig, no calibration was made" if exact else ""
    hint = given or "nothing was found beside the calibration file"
    source = f"{rig.get('identifier') or 'without name'}, from {rig.get('source') or 'an unknown source'}"
    created, residual = facts.get("created"), facts.get("residual_um")
    items = [
        Item("calibration", source, facts.get("verdict", "")),
        Item("date of the calibration", created or None, hint),
    ]
    if residual is None:
        items.append(Item("plane residual", None, hint))
    else:
        held_out = facts.get("held_out_um")
        kept = "" if held_out is None else f"; planes kept out of the fit: {held_out:.3g} µm"
        noise = f"noise alone would leave {facts['predicted_um']:.3g} µm{kept}"
        items[-1] = Item("date of the calibration", created, _age(known.dataset, created))
        items.append(Item("plane residual", f"{residual:.3g} µm RMS", noise))
    response = facts.get("response_fringe")
    left = None if response is None else f"{response:.4f} fringe"
    return [
        *items,
        Item("response (gamma) residual", left, "ripple of the calibration's planes" if left else "not measured"),
        _known_distance(facts.get("checks", [])),
    ]


def _known_distance(checks: list[dict[str, Any]]) -> Item:
    """The latest check of the calibration by a flat plane and a known distance."""
    if not checks:
        return Item("known-distance check", None, "none was made; `fringedic check` does it")
    last = checks[-1]
    expected, measured = last.get("expected_mm"), last.get("distance_mm")
    found = "no distance measured" if measured is None else f"{measured:.4g} mm for {expected:.4g} mm"
    return Item("known-distance check", f"{found}, {last['created']}", last["verdict"])


def _age(dataset: xr.Dataset, created: str) -> str:
    begin = datetime.fromisoformat(str(np.datetime_as_string(dataset["time"].values.min(), unit="s"))).replace(
        tzinfo=UTC
    )
    return f"{(begin - datetime.fromisoformat(created)).total_seconds() / 3600:.1f} hours before the test"


def base_and_angle(rig: dict[str, Any]) -> tuple[float, float]:
    """Return the distance of the two pin-holes [m] and the angle between the lines to the rig's origin [rad]."""
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


def _length(known: Known, pixels: float) -> str:
    rig = known.attribute("calibration")
    return f" ({1e3 * rig['pixel_size'] * pixels:.3g} mm)" if rig else ""


def _entered(name: str, value: str | None, key: str) -> Item:
    return Item(name, value or None, "" if value else f"enter {key} in the rig file")
