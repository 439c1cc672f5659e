"""A node of a command that is interrupted while it handles messages."""

from __future__ import annotations

import os
import signal
from typing import Any

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


def test_all_handlers_are_restored_and_called_although_one_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    """SIGTERM was ignored from then on when Ctrl-C came while the handlers were restored."""
    called: list[int] = []

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    def note(number: int, _: object) -> None:
        called.append(number)

    restored, real = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP], signal.signal
    before = {number: signal.getsignal(number) for number in restored}

    def slow(number: signal.Signals, handler: Any) -> Any:
        earlier = real(number, handler)
        if handler in (interrupt, note):
            os.kill(os.getpid(), signal.SIGINT)
        return earlier

    participant = Participant("interrupted", "rig")
    participant.node.create_timer(1e-3, lambda: os.kill(os.getpid(), signal.SIGHUP))
    try:
        for number in restored:
            signal.signal(number, interrupt if number == signal.SIGINT else note)
        monkeypatch.setattr(signal, "signal", slow)
        with pytest.raises(KeyboardInterrupt):
            participant.spin_once(10.0)
        monkeypatch.undo()
        assert [signal.getsignal(number) for number in restored] == [interrupt, note, note]
        assert called == [signal.SIGHUP]
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        participant.close()
