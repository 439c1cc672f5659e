"""A node of a command that is interrupted while it handles messages."""

from __future__ import annotations

import os
import signal

import pytest

from fringedic_bringup.participant import Participant


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_comes_after_the_callback(number: signal.Signals) -> None:
    """In the middle of a message it would come out as an error of rclpy."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    participant = Participant("interrupted", "rig")
    handled: list[bool] = []

    def callback() -> None:
        os.kill(os.getpid(), number)
        handled.append(True)

    participant.node.create_timer(1e-3, callback)
    before = signal.signal(number, interrupt)
    try:
        with pytest.raises(KeyboardInterrupt):
            participant.spin_once(10.0)
        assert handled == [True]
        assert signal.getsignal(number) is interrupt
    finally:
        signal.signal(number, before)
        participant.close()
