"""Interface of a camera, and the scene in front of a virtual one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from fringedic.frames.clocks import ClockEstimate


@dataclass(frozen=True)
class PlacedPlane:
    """The reference plane in the place of the specimen.

    Attributes
    ----------
    surface
        ``plain``, or with the printed ``grid`` on it.
    angle, height
        Angle and height of the stage [rad, m].
    """

    surface: Literal["plain", "grid"]
    angle: float
    height: float


@dataclass(frozen=True)
class ShownPattern:
    """An image on the screen of the projector.

    Attributes
    ----------
    image
        uint8, (row, column).
    shown_ns
        Time at which it was shown [ns].
    """

    image: np.ndarray
    shown_ns: int


@dataclass(frozen=True)
class Scene:
    """Scene of an exposure; only a virtual camera needs it.

    Attributes
    ----------
    stamp_ns
        Middle of the exposure [ns].
    patterns
        The latest images of the projector, oldest first; empty: the projector is dark.
    position
        Crosshead position at the middle of the exposure [m].
    plane
        The plane on the stage; None: the specimen is in front of the camera.
    exposure_time
        Exposure time [s].
    travel
        Way of the crosshead during the exposure [m].
    """

    stamp_ns: int
    patterns: tuple[ShownPattern, ...]
    position: float
    plane: PlacedPlane | None = None
    exposure_time: float = 0.01
    travel: float = 0.0


@dataclass(frozen=True)
class Frame:
    """One exposure.

    Attributes
    ----------
    image
        uint8 or uint16, (row, column).
    stamp_ns
        Middle of the exposure [ns].
    exposure_time
        Exposure time that the camera used [s].
    """

    image: np.ndarray
    stamp_ns: int
    exposure_time: float


class Driver(Protocol):
    """A camera. One background thread calls its methods, which may block.

    Attributes
    ----------
    needs_scene
        The camera is virtual and needs the scene of each exposure.
    dropped
        Frames that were exposed and did not arrive completely, since the camera was opened.
    """

    needs_scene: bool
    dropped: int

    @property
    def counts(self) -> Mapping[str, int]:
        """Further counts of the connection, such as lost packets; published in the diagnostics."""
        ...

    @property
    def clock(self) -> ClockEstimate | None:
        """Clock of the camera relative to this computer; None without such a clock or before the first frame."""
        ...

    def expose(self, scene: Scene) -> Frame:
        """Take one frame of `scene.exposure_time` that begins now.

        Raises
        ------
        FringedicError
            There is no frame; the message gives the reason. The next call may succeed.
        """
        ...

    def close(self) -> None:
        """Close the camera."""
        ...


class LocalDriver:
    """Base of drivers without a clock and counts of their own: no frames get lost, and there is no other clock."""

    needs_scene = False
    dropped = 0
    counts: Mapping[str, int] = {}
    clock: ClockEstimate | None = None


@runtime_checkable
class StreamingDriver(Driver, Protocol):
    """A camera that can expose at a rate by its own clock."""

    def start(self, rate_hz: float) -> None:
        """Start to expose at a rate [Hz]; `expose` then returns one frame after the other.

        Raises
        ------
        CameraError
            The camera does not offer this rate.
        """
        ...

    def interrupt(self) -> None:
        """End an `expose` that waits in another thread: the stream is about to end."""
        ...

    def stop(self) -> None:
        """End the stream that `start` began."""
        ...
