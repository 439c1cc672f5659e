"""Rig files of several sensors: their content, and the errors about content that is not valid."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from fringedic.configuration import RigSensors, load_rig_file, load_rig_sensors
from fringedic.configuration.rig_file import fitting_calibration
from fringedic.errors import ConfigurationError
from fringedic.virtual_rig import VirtualRig

TWO = """
camera: {source: virtual, exposure_ms: 12}
projector: {source: virtual}
sequence: {pitches_px: [100, 20, 5], shifts: 4}
calibration: virtual_rig
load_frame: {source: simulated}
frame_prefix: bench
sensors:
  left: {virtual_rig: {arrangement: plate, place: left, size: tiny}}
  right:
    virtual_rig: {arrangement: plate, place: right, size: tiny}
    sequence: {pitches_px: [100, 20], shifts: 8}
"""
DEVICES = """
sensors:
  left: {{camera: {left}, projector: {{source: display, display: {display}, width: 800, height: 600}}}}
  right: {{camera: {right}, projector: {{source: display, display: 1, width: 800, height: 600}}}}
"""


def write(tmp_path: Path, text: str, name: str = "two.yaml") -> Path:
    file = tmp_path / name
    file.write_text(text)
    return file


def test_each_sensor_has_the_common_sections_and_its_own(tmp_path: Path) -> None:
    file = write(tmp_path, TWO)
    left, right = load_rig_sensors(file).rigs
    assert (left.topic_namespace, right.topic_namespace) == ("rig/left", "rig/right")
    assert (left.frame_prefix, right.frame_prefix) == ("bench/left", "bench/right")
    assert (left.camera.exposure_ms, right.camera.exposure_ms) == (12, 12)
    assert (len(left.pitches()), len(right.pitches())) == (3, 2)
    assert left.rig_model is not None
    assert right.rig_model is not None
    assert (left.rig_model.sensor, right.rig_model.sensor) == ("left", "right")
    x = [rig.virtual_configuration().placement.translation_mm[0] for rig in (left, right)]
    assert x == [-19.0, 19.0]
    assert load_rig_file(file, sensor="right") == right
    assert load_rig_sensors(file, sensor="right") == RigSensors((right,))


def test_the_calibration_of_a_virtual_sensor_contains_both_lenses(tmp_path: Path) -> None:
    """The true phase gives the true height: what a run deviates from it is noise."""
    for rig in load_rig_sensors(write(tmp_path, TWO)).rigs:
        twin = VirtualRig(rig.virtual_configuration())
        columns = twin.view(0.0).projector_column - (twin.projector_shape[1] - 1) / 2
        assert rig.rig_model is not None
        height = rig.rig_model.reconstruct(2 * math.pi / 5.0 * columns, 5.0)["z"]
        error = (height - twin.truth(0.0)["z"]).values
        assert np.isfinite(error).mean() > 0.5
        assert np.nanmax(np.abs(error)) < 1e-9


def test_one_sensor_is_chosen_by_its_name(tmp_path: Path) -> None:
    file = write(tmp_path, TWO)
    with pytest.raises(ConfigurationError, match=r"has the sensors left, right: choose one with --sensor left$"):
        load_rig_file(file)
    with pytest.raises(ConfigurationError, match=r"has no sensor 'top', but the sensors left, right: choose one"):
        load_rig_file(file, sensor="top")
    single = write(tmp_path, "{camera: {source: virtual}, virtual_rig: {preset: plate}}", "one.yaml")
    assert load_rig_sensors(single).names == ["sensor"]
    with pytest.raises(ConfigurationError, match=r"has one sensor only, which is not 'left': leave --sensor out"):
        load_rig_file(single, sensor="left")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("  left:", "  joined:", "it has to be another name than 'joined'"),
        ("  left:", "  sensor:", "sensors.sensor: this name has another meaning"),
        ("  left:", "  le-ft:", "the name of a sensor is 'le-ft': it has to be a name of letters"),
        ("    sequence:", "    load_frame:", "sensors.right.load_frame: is no section of one sensor"),
        ("frame_prefix: bench", "sensor: left", "sensor: is not possible for several sensors"),
        ("frame_prefix: bench", "extensometer: {region_px: [1, 2, 3, 4]}", "needs white light between the steps"),
        ("place: right", "place: top", "sensor right: virtual_rig: arrangement plate has no sensor at place 'top'"),
        ("frame_prefix: bench", "registration: none.yaml", "registration: there is no file .*'fringedic register'"),
        ("frame_prefix: bench", "registration: [1]", "registration: is no path"),
        ("pitches_px: [100, 20], ", "pitch: 3, ", "sensor right: sequence.pitch: unknown key"),
    ],
)
def test_what_several_sensors_cannot_be(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in TWO
    with pytest.raises(ConfigurationError, match=words):
        load_rig_sensors(write(tmp_path, TWO.replace(old, new)))


def test_the_registration_lies_beside_the_rig_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the other paths of a rig file, wherever the command is called, and also where the file is named relatively."""
    (tmp_path / "here").mkdir()
    (tmp_path / "registration.yaml").touch()
    write(tmp_path, TWO.replace("frame_prefix: bench", "registration: registration.yaml"))
    monkeypatch.chdir(tmp_path / "here")
    found = load_rig_sensors(Path("..") / "two.yaml").registration
    assert found is not None
    assert found.is_absolute()
    assert found.samefile(tmp_path / "registration.yaml")


def test_one_sensor_is_none_of_several(tmp_path: Path) -> None:
    text = TWO[: TWO.index("  right:")]
    with pytest.raises(ConfigurationError, match=r"there is only left; write the sections of a single sensor at the"):
        load_rig_sensors(write(tmp_path, text))
    with pytest.raises(ConfigurationError, match=r"sensors: write the name of each sensor with its own sections"):
        load_rig_file(write(tmp_path, "sensors: [left, right]"))


SIZE = "width: 64, height: 48"


@pytest.mark.parametrize(
    ("left", "right", "display", "words"),
    [
        ("source: topic, topic: /a", "source: topic, topic: /a", 0, "camera"),
        ("source: aravis", "source: aravis", 0, "camera .*the only one"),
        ("source: aravis, camera: A", "source: topic, topic: A", 1, "projector .*display 1"),
    ],
)
def test_sensors_have_devices_of_their_own(tmp_path: Path, left: str, right: str, display: int, words: str) -> None:
    cameras = {"left": f"{{{left}, {SIZE}}}", "right": f"{{{right}, {SIZE}}}"}
    with pytest.raises(ConfigurationError, match=f"'left' and 'right' have the same {words}"):
        load_rig_sensors(write(tmp_path, DEVICES.format(**cameras, display=display)))


def test_devices_of_their_own_are_accepted(tmp_path: Path) -> None:
    cameras = {name: f"{{source: v4l2, camera: /dev/{name}, {SIZE}}}" for name in ("left", "right")}
    assert load_rig_sensors(write(tmp_path, DEVICES.format(**cameras, display=0))).names == ["left", "right"]


def test_calibrations_of_exchanged_sensors_are_refused(tmp_path: Path) -> None:
    left, right = load_rig_sensors(write(tmp_path, TWO)).rigs
    for rig in (left, right):
        assert rig.rig_model is not None
        rig.rig_model.to_yaml(tmp_path / f"{rig.sensor}.yaml")
    exchanged = left.with_calibration(tmp_path / "right.yaml")
    with pytest.raises(ConfigurationError, match=r"is that of the sensor 'right', this is the sensor 'left'"):
        fitting_calibration(exchanged, tmp_path / "two.yaml")
