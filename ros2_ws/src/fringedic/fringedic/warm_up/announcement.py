"""Announces the compilation of the library, which takes up to a minute where nothing is compiled yet."""

from __future__ import annotations

import logging

from numba.core import event

SENTENCE = "fringedic compiles its functions for this processor, once per installation: this takes up to a minute"


class Announcement(event.Listener):
    """Logs one sentence when Numba compiles the first function of this library in a process."""

    def __init__(self) -> None:
        self._made = False

    def on_start(self, event: event.Event) -> None:
        """Log the sentence; Numba calls this for a function that is not in its cache."""
        function = event.data["dispatcher"].py_func
        if not self._made and function.__module__.startswith("fringedic."):
            self._made = True
            logging.getLogger("fringedic").warning(SENTENCE)

    def on_end(self, event: event.Event) -> None:
        """Log nothing: the result follows."""


ANNOUNCEMENT = Announcement()
event.register("numba:compile", ANNOUNCEMENT)  # type: ignore[no-untyped-call]
