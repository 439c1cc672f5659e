"""Sentences of the live view and of the check list for setting up a rig."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fringedic.patterns.pattern import PatternKind
from fringedic.rig_setup.check_list import ItemState, ListedItem, SetupItem
from fringedic.rig_setup.settings_warnings import (
    LARGEST_FEATURE,
    LEAST_RANGE,
    MOST_DARK,
    MOST_SATURATED,
    SMALLEST_FEATURE,
)

LEAST_MODULATION = 0.1  # of the range


class LiveFigures(Protocol):
    """Figures of one frame: `fringedic.rig_setup.live_figures.Figures` or a message ``fringedic_msgs/LiveView``."""

    mean: float
    saturated: float
    dark: float
    histogram: np.ndarray | Sequence[int]
    speckle_size: float
    modulation: float
    noise: float
    full_scale: float


@dataclass(frozen=True)
class LiveEntry:
    """One figure for people.

    Attributes
    ----------
    name, value
        The figure with its unit.
    advice
        "good", or the action that improves it.
    good
        Whether nothing has to be done.
    """

    name: str
    value: str
    advice: str
    good: bool


def live_entries(figures: LiveFigures, kind: PatternKind) -> list[LiveEntry]:
    """Return the figures that matter while a pattern of this kind is shown, each with advice.

    Parameters
    ----------
    figures
        Figures of a frame.
    kind
        White light and fringes cover the surface; other patterns are lines on a dark ground, for which brightness and
        speckle size mean nothing.
    """
    good = figures.saturated <= MOST_SATURATED
    advice = "good" if good else "shorten the exposure, close the aperture or reduce reflections"
    entries = [LiveEntry("saturated", f"{100 * figures.saturated:.2f} % of the pixels", advice, good)]
    if kind in (PatternKind.WHITE, PatternKind.FRINGES):
        cumulated = np.cumsum(np.asarray(figures.histogram, np.int64))
        bright = float(np.searchsorted(cumulated, 0.99 * cumulated[-1])) / (len(figures.histogram) - 1)
        good = bright >= LEAST_RANGE
        size = figures.speckle_size
        advice = f"good ({SMALLEST_FEATURE:g} to {LARGEST_FEATURE:g} px)"
        if math.isnan(size):
            advice = "no pattern is visible: focus the camera, or apply a pattern to the surface"
        elif size < SMALLEST_FEATURE:
            advice = f"below {SMALLEST_FEATURE:g} px they alias: move the camera closer, or apply a coarser pattern"
        elif size > LARGEST_FEATURE:
            advice = (
                f"above {LARGEST_FEATURE:g} px they reduce the resolution: move the camera away, or apply a finer "
                "pattern"
            )
        entries += [
            LiveEntry(
                "brightness",
                f"mean {figures.mean:.0f} of {figures.full_scale:.0f}, brightest {100 * bright:.0f} % of the range",
                "good" if good else "add light, use a longer exposure or open the aperture",
                good,
            ),
            LiveEntry(
                "black",
                f"{100 * figures.dark:.2f} % of the pixels",
                "good" if figures.dark <= MOST_DARK else "add light, or raise the black level of the camera",
                figures.dark <= MOST_DARK,
            ),
            LiveEntry("speckles", _known(size, f"{size:.1f} px"), advice, SMALLEST_FEATURE <= size <= LARGEST_FEATURE),
        ]
    if kind == PatternKind.FRINGES:
        good = figures.modulation >= LEAST_MODULATION * figures.full_scale
        entries.append(
            LiveEntry(
                "fringes",
                _known(figures.modulation, f"amplitude {figures.modulation:.1f} grey levels"),
                "good" if good else "focus the projector, reduce the room light or show wider fringes",
                good,
            )
        )
    still = math.isfinite(figures.noise)
    ratio = figures.mean / max(figures.noise, 1e-9)
    return [
        *entries,
        LiveEntry(
            "noise",
            _known(figures.noise, f"{figures.noise:.2f} grey levels, {ratio:.0f} times below the mean"),
            "good" if still else "the image moves: keep rig and specimen still",
            still,
        ),
    ]


def _known(value: float, text: str) -> str:
    return text if math.isfinite(value) else "not known"


TITLES = {
    SetupItem.AXES: "Aim camera and projector",
    SetupItem.CAMERA_FOCUS: "Focus and exposure of the camera",
    SetupItem.PROJECTOR_FOCUS: "Focus of the projector",
    SetupItem.TIMING: "Timing of the projector",
    SetupItem.RESPONSE: "Response curve",
    SetupItem.CALIBRATE: "Calibration",
    SetupItem.CHECK: "Check of the calibration",
    SetupItem.REGION: "Region to be measured",
    SetupItem.NOISE: "Noise floor",
    SetupItem.ADVISE: "Recommended settings",
}
_FIRST = {
    SetupItem.AXES: "Show the crosshair, and turn camera and projector until both axes meet on the specimen.",
    SetupItem.CAMERA_FOCUS: "Show white light, turn the focus ring to the best focus, and set the exposure without "
    "saturated pixels.",
    SetupItem.PROJECTOR_FOCUS: "Show the focus lines, and turn the lens of the projector to the best focus.",
    SetupItem.TIMING: "Measure the delay of the projector, and use the recommended exposure and settle time.",
    SetupItem.RESPONSE: "Measure the response of the projector to grey levels, and use its curve.",
    SetupItem.CALIBRATE: "Print the grid, lay it on the reference plane, start, and follow the instructions.",
    SetupItem.CHECK: "Measure the reference plane and a gauge block, to see that the calibration is valid.",
    SetupItem.REGION: "Mount the specimen, and draw the part of the image that is to be measured.",
    SetupItem.NOISE: "Measure steps with the specimen at rest, before the test.",
    SetupItem.ADVISE: "Take three images at rest, and use the recommended window.",
}


def next_sentence(item: ListedItem) -> str:
    """Return what to do next about an item."""
    if item.state is ItemState.NOT_DONE:
        return _FIRST[item.item]
    present = "; ".join(item.present)
    if item.state is ItemState.DONE:
        return f"Nothing to do. In the rig file: {present}." if present else "Nothing to do."
    if item.state is ItemState.NOT_IN_USE:
        return f"Use this result: the rig file still has {present}."
    if item.state is ItemState.FAILED:
        return "The calibration did not pass it: calibrate again, and then repeat it."
    if not item.superseded_by:
        return f"Repeat it, because the rig file now has {present}."
    later = " and ".join(TITLES[each].lower() for each in item.superseded_by)
    return f"Repeat it, because {later} was done later."
