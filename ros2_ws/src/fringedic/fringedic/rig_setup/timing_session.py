"""Frames of a scene on which dark and white are shown in turn, and the brightness samples of the changes."""

from __future__ import annotations

import time
from typing import Protocol

import numpy as np

from fringedic.errors import RigSetupError
from fringedic.frames.image_quality import full_scale_of
from fringedic.frames.records import Frame
from fringedic.patterns.pattern import SETUP, WHITE, ProjectedPattern
from fringedic.rig_setup.timing import rough_delay
from fringedic.rig_setup.timing_samples import TimingSamples

COARSE_CHANGES = 4
BRIGHT_AT_REST, DARK_AT_REST = 3, 1  # frames after each change
JITTER = 0.006  # [s]; largest jitter of the delay that is searched
FEWEST_PIXELS = 100
LEAST_DIFFERENCE = 2.0  # [grey level] between white and dark in the lit pixels
MOST_SATURATED = 0.01  # fraction of the lit pixels


class ProjectorAndCamera(Protocol):
    """Shows a pattern, and takes a frame of it."""

    def show(self, pattern: ProjectedPattern, name: str = "") -> int:
        """Show a pattern, and return when it was requested from the projector [ns]."""

    def expose(self, exposure_time: float) -> Frame:
        """Take a frame with an exposure time [s]."""


class TimingSession:
    """Frames of a scene on which dark and white are shown in turn.

    Parameters
    ----------
    client
        The projector and the camera.
    exposure_time
        Exposure time of the frames [s].
    longest
        Longest delay of a pattern [s].
    full_scale
        Grey level of a saturated pixel; 0 when only the images show it.
    """

    def __init__(self, client: ProjectorAndCamera, exposure_time: float, longest: float, full_scale: float) -> None:
        self._client = client
        self._exposure_time = exposure_time
        self._longest = longest
        self._random = np.random.default_rng(0)
        self._lit = np.zeros((0, 0), bool)
        self._full_scale = full_scale
        self._shown_ns, self._bright = 0, False
        self._reaction = 0.01  # from the request of a frame to the start of its exposure [s]
        self._change = (0.0, longest)  # interval after a pattern in which the light changes [s]
        self._rows: list[tuple[float, int, bool, float]] = []

    def find_light(self) -> None:
        """Select the pixels that the projector illuminates."""
        views = []
        for bright in (False, True):
            self._show(bright)
            time.sleep(self._longest)
            # the mean over several frames reduces the effect of pulsing light
            frames = [self._client.expose(self._exposure_time)[0] for _ in range(5)]
            views.append(np.mean(frames, axis=0))
        difference = views[1] - views[0]
        self._full_scale = self._full_scale or full_scale_of(frames)
        self._lit = difference > 0.5 * np.percentile(difference, 99)
        if self._lit.sum() < FEWEST_PIXELS or difference[self._lit].mean() < LEAST_DIFFERENCE:
            raise RigSetupError(
                f"white is {difference.max():.1f} grey levels brighter than dark in frames of "
                f"{1e3 * self._exposure_time:g} ms: the camera does not see the projector; check the lamp, the lens "
                "cap and the view of the camera, or give a longer --exposure-ms"
            )

    def find_delay(self) -> None:
        """Take frames continuously during some changes, to find the interval in which the light changes."""
        for _ in range(COARSE_CHANGES):
            self._show(not self._bright)
            while self._since() < self._longest:
                self._expose()
        delay, decay = rough_delay(self.samples())
        margin = JITTER + self._exposure_time
        self._change = delay - margin, delay + 3.0 * decay + margin
        if self._change[1] > self._longest:
            raise RigSetupError(
                f"no pattern is visible within {1e3 * self._longest:.0f} ms; allow a longer delay (--longest-ms)"
            )

    def capture_change(self) -> bool:
        """Take one frame during a change and some at rest; return whether the first was in time."""
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
        """Return the brightness of all frames."""
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
        """Wait until a frame that is requested now starts this long after the pattern [s]."""
        time.sleep(max(since - self._reaction - self._since(), 0.0))

    def _expose(self) -> None:
        requested = time.time_ns()
        image, record = self._client.expose(self._exposure_time)
        begin = record.stamp - round(0.5e9 * record.exposure_time)
        self._reaction += 0.2 * (1e-9 * (begin - requested) - self._reaction)
        self._exposure_time = record.exposure_time
        lit = image[self._lit]
        if (lit >= self._full_scale).mean() > MOST_SATURATED:
            raise RigSetupError(
                f"frames of {1e3 * self._exposure_time:g} ms are saturated; give a shorter --exposure-ms or close the "
                "aperture of the lens"
            )
        self._rows.append((1e-9 * (record.stamp - self._shown_ns), record.stamp, self._bright, float(lit.mean())))
