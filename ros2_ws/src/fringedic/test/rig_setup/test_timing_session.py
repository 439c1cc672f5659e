"""Frames of dark and white in turn, before the delay is computed from them."""

from __future__ import annotations

import time

import numpy as np
import pytest

from fringedic.errors import RigSetupError
from fringedic.frames.records import Frame, FrameRecord
from fringedic.patterns.pattern import WHITE, ProjectedPattern
from fringedic.rig_setup.timing_session import TimingSession


class SteadyProjector:
    """Client of a camera whose image of white is a little brighter each time, from 1010 on."""

    def __init__(self) -> None:
        self._white, self._level = 1000, 0

    def show(self, pattern: ProjectedPattern, name: str = "") -> int:  # noqa: ARG002
        self._white += 10
        self._level = self._white if pattern == WHITE else 10
        return time.time_ns()

    def expose(self, exposure_time: float) -> Frame:
        image = np.full((40, 40), self._level, np.uint16)
        return Frame(image, FrameRecord("", 0, 0, 1, WHITE, time.time_ns(), exposure_time))


def test_dark_images_are_not_saturated_when_the_rig_file_states_their_bits() -> None:
    """Images below 1024 look like those of 10 bits."""

    def dark_and_white(full_scale: float) -> None:
        session = TimingSession(SteadyProjector(), 0.001, 0.02, full_scale)
        session.find_light()
        session.capture_change()
        session.capture_change()

    dark_and_white(4095.0)
    with pytest.raises(RigSetupError, match="are saturated"):
        dark_and_white(0.0)
