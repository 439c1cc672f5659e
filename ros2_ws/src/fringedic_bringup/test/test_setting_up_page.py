"""The pages name commands and options that exist; that on setting up also files and keys."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.core import TyperGroup as Group
from typer.main import get_command

from fringedic.command.main import app
from fringedic.command.plugins import load_commands
from fringedic.configuration.rig_file import load_rig_file

ROOT = Path(__file__).parents[4]
PAGE = ROOT / "docs" / "setting_up.md"
load_commands()
COMMANDS = get_command(app).commands
WITH_COMMANDS = sorted(
    page for page in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")) if "fringedic " in page.read_text("utf-8")
)


def test_rig_file_is_valid(tmp_path: Path) -> None:
    (block,) = re.findall(r"```yaml\n(.*?)```", PAGE.read_text(), re.DOTALL)
    path = tmp_path / "bench.yaml"
    path.write_text(block)
    rig = load_rig_file(path)
    assert rig.programme is not None
    assert len(rig.programme.load_steps()) == 13
    for key in ("calibration", "region_file", "noise_floor_file"):
        assert f"`{key}: " in PAGE.read_text()
        assert key in type(rig).model_fields


def test_setting_up_names_the_commands_of_its_tasks() -> None:
    used = set(re.findall(r"`fringedic ([a-z]+)", PAGE.read_text()))
    assert {"live", "timing", "response", "calibrate", "check", "noise", "advise", "run", "report"} <= used


@pytest.mark.parametrize("page", WITH_COMMANDS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_commands_and_options_exist(page: Path) -> None:
    """In spans of code, and in indented lines until a comment."""
    text = page.read_text(encoding="utf-8")
    lines = re.findall(r"^    (fringedic [^#\n]+)", text, re.MULTILINE) + re.findall(r"`(fringedic [^`]+)`", text)
    for line in lines:
        name, *words = line.split()[1:]
        if name.startswith("--") or name.isupper():
            continue
        assert name in COMMANDS, f"there is no command {name}"
        command = COMMANDS[name]
        if isinstance(command, Group) and words and words[0] in command.commands:
            command = command.commands[words[0]]
        known = {option for parameter in command.params for option in parameter.opts} | {"--help"}
        assert set(re.findall(r"(?<=\s)--[a-z][a-z0-9-]*", line)) <= known, line


def test_links_lead_somewhere() -> None:
    for target in re.findall(r"\]\(([^)#]+)", PAGE.read_text()):
        assert (PAGE.parent / target).exists(), target
