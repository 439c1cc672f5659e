"""A command outlives its terminal until it has ended in order."""

from __future__ import annotations

import os

from fringedic.command.terminal import Terminal


def test_what_is_written_to_a_closed_terminal_is_lost() -> None:
    terminal, end = os.openpty()
    stream = Terminal.opened(end)
    stream.write("before\n")
    assert os.read(terminal, 100) == b"before\r\n"
    os.close(terminal)
    print("after", file=stream, flush=True)
    stream.close()
    os.close(end)
