"""Reads from a recording how its programme ended."""

from __future__ import annotations

import os
from contextlib import suppress
from typing import NamedTuple

from fringedic.errors import RecordingError
from fringedic.recording.reader import BagReader

PROGRAMME = "programme/status"
_ERROR_STAGE = 4  # of fringedic_msgs/StepStatus


class ProgrammeEnd(NamedTuple):
    """End of a programme.

    Attributes
    ----------
    experiment, step
        Its name, and the number that the step under way had or would have got.
    reason
        Why it ended before its last step; empty when it did not.
    error_code
        Of the action that ended it; 0 where there was none.
    """

    experiment: str
    step: int
    reason: str = ""
    error_code: int = 0


def programme_end(path: str | os.PathLike[str], sensor: str | None = None) -> ProgrammeEnd | None:
    """Return how the programme of a recording ended, the last time when it was continued.

    Parameters
    ----------
    path
        The recording.
    sensor
        Name of the sensor, if the recording contains several.

    Returns
    -------
    ProgrammeEnd or None
        None of a recording without a programme, whose command was killed, that is damaged at its end, or of an earlier
        version.

    Raises
    ------
    RecordingError
        There is no such recording.

    Examples
    --------
    >>> print(programme_end("recordings/plate-7/bag"))  # no programme ended early
    None
    """
    reader, end = BagReader(path, sensor=sensor), None
    if topics := reader.find_optional(PROGRAMME).values():
        with suppress(RecordingError):
            for _, message, _ in reader.messages(topics):
                reason = message.error_message if message.stage == _ERROR_STAGE else ""
                end = ProgrammeEnd(message.experiment, message.step, reason, message.error_code)
    return end
