"""What several sensors cannot measure is refused before a node is started."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from fringedic.command.main import app
from fringedic.configuration.rig_sensors import load_rig_sensors
from fringedic.errors import CalibrationError, ConfigurationError
from fringedic_bringup.procedures.run_sensors import load_sensors

CONFIG = Path(__file__).parents[1] / "config"
TWO = (CONFIG / "two_sensors.yaml").read_text()
MOVING = "continuous: {to_mm: 0.5, speed_mm_per_s: 0.001}"


def test_a_moving_specimen_is_measured_by_one_sensor(tmp_path: Path) -> None:
    path, programme = tmp_path / "two.yaml", tmp_path / "moving.yaml"
    path.write_text(TWO)
    programme.write_text(MOVING)
    with pytest.raises(ConfigurationError, match="would be in another place for each: measure it step by step, or"):
        load_sensors(load_rig_sensors(path), path, programme)


def test_a_file_that_is_no_registration_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "two.yaml"
    path.write_text(f"registration: registration.yaml\n{TWO}")
    (tmp_path / "registration.yaml").write_text("poses: {}")
    with pytest.raises(CalibrationError, match=r"registration.yaml: .*"):
        load_sensors(load_rig_sensors(path), path, None)


def test_the_specimen_of_a_programme_is_that_of_all_sensors(tmp_path: Path) -> None:
    path, programme = tmp_path / "two.yaml", tmp_path / "programme.yaml"
    path.write_text(TWO)
    programme.write_text("{ramp: {to_mm: 0.5, steps: 2}, specimen: {name: plate 7}}")
    sensors, _ = load_sensors(load_rig_sensors(path), path, programme)
    assert [rig.specimen.name for rig in sensors.rigs] == ["plate 7", "plate 7"]


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["run", "--continue"], "--continue needs --output, the folder of the run to go on with"),
        (["run", "--images", "."], "--images: is not possible for several sensors"),
        (["operate"], "the page shows one sensor, and the rig has left, right. Set up each of them in a terminal"),
        (["operate"], "two_sensors.yaml', and look at its folder in the browser with 'fringedic view FOLDER/bag"),
        (["calibrate"], "has the sensors left, right: choose one with --sensor left"),
        (["run", "--sensor", "top"], "has no sensor 'top', but the sensors left, right"),
    ],
)
def test_commands_name_what_is_not_possible(words: list[str], sentence: str) -> None:
    command, *options = words
    done = CliRunner().invoke(app, [command, str(CONFIG / "two_sensors.yaml"), *options])
    said = f"{done.output} {done.exception}"
    assert sentence in " ".join(said.split()), said
