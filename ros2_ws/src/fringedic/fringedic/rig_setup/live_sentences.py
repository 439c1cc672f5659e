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
from fringedic.wording.translation import Sentence, translatable

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
    advice = _advice(good, translatable("shorten the exposure, close the aperture or reduce reflections"))
    entries = [LiveEntry(translatable("saturated"), _share(figures.saturated), advice, good)]
    if kind in (PatternKind.WHITE, PatternKind.FRINGES):
        cumulated = np.cumsum(np.asarray(figures.histogram, np.int64))
        bright = float(np.searchsorted(cumulated, 0.99 * cumulated[-1])) / (len(figures.histogram) - 1)
        good = bright >= LEAST_RANGE
        size = figures.speckle_size
        limits = {"smallest": f"{SMALLEST_FEATURE:g}", "largest": f"{LARGEST_FEATURE:g}"}
        advice = Sentence("good ({smallest} to {largest} px)", **limits)
        if math.isnan(size):
            advice = translatable("no pattern is visible: focus the camera, or apply a pattern to the surface")
        elif size < SMALLEST_FEATURE:
            advice = Sentence(
                "below {smallest} px they alias: move the camera closer, or apply a coarser pattern", **limits
            )
        elif size > LARGEST_FEATURE:
            advice = Sentence(
                "above {largest} px they reduce the resolution: move the camera away, or apply a finer pattern",
                **limits,
            )
        entries += [
            LiveEntry(
                translatable("brightness"),
                Sentence(
                    "mean {mean} of {full_scale}, brightest {brightest} % of the range",
                    mean=f"{figures.mean:.0f}",
                    full_scale=f"{figures.full_scale:.0f}",
                    brightest=f"{100 * bright:.0f}",
                ),
                _advice(good, translatable("add light, use a longer exposure or open the aperture")),
                good,
            ),
            LiveEntry(
                translatable("black"),
                _share(figures.dark),
                _advice(figures.dark <= MOST_DARK, translatable("add light, or raise the black level of the camera")),
                figures.dark <= MOST_DARK,
            ),
            LiveEntry(
                translatable("speckles"),
                _known(size, Sentence("{size} px", size=f"{size:.1f}")),
                advice,
                SMALLEST_FEATURE <= size <= LARGEST_FEATURE,
            ),
        ]
    if kind == PatternKind.FRINGES:
        good = figures.modulation >= LEAST_MODULATION * figures.full_scale
        entries.append(
            LiveEntry(
                translatable("fringes"),
                _known(
                    figures.modulation,
                    Sentence("amplitude {amplitude} grey levels", amplitude=f"{figures.modulation:.1f}"),
                ),
                _advice(good, translatable("focus the projector, reduce the room light or show wider fringes")),
                good,
            )
        )
    still = math.isfinite(figures.noise)
    ratio = figures.mean / max(figures.noise, 1e-9)
    return [
        *entries,
        LiveEntry(
            translatable("noise"),
            _known(
                figures.noise,
                Sentence(
                    "{noise} grey levels, {ratio} times below the mean",
                    noise=f"{figures.noise:.2f}",
                    ratio=f"{ratio:.0f}",
                ),
            ),
            _advice(still, translatable("the image moves: keep rig and specimen still")),
            still,
        ),
    ]


def _known(value: float, text: str) -> str:
    return text if math.isfinite(value) else translatable("not known")


def _share(of_pixels: float) -> str:
    return Sentence("{share} % of the pixels", share=f"{100 * of_pixels:.2f}")


def _advice(good: bool, advice: str) -> str:
    return translatable("good") if good else advice


TITLES = translatable(
    {
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
)
_FIRST = translatable(
    {
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
)


def next_sentence(item: ListedItem) -> str:
    """Return what to do next about an item."""
    if item.state is ItemState.NOT_DONE:
        return _FIRST[item.item]
    present = "; ".join(item.present)
    if item.state is ItemState.DONE:
        return f"Nothing to do. In the rig file: {present}." if present else translatable("Nothing to do.")
    if item.state is ItemState.NOT_IN_USE:
        return f"Use this result: the rig file still has {present}."
    if item.state is ItemState.FAILED:
        return translatable("The calibration did not pass it: calibrate again, and then repeat it.")
    if not item.superseded_by:
        return f"Repeat it, because the rig file now has {present}."
    later = " and ".join(TITLES[each].lower() for each in item.superseded_by)
    return f"Repeat it, because {later} was done later."
