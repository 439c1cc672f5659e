"""Current camera images during set-up: starts projector, camera and live view, and yields the figures of each frame."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Generator, Sequence
from itertools import count
from pathlib import Path

from fringedic.configuration.rig_file import RigFile
from fringedic.errors import ConfigurationError, WaitTimeoutError
from fringedic.patterns.pattern import SETUP, WHITE, PatternKind, ProjectedPattern
from fringedic_bringup.launch.graph import live_graph
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.procedures.exposing import CONNECTING_S, FRAME_TIMEOUT_S, ExposingClient
from fringedic_bringup.setup_patterns import LivePattern
from fringedic_msgs.msg import LiveView
from fringedic_ros.arrivals import unconnected
from fringedic_ros.qos import DERIVED
from fringedic_ros.stamps import to_nanoseconds

SHIFTS = 4  # of the finest fringes
FRAMES_OF_ONE_LOOK = 2 * SHIFTS  # the modulation needs one cycle, noise and speckle size another


def watch(
    rig: RigFile,
    rig_path: Path,
    pattern: LivePattern,
    *,
    region: Sequence[int] = (),
    domain: int | None = None,
) -> Generator[LiveView]:
    """Start projector, camera and live view, and yield the figures of one frame after the other without end.

    Parameters
    ----------
    rig, rig_path
        The rig file, and its path.
    pattern
        The projected pattern.
    region
        First column, first row, width and height of the evaluated part of the image [px]; empty: the whole image.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    ConfigurationError
        A pattern is requested of a rig without projector.
    NodeDiedError, WaitTimeoutError, StepFailedError
        The nodes did not start, one of them ended, or a frame could not be taken.
    """
    if rig.projector is None and pattern is not LivePattern.WHITE:
        raise ConfigurationError(f"{rig_path}: has no projector that could show {pattern}")
    graph = live_graph(rig, region)
    with (
        tempfile.TemporaryDirectory(prefix="fringedic-live-") as folder,
        RunningGraph(graph, Path(folder), domain=domain) as running,
        _LiveClient(graph.namespace, domain=domain, watch=running.check) as client,
    ):
        client.wait_until_ready(graph.names)
        patterns = _patterns(rig, pattern)
        for number in count():
            projected, name = patterns[number % len(patterns)]
            if (rig.projector is not None and number < len(patterns)) or len(patterns) > 1:
                client.show(projected, name)
            yield client.look()


def part_of_image(region: str) -> list[int]:
    """Return the numbers of a region given as "320,240,640,480"; none of an empty text.

    Raises
    ------
    ConfigurationError
        It does not have four numbers.
    """
    if not region:
        return []
    try:
        column, row, width, height = (int(part) for part in region.split(","))
    except ValueError as error:
        raise ConfigurationError(
            f"region {region}: give first column, first row, width and height, such as 320,240,640,480"
        ) from error
    return [column, row, width, height]


class _LiveClient(ExposingClient):
    """Requests one pattern and one frame after the other, and waits for the figures of each frame."""

    def __init__(self, namespace: str, *, domain: int | None, watch: Callable[[], None]) -> None:
        super().__init__(namespace, domain=domain, watch=watch)
        self._figures: LiveView | None = None
        self.node.create_subscription(LiveView, "live_view/figures", self._take_figures, DERIVED)

    def look(self) -> LiveView:
        """Take a frame and return its figures; take another when the live view was not connected yet and heard none."""
        end = time.monotonic() + FRAME_TIMEOUT_S
        while True:
            _, record = self.expose()
            try:
                return self._figures_of(record.stamp)
            except WaitTimeoutError:
                if time.monotonic() > end:
                    raise

    def _figures_of(self, stamp: int) -> LiveView:
        """Wait for the figures of a frame, or of a later one."""

        def arrived() -> bool:
            return self._figures is not None and to_nanoseconds(self._figures.header.stamp) >= stamp

        def missing() -> str:
            reason = unconnected(self.node, LiveView, "live_view/figures")
            return reason or "live_view/figures: no figures of this frame; see /diagnostics"

        self.wait_for(arrived, CONNECTING_S, missing)
        assert self._figures is not None, "they arrived"
        return self._figures

    def _take_figures(self, message: LiveView) -> None:
        self._figures = message


def _patterns(rig: RigFile, pattern: LivePattern) -> list[tuple[ProjectedPattern, str]]:
    """Return the patterns that are shown in turn, with the names of set-up patterns."""
    if pattern is LivePattern.FRINGES:
        finest = rig.patterns()[-1]
        return [
            (ProjectedPattern(PatternKind.FRINGES, finest.orientation, finest.pitch, shift, SHIFTS), "")
            for shift in range(1, SHIFTS + 1)
        ]
    return [(WHITE, "")] if pattern is LivePattern.WHITE else [(SETUP, pattern.value)]
