"""Sentences of the live view for known figures."""

from __future__ import annotations

from math import nan

import numpy as np
import pytest

from fringedic.patterns.pattern import PatternKind
from fringedic.rig_setup.live_figures import Figures
from fringedic.rig_setup.live_sentences import live_entries

HISTOGRAM = np.zeros(256, np.uint32)
HISTOGRAM[40:200] = 100
GOOD = {
    "region": (0, 0, 640, 480),
    "focus": 0.874,
    "mean": 120.0,
    "saturated": 0.0,
    "dark": 0.0,
    "histogram": HISTOGRAM,
    "speckle_size": 4.2,
    "modulation": 60.0,
    "noise": 1.8,
    "full_scale": 255.0,
}


def figures(**changes: float | np.ndarray) -> Figures:
    """Figures of a good view of 8 bits, grey levels from 40 to 200, with these changes."""
    return Figures(**(GOOD | changes))  # type: ignore[arg-type]


def test_a_good_view_needs_nothing() -> None:
    entries = live_entries(figures(), PatternKind.FRINGES)
    assert [entry.name for entry in entries] == ["saturated", "brightness", "black", "speckles", "fringes", "noise"]
    assert all(entry.good for entry in entries)
    assert entries[1].value == "mean 120 of 255, brightest 78 % of the range"
    assert entries[3].value == "4.2 px"
    assert entries[3].advice == "good (3 to 7 px)"


@pytest.mark.parametrize(
    ("changes", "name", "advice"),
    [
        ({"saturated": 0.02}, "saturated", "shorten the exposure"),
        ({"dark": 0.3}, "black", "add light"),
        ({"speckle_size": 1.9}, "speckles", "alias"),
        ({"speckle_size": 12.0}, "speckles", "finer pattern"),
        ({"speckle_size": nan}, "speckles", "no pattern"),
        ({"modulation": 9.0}, "fringes", "focus the projector"),
        ({"noise": nan}, "noise", "the image moves"),
        ({"full_scale": 4095.0, "modulation": 900.0}, "", ""),
    ],
)
def test_each_bad_figure_has_an_action(changes: dict[str, float], name: str, advice: str) -> None:
    bad = [entry for entry in live_entries(figures(**changes), PatternKind.FRINGES) if not entry.good]
    assert [entry.name for entry in bad] == ([name] if name else [])
    assert all(advice in entry.advice for entry in bad)


def test_dark_image_needs_light() -> None:
    histogram = np.repeat(np.uint32([1000, 0]), [60, 196])
    entries = live_entries(figures(histogram=histogram), PatternKind.WHITE)
    assert any("longer exposure" in entry.advice for entry in entries if not entry.good)


def test_lines_on_a_dark_ground_need_no_light() -> None:
    dark = figures(dark=0.5, speckle_size=nan, mean=5.0)
    assert all(entry.good for entry in live_entries(dark, PatternKind.OTHER))
