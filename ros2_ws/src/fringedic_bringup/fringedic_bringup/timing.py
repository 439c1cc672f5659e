"""Measures when a rig's projector shows what it is asked for: shows dark and bright and photographs the changes."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fringedic.errors import RigFileError, TimingError
from fringedic.image_quality import full_scale_of
from fringedic.rig_file import RigFile
from fringedic.timing import ProjectorTiming, TimingSamples, measure_timing, rough_delay
from fringedic.timing_picture import timing_figure
from fringedic_bringup.exposing import SETUP, WHITE, ExposingClient
from fringedic_bringup.graph import exposing_graph
from fringedic_bringup.processes import RunningGraph
from fringedic_bringup.report import Progress

COARSE_CHANGES = 4
BRIGHT_AT_REST, DARK_AT_REST = 3, 1  # frames after each change
MOST_TRIES = 3  # for each change
JITTER = 0.006  # of a pattern's delay, that is looked for [s]
FEWEST_PIXELS = 100
SATURATED = 0.01  # part of the lit pixels that may be


@dataclass(frozen=True)
class TimingReport:
    """What was measured, and what to set.

    Attributes
    ----------
    timing
        The measurement.
    words
        The same in sentences.
    settings
        Lines for the rig file.
    """

    timing: ProjectorTiming
    words: list[str]
    settings: str


def measure_rig_timing(
    rig: RigFile,
    rig_path: Path,
    folder: Path,
    progress: Progress,
    *,
    exposure_time: float,
    longest: float,
    changes: int = 60,
    domain: int | None = None,
) -> TimingReport:
    """Measure the projector of a rig and leave ``timing.yaml`` and ``timing.png`` in a folder.

    Parameters
    ----------
    rig, rig_path
        The rig file and where it was read.
    folder
        Gets the files and ``logs``.
    progress
        Told what goes on.
    exposure_time
        Of the frames [s]: short against the refresh, and long enough for some light.
    longest
        Time that the projector may take for a pattern [s].
    changes
        From dark to bright or back, that are photographed in time; a busy computer is late for some.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    RigFileError
        The rig has no projector, or its camera reads files.
    TimingError
        The camera does not see the projector, or see `fringedic.timing.measure_timing`.
    NodeDiedError, NotAnsweredError, StepFailedError
        The nodes did not start, one of them ended, or a pattern or a frame failed.
    """
    if rig.projector is None or rig.camera.source == "files":
        raise RigFileError(f"{rig_path}: timing needs a projector and a camera that sees it")
    graph = exposing_graph(rig, rig_path)
    progress.stage(f"starting {len(graph.nodes)} nodes")
    with (
        RunningGraph(graph, folder / "logs", domain=domain) as running,
        ExposingClient(graph.namespace, domain=domain, watch=running.check) as client,
    ):
        client.wait_until_ready(graph.names)
        session = _Session(client, exposure_time, longest)
        progress.stage("looking for the projector's light")
        session.find_light()
        session.look_for_change()
        caught = 0
        for _ in range(MOST_TRIES * changes):
            progress.step(1, 1, "dark and bright in turn", caught + 1, changes)
            caught += session.watch_change()
            if caught == changes:
                break
        client.show(SETUP, "dark")
    samples = session.samples()
    timing = measure_timing(samples)
    timing.save(folder / "timing.yaml", rig.camera.exposure_time)
    timing_figure(samples, timing, rig.camera.exposure_time).savefig(folder / "timing.png")
    settings = (
        f"camera:\n  exposure_ms: {1e3 * timing.whole_exposure(rig.camera.exposure_time):.6g}\n"
        f"  settle_ms: {1e3 * timing.settle_time():.4g}"
    )
    return TimingReport(timing, timing.words(rig.camera.exposure_time, rig.camera.settle_time), settings)


class _Session:
    """Frames of a scene on which dark and bright are shown in turn."""

    def __init__(self, client: ExposingClient, exposure_time: float, longest: float) -> None:
        self._client = client
        self._exposure_time = exposure_time
        self._longest = longest
        self._random = np.random.default_rng(0)
        self._lit = np.zeros((0, 0), bool)
        self._full_scale = 0.0
        self._shown_ns, self._bright = 0, False
        self._reaction = 0.01  # from asking for a frame to the begin of its exposure [s]
        self._change = (0.0, longest)  # between which times after a pattern its light comes
        self._rows: list[tuple[float, int, bool, float]] = []

    def find_light(self) -> None:
        """Choose the pixels that the projector lights."""
        views = []
        for bright in (False, True):
            self._show(bright)
            time.sleep(self._longest)
            # the mean over times that no pulse of the light keeps
            frames = [self._client.expose(self._exposure_time)[0] for _ in range(5)]
            views.append(np.mean(frames, axis=0))
        difference = views[1] - views[0]
        self._full_scale = full_scale_of(frames)
        self._lit = difference > 0.5 * np.percentile(difference, 99)
        if self._lit.sum() < FEWEST_PIXELS or difference[self._lit].mean() < 2.0:
            raise TimingError(
                f"white is {difference.max():.1f} grey levels brighter than dark in frames of "
                f"{1e3 * self._exposure_time:g} ms: the camera does not see the projector; look at the lamp, the lens "
                "cap and the camera's view, or give a longer --exposure-ms"
            )

    def look_for_change(self) -> None:
        """Photograph some changes all the time, to know when the light comes."""
        for _ in range(COARSE_CHANGES):
            self._show(not self._bright)
            while self._since() < self._longest:
                self._expose()
        delay, decay = rough_delay(self.samples())
        margin = JITTER + self._exposure_time
        self._change = delay - margin, delay + 3.0 * decay + margin
        if self._change[1] > self._longest:
            raise TimingError(
                f"the camera does not see a pattern within {1e3 * self._longest:.0f} ms; give a longer --longest-ms"
            )

    def watch_change(self) -> bool:
        """Photograph one change, and then what is at rest; return whether the change was not over by then."""
        self._show(not self._bright)
        low, high = self._change
        self._wait_until(self._random.uniform(low, high) - self._exposure_time / 2)
        self._expose()
        in_time = self._rows[-1][0] <= high
        rest = min(high + 2 * (high - low), self._longest)
        for _ in range(BRIGHT_AT_REST if self._bright else DARK_AT_REST):
            self._wait_until(max(rest, self._since()) + self._random.uniform(0.0, 0.01))
            self._expose()
        return in_time

    def samples(self) -> TimingSamples:
        """Return all frames of the changes."""
        first = self._rows[0][1]
        return TimingSamples(
            np.array([row[0] for row in self._rows]),
            np.array([1e-9 * (row[1] - first) for row in self._rows]),
            np.array([row[2] for row in self._rows]),
            np.array([row[3] for row in self._rows]),
            self._exposure_time,
        )

    def _show(self, bright: bool) -> None:
        self._shown_ns = self._client.show(WHITE) if bright else self._client.show(SETUP, "dark")
        self._bright = bright

    def _since(self) -> float:
        return 1e-9 * (time.time_ns() - self._shown_ns)

    def _wait_until(self, since: float) -> None:
        """Wait until a frame that is asked for begins that long after the pattern."""
        time.sleep(max(since - self._reaction - self._since(), 0.0))

    def _expose(self) -> None:
        asked = time.time_ns()
        image, record = self._client.expose(self._exposure_time)
        begin = record.stamp - round(0.5e9 * record.exposure_time)
        self._reaction += 0.2 * (1e-9 * (begin - asked) - self._reaction)
        self._exposure_time = record.exposure_time
        lit = image[self._lit]
        if (lit >= self._full_scale).mean() > SATURATED:
            raise TimingError(
                f"frames of {1e3 * self._exposure_time:g} ms are saturated; give a shorter --exposure-ms or close the "
                "lens's aperture"
            )
        self._rows.append((1e-9 * (record.stamp - self._shown_ns), record.stamp, self._bright, float(lit.mean())))
