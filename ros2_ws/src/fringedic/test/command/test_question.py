"""The question to an operator in a terminal, asked by a thread as during a calibration."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

ASKING = """
import threading, time
from rich.console import Console
from fringedic.command.progress import LiveProgress
def ask():
    with LiveProgress(Console()) as progress:
        answers.append(progress.ask("Lay the grid on the plane"))
answers = []
threading.Thread(target=ask, daemon=True).start()
while not answers:
    time.sleep(0.05)
print(answers)
"""


def asking() -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", ASKING],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        bufsize=1,
    )


@pytest.mark.parametrize(("answer", "confirmed"), [("\n", True), (" \n", True), ("no\n", False), ("", False)])
def test_enter_confirms_and_anything_else_stops(answer: str, confirmed: bool) -> None:
    with asking() as process:
        words, errors = process.communicate(answer, timeout=60)
    assert words.startswith("Lay the grid on the plane, then press Enter (any other text stops): ")
    assert words.endswith(f"[{confirmed}]\n")
    assert not errors


def test_an_interruption_while_a_question_is_open_ends_the_command() -> None:
    """With an input that is no terminal, Python aborted at its end."""
    with asking() as process:
        assert process.stdout is not None
        assert process.stdout.read(8) == "Lay the "
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == -signal.SIGINT
    assert "Fatal Python error" not in errors
