"""Settings of a GenICam camera."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

PIXEL_TYPES = {"Mono8": np.uint8, "Mono10": np.uint16, "Mono12": np.uint16, "Mono16": np.uint16}


class Trigger(StrEnum):
    """Event that starts an exposure."""

    INTERNAL = "internal"  # the clock of the camera, all the time
    SOFTWARE = "software"  # each request
    EXTERNAL_EDGE = "external_edge"  # an electrical edge, for the set exposure time
    EXTERNAL_LEVEL = "external_level"  # an electrical level, for as long as it lasts


@dataclass(frozen=True)
class AravisSettings:
    """Settings of a camera.

    Attributes
    ----------
    camera
        Identifier or network address; empty: the only camera that is found.
    exposure_time
        Exposure time [s].
    gain
        Gain [dB], for cameras with adjustable gain.
    pixel_format
        "Mono8", "Mono10", "Mono12" or "Mono16".
    region
        (column, row, width, height) [px]; None is the whole sensor.
    trigger
        Event that starts an exposure.
    trigger_line
        Input of the external triggers, such as "Line1".
    packet_size
        Size of network packets [byte]; 0 finds the largest that passes.
    timeout
        Longest wait for a frame beyond its exposure time [s].
    """

    exposure_time: float
    camera: str = ""
    gain: float = 0.0
    pixel_format: str = "Mono8"
    region: tuple[int, int, int, int] | None = None
    trigger: Trigger = Trigger.SOFTWARE
    trigger_line: str = "Line1"
    packet_size: int = 0
    timeout: float = 5.0
