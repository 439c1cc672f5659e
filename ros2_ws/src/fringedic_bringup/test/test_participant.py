"""Nodes of a command or script: interrupted while they handle messages, and ended before the program is."""

from __future__ import annotations

import gc
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import pytest
import rclpy
from rclpy.action.client import ActionClient
from rclpy.action.server import ActionServer
from rclpy.node import Node

from fringedic_bringup.client import RigClient
from fringedic_bringup.participant import Participant
from fringedic_msgs.action import MoveCrosshead
from fringedic_ros.spinning import Spinning


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


@contextmanager
def machine() -> Iterator[None]:
    """Run a node that serves moves and requests them."""
    rclpy.init()
    with Spinning() as loop:
        node = loop.add(Node("machine", namespace="rig"))
        ActionServer(node, MoveCrosshead, "move_crosshead", lambda _: MoveCrosshead.Result())
        ActionClient(node, MoveCrosshead, "move_crosshead")
        yield
    rclpy.try_shutdown()


@pytest.mark.parametrize(("name", "running"), [("machine", machine), ("client", RigClient)])
def test_a_node_with_actions_leaves_the_graph_when_it_ends(
    name: str, running: Callable[[], AbstractContextManager[Any]]
) -> None:
    """Where many stayed until Python collected them, a later client took its server as missing."""
    witness = Participant("witness", "rig")

    def wait(*, present: bool) -> None:
        end = time.monotonic() + 60
        while (name in witness.node.get_node_names()) is not present:
            assert time.monotonic() < end, f"{name}: in the graph {not present}"
            witness.spin_once(0.01)

    gc.disable()
    try:
        with running() as kept:
            wait(present=True)
        wait(present=False)
        del kept  # not earlier
    finally:
        gc.enable()
        witness.close()
