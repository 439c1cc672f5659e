"""The page on setting up names commands, options, files and keys that exist."""

from __future__ import annotations

import re
from pathlib import Path

from typer.main import get_command

from fringedic.configuration.rig_file import load_rig_file
from fringedic_bringup.command.main import app

PAGE = Path(__file__).parents[4] / "docs" / "setting_up.md"


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


def test_commands_and_options_exist() -> None:
    commands = get_command(app).commands
    used = re.findall(r"`fringedic ([a-z]+)([^`]*)`", PAGE.read_text())
    assert {"live", "timing", "response", "calibrate", "check", "noise", "advise", "run", "report"} <= {
        name for name, _ in used
    }
    for name, rest in used:
        assert name in commands, f"there is no command {name}"
        known = {option for parameter in commands[name].params for option in parameter.opts}
        assert set(re.findall(r"--[a-z-]+", rest)) <= known, rest


def test_links_lead_somewhere() -> None:
    for target in re.findall(r"\]\(([^)#]+)", PAGE.read_text()):
        assert (PAGE.parent / target).exists(), target
