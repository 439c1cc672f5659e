"""Declarations of signals: units, calibrations with uncertainty, and what is wrong with them in one sentence."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fringedic.configuration import load_rig_file
from fringedic.errors import ConfigurationError
from fringedic.settings.signals import SerialSignal
from fringedic.signals import Scaling, Uncertain

RIG = """
camera: {source: files, files: images}
load_frame: {source: external}
"""
TOPIC = "source: topic, topic: /thermo/temperature, field: temperature"


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("12.5 +- 0.02 N/V", (12.5, 0.02, "N/V")),
        ("-3e-3±1e-4", (-3e-3, 1e-4, "")),
        ("7 +/- 1 mm", (7.0, 1.0, "mm")),
        (2.5, (2.5, 0.0, "")),
    ],
)
def test_numbers_with_uncertainty_are_read(text: str | float, value: tuple[float, float, str]) -> None:
    assert Uncertain.parse(text) == value


def test_uncertainties_of_reading_scale_and_offset_are_combined() -> None:
    scaling = Scaling.of("mV", "2 +- 0.01 kN/V", "5 +- 0.003 kN", 10.0)
    values, sigmas = scaling.apply(np.array([1000.0, 0.0]))
    assert values.tolist() == pytest.approx([7000.0, 5000.0])
    assert sigmas.tolist() == pytest.approx([np.sqrt(20**2 + 10**2 + 3**2), np.hypot(20, 3)])


def test_temperatures_become_kelvin_and_their_uncertainty_is_not_known_unless_given() -> None:
    values, sigmas = Scaling.of("degC", 1.0, 0.0, None).apply(np.array([20.0]))
    assert values[0] == pytest.approx(293.15)
    assert np.isnan(sigmas[0])


def test_the_channel_has_the_unit_of_the_value() -> None:
    channel = SerialSignal(device="/dev/ttyACM0", unit="V", scale="12.5 N/V", positive="tension").channel("load_2")
    assert channel == ("load_2", "force", "N", "tension", "serial")


@pytest.mark.parametrize(
    ("entries", "reason"),
    [
        (f"grip: {{{TOPIC}, unit: stone}}", "signals.grip: the unit 'stone' is not known; write one such as N, kN"),
        (
            f"grip: {{{TOPIC}, unit: V, scale: 12.5 N}}",
            "the unit of the scale, 'N', needs that of a reading, such as N/V",
        ),
        (f"grip: {{{TOPIC}, unit: V, scale: 12.5 N/K}}", "the scale is per K, but a reading is in V; write it per V"),
        (f"grip: {{{TOPIC}, unit: V, scale: 1 N/V, offset: 3 mm}}", "the offset is in mm, but the value is not"),
        (f"grip: {{{TOPIC}, unit: V, scale: twelve}}", "'twelve' is no number with an uncertainty"),
        (f"grip: {{{TOPIC}, unit: V, scale: 0}}", "scale is 0: every value would be the same"),
        ("grip: {source: topic, topic: /t, field: 1x, unit: V}", "field '1x' is no field of a message"),
        (f"grip: {{{TOPIC}, unit: V, rate_hz: 0.1}}", "silent_after_s 1.5 is shorter than the time between two"),
        (f"grip: {{{TOPIC}, unit: V, rate_hz: 1, required: true}}", "required: true needs a rate_hz of 2 or more"),
        ("grip: {source: laser, unit: V}", "source 'laser' is unknown; known are topic, serial, instrument"),
        (f"force: {{{TOPIC}, unit: N}}", "force is the name of a signal of the load frame; give this one another name"),
        (f"grip: {{{TOPIC}, unit: K}}\n  grip: {{{TOPIC}, unit: K}}", "the key 'grip' is in line"),
    ],
)
def test_what_is_wrong_is_a_sentence(entries: str, reason: str, tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text(f"{RIG}signals:\n  {entries}\n")
    with pytest.raises(ConfigurationError, match=re.escape(reason)) as error:
        load_rig_file(file)
    assert "\n" not in str(error.value)


def test_a_force_without_a_load_frame_is_a_signal_as_others(tmp_path: Path) -> None:
    file = tmp_path / "rig.yaml"
    declared: dict[str, Any] = {"source": "serial", "device": "/dev/ttyUSB0", "unit": "kN"}
    entries = ", ".join(f"{key}: {value}" for key, value in declared.items())
    file.write_text(f"camera: {{source: files, files: images}}\nsignals:\n  force: {{{entries}}}\n")
    assert load_rig_file(file).signals["force"].source == "serial"
