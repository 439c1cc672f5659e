"""The camera's view while a rig is set up: starts what shows, exposes and looks, and draws the figures."""

from __future__ import annotations

import tempfile
from collections.abc import Generator, Sequence
from contextlib import closing
from itertools import count, islice
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.live import Live

from fringedic.errors import RigFileError
from fringedic.rig_file import RigFile
from fringedic.sequence import PatternKind, Projection
from fringedic_bringup.exposing import FRAME_TIMEOUT_S, ExposingClient
from fringedic_bringup.graph import live_graph
from fringedic_bringup.live_display import Pattern, Rate, block, drawing
from fringedic_bringup.processes import RunningGraph
from fringedic_msgs.msg import LiveView
from fringedic_ros.qos import DERIVED
from fringedic_ros.stamps import to_nanoseconds

FRAMES_OF_ONE_LOOK = 8  # two cycles of four shifts


def show_live(rig: RigFile, rig_path: Path, pattern: Pattern, console: Console, *, region: str, once: bool) -> None:
    """Draw what the camera sees until a person ends it; without a terminal, or `once`, print it one time.

    Parameters
    ----------
    rig, rig_path
        The rig file and where it was read.
    pattern
        What the projector shows.
    console
        Where to draw.
    region
        First column, first row, width and height of what is looked at, as "320,240,640,480" [px]; empty: all.
    once
        Print one block of lines and end.

    Raises
    ------
    RigFileError
        The region is no four numbers, or see `watch`.
    """

    def title(figures: LiveView) -> str:
        place = f"{figures.width}x{figures.height} px from column {figures.column}, row {figures.row}"
        return f"{rig_path.stem}, projector shows {pattern}: {place}"

    with closing(watch(rig, rig_path, pattern, region=_four_numbers(region))) as frames:
        if once or not console.is_terminal:
            *_, figures = islice(frames, FRAMES_OF_ONE_LOOK)
            console.print(block(figures, pattern, title(figures)), markup=False, highlight=False)
            return
        rate = Rate()
        with Live(console=console, auto_refresh=False, screen=True) as screen:
            for figures in frames:
                speed = f"{rate.tick():.1f} frames/s"
                screen.update(drawing(figures, pattern, f"{title(figures)}, {speed}"), refresh=True)


def watch(
    rig: RigFile,
    rig_path: Path,
    pattern: Pattern,
    *,
    region: Sequence[int] = (),
    domain: int | None = None,
) -> Generator[LiveView]:
    """Start projector, camera and live view, and yield the figures of one frame after the other without end.

    Parameters
    ----------
    rig, rig_path
        The rig file and where it was read.
    pattern
        What the projector shows.
    region
        First column, first row, width and height of what is looked at [px]; empty: all.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    RigFileError
        Something is to be shown by a rig without projector.
    NodeDiedError, NotAnsweredError, StepFailedError
        The nodes did not start, one of them ended, or a frame could not be taken.
    """
    if rig.projector is None and pattern is not Pattern.WHITE:
        raise RigFileError(f"{rig_path}: has no projector that could show {pattern}")
    graph = live_graph(rig, rig_path, region)
    with (
        tempfile.TemporaryDirectory(prefix="fringedic-live-") as folder,
        RunningGraph(graph, Path(folder), domain=domain) as running,
        _Viewer(graph.namespace, domain=domain, watch=running.check) as viewer,
    ):
        viewer.wait_until_ready(graph.names)
        patterns = _patterns(rig, pattern)
        for number in count():
            projection, name = patterns[number % len(patterns)]
            if (rig.projector is not None and number < len(patterns)) or len(patterns) > 1:
                viewer.show(projection, name)
            yield viewer.look()


class _Viewer(ExposingClient):
    """Has one pattern shown and one frame taken after the other, and hears what is said of it."""

    def __init__(self, namespace: str, **options: Any) -> None:
        super().__init__(namespace, **options)
        self._figures: LiveView | None = None
        self._node.create_subscription(LiveView, "live_view/figures", self._take_figures, DERIVED)

    def look(self) -> LiveView:
        """Have a frame taken and return its figures."""
        _, record = self.expose()

        def arrived() -> bool:
            return self._figures is not None and to_nanoseconds(self._figures.header.stamp) == record.stamp

        self._wait(arrived, FRAME_TIMEOUT_S, lambda: "live_view/figures: nothing about this frame; see /diagnostics")
        assert self._figures is not None, "they arrived"
        return self._figures

    def _take_figures(self, message: LiveView) -> None:
        self._figures = message


def _patterns(rig: RigFile, pattern: Pattern) -> list[tuple[Projection, str]]:
    """What is shown in turns, with the names of set-up patterns."""
    if pattern is Pattern.FRINGES:
        finest = rig.projections()[-1]
        return [
            (Projection(PatternKind.FRINGES, finest.orientation, finest.pitch, shift, 4), "") for shift in (1, 2, 3, 4)
        ]
    if pattern is Pattern.WHITE:
        return [(Projection(PatternKind.WHITE), "")]
    return [(Projection(PatternKind.OTHER), pattern.value)]


def _four_numbers(region: str) -> list[int]:
    if not region:
        return []
    try:
        numbers = [int(part) for part in region.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 4:
        raise RigFileError(f"--region {region}: give first column, first row, width and height, as 320,240,640,480")
    return numbers
