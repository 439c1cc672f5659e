"""`fringedic machine` before instruments behind a TCP socket and a pseudo-terminal."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import yaml
from text_instrument import TextInstrument
from typer.testing import CliRunner

from fringedic.command.main import app

COMMAND = "from fringedic.command.main import main; main()"
FILE: dict[str, Any] = {
    "protocol": "scpi",
    "name": "Frame 2",
    "start": ["REMOTE"],
    "force": {"query": "F?"},
    "position": {"query": "P?"},
    "status": {"query": "S?", "moving": ["RUN"], "hold": ["HOLD"]},
    "move": {"commands": ["SPEED {speed:.1f}", "GOTO {position:.1f}"]},
    "hold": ["STOP"],
    "limits": {"lowest_mm": 0.0, "highest_mm": 10.0, "fastest_mm_per_s": 2.0},
}


def written(folder: Path, resource: str, **changes: Any) -> str:
    path = folder / "machine.yaml"
    path.write_text(yaml.safe_dump({**FILE, "resource": resource, **changes}))
    return str(path)


def test_one_look_sends_queries_only(tmp_path: Path) -> None:
    instrument = TextInstrument(force="{kn:.4f} kN")
    with instrument.on_line() as (resource, _):
        done = CliRunner().invoke(app, ["machine", written(tmp_path, resource, serial={"baud_rate": 19200}), "--once"])
    assert done.exit_code == 0, done.output
    for words in (
        "REMOTE after connecting, then the queries below",
        "not sent, a move to 5 mm at 2 mm/s: SPEED 2.0, GOTO 5.0",
        "not sent, a hold: STOP",
        r"'1.0000 kN\n'",
        "1000.000 N",
        "0.5000 mm",
        "every answer fits the machine file",
    ):
        assert words in done.output
    assert instrument.received == ["REMOTE", *(2 * ["F?", "P?", "S?"])]


def test_the_mode_comes_from_the_motion_without_a_status(tmp_path: Path) -> None:
    with TextInstrument().on_socket() as resource:
        done = CliRunner().invoke(app, ["machine", written(tmp_path, resource, status=None), "--once"])
    assert done.exit_code == 0, done.output
    assert "from the motion" in done.output


def test_replies_that_do_not_fit_name_the_change(tmp_path: Path) -> None:
    instrument = TextInstrument(force="0,012 kN", status="Hold")
    with instrument.on_socket() as resource:
        done = CliRunner().invoke(app, ["machine", written(tmp_path, resource), "--once"])
    assert done.exit_code == 1
    output = " ".join(done.output.split())
    assert "it has a decimal comma: add decimal: ',' to force" in output
    assert "'Hold' is in no list of status, and hold has 'HOLD': write 'Hold' in hold" in output
    assert "0.5000 mm" in output, "the other entries are shown"
    assert instrument.received == ["REMOTE", "F?", "P?", "S?"]


def test_a_machine_that_is_absent_ends_with_a_sentence(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["machine", written(tmp_path, "ASRL/dev/absent::INSTR"), "--once"])
    assert done.exit_code == 1
    assert "no connection" in done.output
    assert "Traceback" not in done.output


def test_live_view_follows_the_machine_until_ctrl_c(tmp_path: Path) -> None:
    instrument = TextInstrument()
    terminal, end = os.openpty()
    with instrument.on_socket() as resource:
        process = subprocess.Popen(
            [sys.executable, "-c", COMMAND, "machine", written(tmp_path, resource)],
            stdin=end,
            stdout=end,
            stderr=end,
            env={**os.environ, "TERM": "xterm", "COLUMNS": "120", "LINES": "40"},
        )
        os.close(end)
        try:
            _read_until(terminal, "0.5000 mm")
            instrument.at_mm = instrument.target_mm = 0.75
            shown = _read_until(terminal, "0.7500 mm")
            assert "1500.000 N" in shown
            process.send_signal(signal.SIGINT)
            _read_until(terminal, "\x1b[?1049l")  # the screen of before
            assert process.wait(timeout=60) == 0
        finally:
            process.kill()
            process.wait()
            os.close(terminal)
    assert set(instrument.received) == {"REMOTE", "F?", "P?", "S?"}


def _read_until(terminal: int, words: str) -> str:
    read, deadline = "", time.monotonic() + 120
    while words not in read:
        assert time.monotonic() < deadline, read
        read += os.read(terminal, 4096).decode(errors="replace")
    return read
