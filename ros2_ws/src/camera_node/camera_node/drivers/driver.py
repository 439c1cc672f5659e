"""What the camera node needs of a camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from fringedic.clocks import ClockEstimate


@dataclass(frozen=True)
class PlacedPlane:
    """The reference plane that stands where the specimen would.

    Attributes
    ----------
    surface
        ``plain``, or with the printed ``grid`` on it.
    angle, height
        Of the stage [rad, m].
    """

    surface: Literal["plain", "grid"]
    angle: float
    height: float


@dataclass(frozen=True)
class ShownPattern:
    """An image that the projector was given.

    Attributes
    ----------
    image
        uint8, (row, column).
    shown_ns
        When it was handed over [ns].
    """

    image: np.ndarray
    shown_ns: int


@dataclass(frozen=True)
class Scene:
    """What is in front of a virtual camera; real cameras see for themselves.

    Attributes
    ----------
    stamp_ns
        Middle of the exposure [ns].
    patterns
        The latest images that the projector was given, oldest first; none: the projector is dark.
    position
        Crosshead position [m].
    plane
        What the stage holds; None: the specimen is there.
    exposure_time
        [s].
    """

    stamp_ns: int
    patterns: tuple[ShownPattern, ...]
    position: float
    plane: PlacedPlane | None = None
    exposure_time: float = 0.01


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
        That the camera really took [s].
    """

    image: np.ndarray
    stamp_ns: int
    exposure_time: float


class Driver(Protocol):
    """A camera. Its methods are called in one background thread, one call at a time, and may block.

    Attributes
    ----------
    needs_scene
        The camera is virtual: the scene has to be put together before the exposure.
    dropped
        Frames that were exposed and did not arrive, or not completely, since the camera was opened.
    """

    needs_scene: bool
    dropped: int

    @property
    def counts(self) -> Mapping[str, int]:
        """What else the way from the camera is known to have done, such as packets lost; told in the diagnostics."""
        ...

    @property
    def clock(self) -> ClockEstimate | None:
        """The clock of the camera's stamps against this computer's; None without such a clock or before a frame."""
        ...

    def expose(self, scene: Scene) -> Frame:
        """Take one frame of `scene.exposure_time` that begins now.

        Raises
        ------
        FringedicError
            There is no frame; the message says why. The next call may succeed.
        """
        ...

    def close(self) -> None:
        """Give the camera back."""
        ...


class LocalDriver:
    """What files, videos and the digital twin have in common: no way on which frames get lost, and no other clock."""

    needs_scene = False
    dropped = 0
    counts: Mapping[str, int] = {}
    clock: ClockEstimate | None = None


@runtime_checkable
class StreamingDriver(Driver, Protocol):
    """A camera that can expose by its own clock."""

    def start(self, rate_hz: float) -> None:
        """Expose at a rate [Hz] from now on; `expose` then gives one frame after the other, as they come.

        Raises
        ------
        CameraError
            The camera does not offer this rate.
        """
        ...

    def interrupt(self) -> None:
        """Let an `expose` that waits in another thread raise soon, as the stream is about to end."""
        ...

    def stop(self) -> None:
        """End what `start` began."""
        ...
