"""Progress of a command: bars that are updated in place on a terminal, plain lines elsewhere."""

from __future__ import annotations

import os
import sys
import termios
from contextlib import suppress
from types import TracebackType

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bars

_BAR = 10  # columns: activity, frame and both times fit beside it on a terminal of 80


class LiveProgress:
    """Shows stage, step and frame of a procedure.

    Parameters
    ----------
    console
        Where to write; without a terminal each new stage and each new activity of a step is one line.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bars = Bars(
            TextColumn("{task.description}"),
            BarColumn(_BAR),
            TextColumn("{task.fields[frame]}"),
            TimeElapsedColumn(),
            TextColumn("/"),
            TimeRemainingColumn(),
            TextColumn("left"),
            console=console,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self._bars.add_task("starting", total=None, frame="")
        self._last = ""

    def __enter__(self) -> LiveProgress:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._bars.stop()

    def stage(self, text: str) -> None:
        """Show the current activity."""
        self._bars.update(self._task, description=text, total=None, frame="")
        self._plain(text)

    def step(self, number: int, last: int, text: str, frame: int = 0, frames: int = 0) -> None:
        """Show the progress of a load step; its number and that of the last one are those of the dataset, from 0."""
        self._advance(f"step {number} (last: {last}): {text}", number, last + 1, frame, frames)

    def part(self, number: int, parts: int, text: str, frame: int = 0, frames: int = 0) -> None:
        """Show the progress of one of several parts of a procedure; `number` counts from 1."""
        self._advance(f"{number} of {parts}: {text}" if parts > 1 else text, number - 1, parts, frame, frames)

    def _advance(self, activity: str, done: int, total: int, frame: int, frames: int) -> None:
        counted = f"frame {frame} of {frames}" if frames else ""
        completed = done + (frame / frames if frames else 0.0)
        self._bars.update(self._task, description=activity, total=total, completed=completed, frame=counted)
        self._plain(activity)

    def note(self, text: str) -> None:
        """Print a line that stays on the screen."""
        self._console.print(text, markup=False, highlight=False)

    def ask(self, words: str) -> bool:
        """Ask an operator to do something and wait for Enter; False without input, or when the answer is not empty."""
        self._bars.stop()
        if sys.stdin.isatty():
            termios.tcflush(sys.stdin, termios.TCIFLUSH)  # what was typed before the question is no answer to it
        self._console.print(f"{escape(words)}, then press Enter (any other text stops): ", end="")
        try:
            answer = _read_line()
        finally:
            self._bars.start()
        return answer.endswith(b"\n") and not answer.strip()

    def _plain(self, text: str) -> None:
        if not self._console.is_terminal and text != self._last:
            self.note(text)
        self._last = text


def _read_line() -> bytes:
    """Read a line of the standard input; without a line feed at its end, the input has ended.

    A thread that waits in `input` holds a lock of the buffer, without which Python cannot end after Ctrl-C.
    """
    line = b""
    with suppress(OSError):  # of a terminal that was closed
        while not line.endswith(b"\n") and (read := os.read(sys.stdin.fileno(), 1)):
            line += read
    return line
