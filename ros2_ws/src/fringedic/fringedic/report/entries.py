"""Entries of a report about specimen and hardware: each has a value, or is listed as missing.

The list follows the Good Practices Guide for Digital Image Correlation of the International Digital Image Correlation
Society (edition 2, doi 10.58720/idics/gpg.ed2), with an additional part on the fringes; conformity is not claimed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fringedic.metadata import FIRST_STEP
from fringedic.report.data import ReportData
from fringedic.wording.numbers import number_text

MISSING = "not known"
VIRTUAL = "virtual rig (simulated)"


@dataclass(frozen=True)
class Entry:
    """One line of a report.

    Attributes
    ----------
    name
        The quantity or property.
    value
        Its value with the unit, None if it is missing.
    note
        Where the value comes from, or how to enter it.
    """

    name: str
    value: str | None
    note: str = ""


def entered(name: str, value: str | None, key: str) -> Entry:
    """Return the entry of something that a person enters, with the key if it is missing."""
    return Entry(name, value or None, "" if value else f"enter {key} in the rig file")


def without(names: tuple[str, ...], note: str) -> list[Entry]:
    """Return missing entries with the same note."""
    return [Entry(name, None, note) for name in names]


def specimen_entries(data: ReportData) -> list[Entry]:
    """Return the specimen and the corrections of its force."""
    specimen = data.metadata.specimen
    section, tare = specimen.section_mm2, specimen.force_tare_newton
    return [
        entered("specimen", specimen.name, "specimen.name"),
        entered("material", specimen.material, "specimen.material"),
        entered("section", None if section is None else f"{section:g} mm²", "specimen.section_mm2"),
        entered("operator", specimen.operator, "specimen.operator"),
        entered("notes", specimen.notes, "specimen.notes"),
        *(Entry(name, f"{value:g}" if isinstance(value, float) else value) for name, value in specimen.entries.items()),
        Entry("force tare", "mean reading of the first step" if tare == FIRST_STEP else f"{tare:g} N"),
        Entry(
            "sign of the load cell", "tension positive" if specimen.force_sign == 1 else "tension negative, inverted"
        ),
    ]


def hardware_entries(data: ReportData) -> list[Entry]:
    """Return camera, lens, light, view, exposure, texture and calibration target."""
    hardware = data.metadata.hardware
    focal = hardware.focal_length_mm
    rig, scale, size = data.calibration, data.pixel_size, data.image_size
    if scale is None or size is None:
        note = "give the scale by --pixel-size-mm" if data.images_alone else "no calibration"
        view = without(("field of view", "image scale", "stand-off"), note)
    else:
        width, height = 1e3 * scale / rig.get("pixel_aspect", 1.0) * size[0], 1e3 * scale * size[1]
        origin = "from the calibration" if rig else "as entered"
        stand_off = f"{1e3 * rig['camera_distance']:.4g} mm" if rig else None
        view = [
            Entry("field of view", f"{width:.4g} x {height:.4g} mm", f"on the reference plane, {origin}"),
            Entry("image scale", f"{1e-3 / scale:.4g} px/mm ({1e6 * scale:.4g} µm/px)", origin),
            Entry("stand-off", stand_off, origin if rig else "not known of images alone"),
        ]
    exposures = data.exposures
    time_ms = data.camera.get("exposure_ms") if exposures is None else 1e3 * exposures.exposure_time
    exposure = [Entry("exposure time", None if time_ms is None else f"{time_ms:.4g} ms")]
    if exposures is None:
        exposure += without(("acquisition rate", "lost frames"), "needs the recording")
    else:
        frames = "one frame per step" if exposures.frames == 1 else f"{exposures.frames} frames per step"
        rate = "" if math.isnan(exposures.frame_rate) else f", {exposures.frame_rate:.3g} frames/s within a step"
        exposure += [Entry("acquisition rate", frames + rate), Entry("lost frames", str(exposures.dropped))]
    advice, dataset = data.advice, data.dataset
    texture = [entered("patterning technique", data.metadata.specimen.pattern, "specimen.pattern")]
    if advice is None:
        note = "needs two steps at rest and the recorded textures"
        texture += without(("feature size", "image noise", "coverage"), note)
    else:
        feature = float(np.nanmean(advice.feature_size))
        frames = "" if data.exposures is None else f" of {data.exposures.frames} frames"
        level = dataset["texture"].attrs.get("units", "grey level") if "texture" in dataset else "grey level"
        texture += [
            Entry(
                "feature size",
                f"{feature:.2f} px{data.length(feature)}",
                "half-height width of the texture's autocorrelation",
            ),
            Entry("image noise", f"{number_text(advice.image_noise, 3)} {level}", f"of the texture, the mean{frames}"),
            Entry("contrast", f"{number_text(advice.contrast, 3)} {level}", "standard deviation of the texture"),
            Entry("mean gradient", f"{number_text(advice.mean_gradient, 3)} {level}/px"),
            Entry("coverage", f"{100 * advice.coverage:.0f} % dark"),
        ]
    return [
        entered("camera", hardware.camera or (VIRTUAL if data.simulated else ""), "hardware.camera"),
        Entry("image resolution", None if data.image_size is None else "{} x {} px".format(*data.image_size)),
        entered("lens", hardware.lens, "hardware.lens"),
        entered("focal length", None if focal is None else f"{focal:g} mm", "hardware.focal_length_mm"),
        entered("aperture", hardware.aperture, "hardware.aperture"),
        entered("filters", hardware.filters, "hardware.filters"),
        entered("lighting", hardware.lighting, "hardware.lighting"),
        *view,
        *exposure,
        *texture,
        entered("calibration target", hardware.calibration_target, "hardware.calibration_target"),
    ]
