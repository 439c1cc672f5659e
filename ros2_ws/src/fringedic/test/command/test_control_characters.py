"""Texts of other people cannot command the terminal: names of topics, keys of files."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.table import Table
from typer.testing import CliRunner

from fringedic.command import main
from fringedic.command.app import VisibleConsole, app
from fringedic.command.progress import LiveProgress
from fringedic.recording import BagWriter, Topic

HOSTILE = "\x1b]0;title\x07\x1b[2J\x9b31m\u202e"
SHOWN = "␛]0;title␇␛[2J�31m�"


def test_names_of_topics_are_shown(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_recorded_topic(Topic(f"/a{HOSTILE}", "x/msg/Y", "uint8[] data", "ros2msg", "", ""))
        writer.write(f"/a{HOSTILE}", b"", 0, 0)
    done = CliRunner().invoke(app, ["info", str(tmp_path / "bag")])
    assert "\x1b" not in done.output
    assert "/a␛]0;title" in done.output


def test_keys_of_files_are_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "region.yaml"
    file.write_text('"a\\e[2Jb": 1\n')
    monkeypatch.setattr(main, "_interrupt_at_end_of_session", lambda: None)
    monkeypatch.setattr("sys.argv", ["fringedic", "report", "absent", "--region", f"a={file}"])
    with pytest.raises(SystemExit):
        main.main()
    assert "a␛[2Jb" in capsys.readouterr().err


def test_tables_and_progress_keep_their_form() -> None:
    terminal = io.StringIO()
    console = VisibleConsole(width=60, force_terminal=True, file=terminal, color_system=None)
    table = Table("topic", "messages")
    table.add_row(HOSTILE, "5")
    console.print(table)
    with LiveProgress(console) as progress:
        progress.stage(HOSTILE)
        progress.note(f"tab\tend\n{HOSTILE}")
    written = terminal.getvalue()
    assert SHOWN.replace("␇", "") in written.replace("␇", "")
    assert "tab" in written
    assert "\x1b]0" not in written
    assert "\x1b[2J" not in written
    assert "\x1b[?25h" in written  # of the progress bar, which shows the cursor again
