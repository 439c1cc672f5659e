"""Reads how the clocks of camera and testing machine ran against this computer's, from a recording."""

from __future__ import annotations

import os
from collections import deque
from contextlib import suppress

from fringedic.errors import RecordingError
from fringedic.frames.clocks import ClockEstimate
from fringedic.frames.records import stamp_of
from fringedic.recording.reader import BagReader

DEVICES = {"camera/clock": "camera", "load_frame/clock": "load frame"}


def recorded_clocks(path: str | os.PathLike[str], sensor: str | None = None) -> dict[str, ClockEstimate]:
    """Return the last estimate of each device clock in a recording.

    Parameters
    ----------
    path
        The recording. Topics that cannot be read because it is damaged are left out.
    sensor
        Name of the sensor, if the recording contains several.

    Returns
    -------
    dict
        By the name of the device, ``camera`` or ``load frame``; empty when no device stamps with a clock of its own.

    Raises
    ------
    RecordingError
        There is no such recording.

    Examples
    --------
    >>> recorded_clocks("recordings/plate-7/bag")  # its devices have the clock of the computer
    {}
    """
    reader = BagReader(path, sensor=sensor)
    found = {}
    for name, topic in reader.find_optional(*DEVICES).items():
        with suppress(RecordingError):
            for _, message, _ in deque(reader.messages([topic]), maxlen=1):
                found[DEVICES[name]] = ClockEstimate(
                    stamp_ns=stamp_of(message),
                    offset=message.offset,
                    drift=message.drift,
                    drift_sigma=message.drift_sigma,
                    samples=message.samples,
                )
    return found
