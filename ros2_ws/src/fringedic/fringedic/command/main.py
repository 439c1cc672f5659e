"""Entry point of the ``fringedic`` command."""

from __future__ import annotations

import os
import signal
import sys
from typing import Any, NoReturn

import typer

from fringedic.command import (
    attachments,
    calibration,
    campaign,
    evaluations,
    evidence,
    images,
    models,
    recordings,
    rig_setup,
    sensors,
    view,
)
from fringedic.command.app import app
from fringedic.command.plugins import load_commands, ros_as_sentence
from fringedic.command.terminal import Terminal
from fringedic.errors import FringedicError
from fringedic.wording.causes import cause_of
from fringedic.wording.control_characters import visible

# importing them adds their subcommands
__all__ = [
    "app",
    "attachments",
    "calibration",
    "campaign",
    "evaluations",
    "evidence",
    "images",
    "main",
    "models",
    "recordings",
    "rig_setup",
    "sensors",
    "view",
]
INTERRUPTED = 130


def main() -> None:
    """Run the command; an error is one sentence on the error stream.

    The exit code is 1 for what cannot be done, 2 for a command that is not written as its help says, and 130 after
    Ctrl-C, SIGTERM or SIGHUP.
    """
    _interrupt_at_end_of_session()
    try:
        with ros_as_sentence():
            if {"--help", *sys.argv[1:2]} == {"--help"}:  # lists all; loaded later, the commands would be made twice
                load_commands()
            code = app(standalone_mode=False) or 0
    except FringedicError as error:
        _end(str(error), 1)
    except typer.Abort:  # Ctrl-C or Ctrl-D at a question
        _end(
            "ended at a question without an answer, nothing was written; each question has an option (--help)",
            INTERRUPTED,
        )
    except OSError as error:  # of a path that cannot be used, or a full disk
        place = f"{error.filename}: " if error.filename else ""
        _end(f"{place}{cause_of(error)}; choose another path or make room", 1)
    except Exception as error:
        # usage errors are of click, or of the copy of it that newer versions of typer contain
        if not hasattr(error, "format_message"):
            raise
        _end(_usage_sentence(error), 2)
    if code == INTERRUPTED:  # typer ends with it after a KeyboardInterrupt
        _end("interrupted; nothing is running any more, and what was recorded is closed", code)
    sys.exit(code)


def _interrupt_at_end_of_session() -> None:
    """Let SIGTERM and SIGHUP end the command as Ctrl-C does: at a shutdown, or when its terminal is closed."""
    terminals = [stream for stream in (0, 1, 2) if os.isatty(stream)]
    # written to before the signal is handled, a closed terminal would end the command with an error of its own
    if 1 in terminals:
        sys.stdout = Terminal.opened(1)
    if 2 in terminals:
        sys.stderr = Terminal.opened(2)

    def leave_terminals(*_: object) -> None:
        # a closed terminal fails every line that is written to it
        null = os.open(os.devnull, os.O_RDWR)
        for stream in terminals:
            os.dup2(null, stream)
        os.close(null)

    def interrupt(number: int, _: object) -> NoReturn:
        # the end of a session sends both signals; a second interruption would skip dataset and report
        signal.signal(signal.SIGTERM, lambda *_: None)
        signal.signal(signal.SIGHUP, leave_terminals)
        if number == signal.SIGHUP:
            leave_terminals()
        raise KeyboardInterrupt

    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:  # as nohup leaves it
            signal.signal(number, interrupt)


def _end(sentence: str, code: int) -> NoReturn:
    typer.echo(visible(sentence), err=True)
    sys.exit(code)


def _usage_sentence(error: Any) -> str:
    context = getattr(error, "ctx", None)
    command = "fringedic" if context is None else f"fringedic {context.info_name if context.parent else ''}".rstrip()
    return f"{' '.join(error.format_message().split()).rstrip('.')}; '{command} --help' shows how to write it"
