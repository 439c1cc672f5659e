"""The figures of the live view in words, bars and large digits, for a terminal that is read from some metres away."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from fringedic_msgs.msg import LiveView

SMALLEST_SPECKLE, LARGEST_SPECKLE = 3.0, 7.0  # [px]
SATURATED, DARK = 0.005, 0.01  # shares of the pixels that do harm
BRIGHT = 0.5  # of the range, that the brightest hundredth of the pixels should reach
MODULATED = 0.1  # of the range
SPARKS = " ▁▂▃▄▅▆▇█"
BAR = 40
DIGITS = {
    "0": ("███", "█ █", "█ █", "█ █", "███"),
    "1": (" █ ", "██ ", " █ ", " █ ", "███"),
    "2": ("███", "  █", "███", "█  ", "███"),
    "3": ("███", "  █", "███", "  █", "███"),
    "4": ("█ █", "█ █", "███", "  █", "  █"),
    "5": ("███", "█  ", "███", "  █", "███"),
    "6": ("███", "█  ", "███", "█ █", "███"),
    "7": ("███", "  █", "  █", "  █", "  █"),
    "8": ("███", "█ █", "███", "█ █", "███"),
    "9": ("███", "█ █", "███", "  █", "███"),
    "-": ("   ", "   ", "███", "   ", "   "),
    "%": ("█ █", "  █", " █ ", "█  ", "█ █"),
}


class Pattern(StrEnum):
    """What the projector shows while a person looks."""

    WHITE = "white"
    FRINGES = "fringes"
    FOCUS = "focus"
    CROSSHAIR = "crosshair"


@dataclass(frozen=True)
class Line:
    """One figure in words: what it is, its value, and what to do when it is not good."""

    name: str
    value: str
    verdict: str
    good: bool


def words(figures: LiveView, pattern: Pattern) -> list[Line]:
    """Return the figures of a frame as lines for people: brightness, pattern, fringes and noise."""
    full_scale = figures.full_scale
    over_the_surface = pattern in (Pattern.WHITE, Pattern.FRINGES)
    bright = _percentile(figures.histogram, 0.99)
    lines = [
        Line(
            "saturated",
            f"{100 * figures.saturated:.2f} % of the pixels",
            "good" if figures.saturated <= SATURATED else "expose less, close the aperture, or turn reflections away",
            figures.saturated <= SATURATED,
        )
    ]
    if over_the_surface:
        lines += [
            Line(
                "brightness",
                f"mean {figures.mean:.0f} of {full_scale:.0f}, brightest {100 * bright:.0f} % of the range",
                "good" if bright >= BRIGHT else "more light, a longer exposure or a wider aperture",
                bright >= BRIGHT,
            ),
            Line(
                "black",
                f"{100 * figures.dark:.2f} % of the pixels",
                "good" if figures.dark <= DARK else "more light, or raise the camera's black level",
                figures.dark <= DARK,
            ),
            _speckles(figures.speckle_size),
        ]
    if pattern is Pattern.FRINGES:
        good = figures.modulation >= MODULATED * full_scale
        lines.append(
            Line(
                "fringes",
                _known(figures.modulation, f"amplitude {figures.modulation:.1f} grey levels"),
                "good" if good else "sharpen the projector, open less of the room's light, or show wider fringes",
                good,
            )
        )
    still = math.isfinite(figures.noise)
    lines.append(
        Line(
            "noise",
            _known(
                figures.noise,
                f"{figures.noise:.2f} grey levels, {figures.mean / max(figures.noise, 1e-9):.0f} times below the mean",
            ),
            "good" if still else "something moves: hold the rig still",
            still,
        )
    )
    return lines


def drawing(figures: LiveView, pattern: Pattern, title: str) -> RenderableType:
    """Return what a terminal shows, to be read from some metres away."""
    focus = figures.focus
    digits = Text(_large("-" if math.isnan(focus) else f"{100 * focus:.0f}%"), style="bold")
    digits.stylize("green" if focus >= 0.95 else "yellow")
    table = Table.grid(padding=(0, 2))
    for line in words(figures, pattern):
        colour = "green" if line.good else "bold red"
        table.add_row(Text(line.name.upper(), style="bold"), line.value, Text(line.verdict, style=colour))
    return Group(
        Text(title, style="dim"),
        Text("\nFOCUS of the best so far"),
        digits,
        Text(_bar(focus)),
        Text("\nGREY LEVELS"),
        Text(sparkline(figures.histogram)),
        Text(f"0{str(round(figures.full_scale)).rjust(2 * BAR - 1)}\n", style="dim"),
        table,
        Text("\nCtrl-C ends", style="dim"),
    )


def block(figures: LiveView, pattern: Pattern, title: str) -> str:
    """Return the same as plain lines, without colours."""
    focus = "-" if math.isnan(figures.focus) else f"{100 * figures.focus:.0f} %"
    lines = [title, f"{'focus':11s} {focus} of best", f"{'histogram':11s} [{sparkline(figures.histogram)}]"]
    lines += [f"{line.name:11s} {line.value}: {line.verdict}" for line in words(figures, pattern)]
    return "\n".join(lines)


def sparkline(histogram: Sequence[int], width: int = 2 * BAR) -> str:
    """Return a histogram as one line of blocks; the square root keeps what is rare visible."""
    classes = len(histogram)
    sums = [sum(histogram[k * classes // width : (k + 1) * classes // width]) for k in range(width)]
    highest = max(sums) or 1
    return "".join(SPARKS[math.ceil((len(SPARKS) - 1) * math.sqrt(each / highest))] for each in sums)


class Rate:
    """Frames per second over the latest frames."""

    def __init__(self) -> None:
        self._times: list[float] = []

    def tick(self) -> float:
        """Count a frame and return the rate [1/s]; NaN for the first."""
        self._times = [*self._times[-10:], time.monotonic()]
        passed = self._times[-1] - self._times[0]
        return (len(self._times) - 1) / passed if passed > 0 else math.nan


def _speckles(size: float) -> Line:
    good = SMALLEST_SPECKLE <= size <= LARGEST_SPECKLE
    verdict = f"good ({SMALLEST_SPECKLE:g} to {LARGEST_SPECKLE:g} px)"
    if math.isnan(size):
        verdict = "no pattern is seen: sharpen the camera, or put a pattern on the surface"
    elif size < SMALLEST_SPECKLE:
        verdict = f"below {SMALLEST_SPECKLE:g} px they alias: go closer, or spray a coarser pattern"
    elif size > LARGEST_SPECKLE:
        verdict = f"above {LARGEST_SPECKLE:g} px they waste resolution: go farther away, or spray a finer pattern"
    return Line("speckles", _known(size, f"{size:.1f} px"), verdict, good)


def _known(value: float, text: str) -> str:
    return text if math.isfinite(value) else "not known"


def _percentile(histogram: Sequence[int], share: float) -> float:
    """Part of the range, 0 to 1, under which a share of the pixels lies."""
    wanted, seen = share * sum(histogram), 0
    for number, pixels in enumerate(histogram):
        seen += pixels
        if seen >= wanted:
            return number / (len(histogram) - 1)
    return 1.0


def _large(text: str) -> str:
    rows = ["  ".join("".join(2 * cell for cell in DIGITS[sign][row]) for sign in text) for row in range(5)]
    return "\n".join(f"  {row}" for row in rows)


def _bar(share: float) -> str:
    full = 0 if math.isnan(share) else round(2 * BAR * min(share, 1.0))
    return "█" * full + "░" * (2 * BAR - full)
