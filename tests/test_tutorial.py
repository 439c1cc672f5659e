"""The tutorial names commands, options and files that exist, and its rig file is valid.

The commands themselves run in the tests of the running system; here the page is compared with them.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from typer.main import get_command

from fringedic.command.main import app
from fringedic.command.plugins import load_commands
from fringedic.configuration import load_rig_file

PAGE = Path(__file__).parents[1] / "docs" / "tutorial.md"
TEXT = PAGE.read_text(encoding="utf-8")
LINES = [
    line
    for block in re.findall(r"```sh\n(.*?)```", TEXT, re.DOTALL)
    for line in block.splitlines()
    if line.startswith("fringedic ")
]


@pytest.mark.parametrize("line", LINES)
def test_command_and_options_exist(line: str) -> None:
    _, name, *arguments = shlex.split(line, comments=True)
    load_commands()
    commands = get_command(app).commands
    assert name in commands
    known = {option for parameter in commands[name].params for option in parameter.opts}
    assert {argument for argument in arguments if argument.startswith("--")} <= known


def test_rig_file_is_valid(tmp_path: Path) -> None:
    block = re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)[0]
    path = tmp_path / "my_rig.yaml"
    path.write_text(block, encoding="utf-8")
    rig = load_rig_file(path)
    assert rig.programme is not None
    assert len(rig.programme.load_steps()) == 7
    for key in ("calibration", "noise_floor_file"):
        assert f"echo '{key}: " in TEXT
        assert key in type(rig).model_fields


def test_late_rig_differs_from_the_rig_of_the_page() -> None:
    """The two `sed` lines of the page find what they replace."""
    for pattern in re.findall(r"sed (?:-i )?'s/(.*?)/", TEXT):
        assert pattern in re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL)[0]
