"""The figures of the live view on a terminal that is read from some metres away: words, bars and large digits."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from itertools import islice
from typing import TYPE_CHECKING

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from fringedic.rig_setup.live_sentences import live_entries
from fringedic_bringup.setup_patterns import LivePattern

if TYPE_CHECKING:
    from fringedic_msgs.msg import LiveView

FOCUSED = 0.95  # of the best focus so far
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


def draw_continuously(console: Console, views: Iterable[LiveView], pattern: LivePattern, rig: str) -> None:
    """Draw the figures of each frame in place of those before, until there are no more.

    Parameters
    ----------
    console
        The terminal.
    views
        Figures of one frame after the other.
    pattern
        The projected pattern.
    rig
        Name of the rig, for the title.
    """
    rate, later = _Rate(), iter(views)
    next(later, None)  # noise and motion need two frames
    with Live(console=console, auto_refresh=False, screen=True) as screen:
        for figures in later:
            speed = f"{rate.tick():.1f} frames/s"
            screen.update(drawing(figures, pattern, f"{title(figures, pattern, rig)}, {speed}"), refresh=True)


def print_once(console: Console, views: Iterable[LiveView], pattern: LivePattern, rig: str, *, frames: int) -> None:
    """Print the figures of the last of so many frames; the other parameters as of `draw_continuously`."""
    *_, figures = islice(views, frames)
    console.print(block(figures, pattern, title(figures, pattern, rig)), markup=False, highlight=False)


def title(figures: LiveView, pattern: LivePattern, rig: str) -> str:
    """Return the first line: rig, pattern and region."""
    region = f"{figures.width}x{figures.height} px from column {figures.column}, row {figures.row}"
    return f"{rig}, projector shows {pattern}: {region}"


def drawing(figures: LiveView, pattern: LivePattern, title: str) -> RenderableType:
    """Return the large form for a terminal."""
    focus = figures.focus
    digits = Text(_large("-" if math.isnan(focus) else f"{100 * focus:.0f}%"), style="bold")
    digits.stylize("green" if focus >= FOCUSED else "yellow")
    table = Table.grid(padding=(0, 2))
    for entry in live_entries(figures, pattern.kind):
        colour = "green" if entry.good else "bold red"
        table.add_row(Text(entry.name.upper(), style="bold"), entry.value, Text(entry.advice, style=colour))
    return Group(
        Text(title, style="dim"),
        Text("\nFOCUS relative to the best so far"),
        digits,
        Text(_bar(focus)),
        Text("\nGREY LEVELS"),
        Text(sparkline(figures.histogram)),
        Text(f"0{str(round(figures.full_scale)).rjust(2 * BAR - 1)}\n", style="dim"),
        table,
        Text("\nCtrl-C ends", style="dim"),
    )


def block(figures: LiveView, pattern: LivePattern, title: str) -> str:
    """Return the form without colours: one line per figure."""
    focus = "-" if math.isnan(figures.focus) else f"{100 * figures.focus:.0f} %"
    spark = sparkline(figures.histogram, 2 * BAR - 15)  # with its name and brackets less than 80 columns
    lines = [title, f"{'focus':11s} {focus} of best", f"{'histogram':11s} [{spark}]"]
    entries = live_entries(figures, pattern.kind)
    return "\n".join([*lines, *(f"{entry.name:11s} {entry.value}: {entry.advice}" for entry in entries)])


def sparkline(histogram: Sequence[int], width: int = 2 * BAR) -> str:
    """Return a histogram as one line of blocks; the square root keeps small classes visible."""
    classes = len(histogram)
    sums = [sum(histogram[k * classes // width : (k + 1) * classes // width]) for k in range(width)]
    highest = max(sums) or 1
    return "".join(SPARKS[math.ceil((len(SPARKS) - 1) * math.sqrt(each / highest))] for each in sums)


class _Rate:
    """Frames per second over the latest frames."""

    def __init__(self) -> None:
        self._times: list[float] = []

    def tick(self) -> float:
        """Count a frame and return the rate [1/s]; NaN for the first."""
        self._times = [*self._times[-10:], time.monotonic()]
        passed = self._times[-1] - self._times[0]
        return (len(self._times) - 1) / passed if passed > 0 else math.nan


def _large(text: str) -> str:
    rows = ["  ".join("".join(2 * cell for cell in DIGITS[sign][row]) for sign in text) for row in range(5)]
    return "\n".join(f"  {row}" for row in rows)


def _bar(share: float) -> str:
    full = 0 if math.isnan(share) else round(2 * BAR * min(share, 1.0))
    return "█" * full + "░" * (2 * BAR - full)
