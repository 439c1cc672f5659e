"""Sentences about the time of a programme and about the conditions that end its moves."""

from __future__ import annotations

import dataclasses
from math import nan

import pytest

from fringedic.configuration.conditions import MetCondition
from fringedic.configuration.forecast import Forecast
from fringedic.configuration.programme import BlockEnd
from fringedic.configuration.sentences import block_end_sentence, condition_sentence, forecast_sentence


def test_forecast() -> None:
    forecast = Forecast(14, 13, 121, 15000, duration=610.0, writing=80.0, size=2.5e9, early=True)
    sentence = forecast_sentence(forecast)
    assert sentence.startswith("at most 14 steps, 121 frames and 15 000 of the free run: about 10 min, then 80 s for")
    assert sentence.endswith("2.5 GB of disk space")
    short = dataclasses.replace(forecast, early=False, free_frames=0, duration=7500.0, size=3e8)
    assert forecast_sentence(short).startswith("14 steps, 121 frames: about 2 h 05 min")
    assert forecast_sentence(short).endswith("300 MB of disk space")


@pytest.mark.parametrize(
    ("condition", "sentence"),
    [
        (MetCondition("force", 10.0, 10.0, rising=True, unit="N"), "the force of 10 N reached 10 N"),
        (MetCondition("force", -11.0, -10.0, rising=False, unit="N"), "the force of -11 N fell to -10 N"),
        (MetCondition("strain", 2.01, 2.0, rising=True, unit="%"), "the strain of 2.01 % reached 2 %"),
        (MetCondition("strain", nan, 2.0, rising=True, unit="%"), "the strain is not known"),
        (MetCondition("valid fraction", 0.5, 0.6, rising=False), "the valid fraction of 0.5 fell to 0.6"),
        (MetCondition("temperature_grip", 321.0, 320.0, rising=True), "the temperature_grip of 321 reached 320"),
    ],
)
def test_conditions(condition: MetCondition, sentence: str) -> None:
    assert condition_sentence(condition) == sentence
    assert block_end_sentence(BlockEnd("ramp", condition)) == f"ramp ended: {sentence}"
