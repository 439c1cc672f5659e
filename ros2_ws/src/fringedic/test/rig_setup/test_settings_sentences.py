"""Sentences about measurements before a test and about programmes: what they contain for given data."""

from __future__ import annotations

import dataclasses
from math import nan

import numpy as np
import pytest

from fringedic.metadata import NoiseFloorMetadata
from fringedic.rig_setup.advice import Advice, SettingsProblem, SettingsWarning
from fringedic.rig_setup.projector_sentences import timing_sentences
from fringedic.rig_setup.refresh import Refresh
from fringedic.rig_setup.settings_sentences import noise_floor_text, settings_report, warning_sentence
from fringedic.rig_setup.timing import ProjectorTiming

ADVICE = Advice(
    shape=(480, 640),
    full_scale=4095,
    quantisation=1,
    saturated=0.001,
    dark=0.0,
    grey_range=(400, 3600),
    coverage=0.5,
    image_noise=31.0,
    contrast=614.0,
    feature_size=(4.6, 4.8),
    mean_gradient=380.0,
    window=40,
    spacing=10,
    strain_window=5,
    binning=1,
    period=44.0,
    noise=(0.0094, 0.0091),
    noise_predicted=(0.0095, 0.0092),
    noise_temporal=(0.0067, 0.0066),
    bias=(0.0002, -0.0001),
    strain_noise=(2e-4, 2e-4, 1.5e-4),
    wanted_noise=0.0095,
    wanted_period=None,
    pixel_size=50e-6,
    table=((16, 0.024, 17.0), (32, 0.0116, 35.0)),
    warnings=(SettingsWarning(SettingsProblem.SATURATED, 0.02, 0.005),),
)
TIMING = ProjectorTiming(
    delay=0.037,
    delay_sigma=3e-5,
    earliest=0.002,
    jitter=0.0,
    rise=0.0,
    fall=0.0,
    dark=4.0,
    bright=110.0,
    noise=1e-3,
    refresh=Refresh(60.0, 1e-4, np.repeat([2.5, 0.0], [24, 36])),
    exposure_time=3e-3,
    samples=300,
)


@pytest.mark.parametrize(
    "line",
    [
        "image resolution             640 x 480 px",
        "window (width of the subset) 40 px (2 mm), 8.5 features",
        "virtual strain gauge         80 px (4 mm): strain window + window - 1",
        "displacement, spatial        0.0094 / 0.0091 px (0.47 / 0.455 µm)",
        "strain e_xx / e_yy / e_xy    200 / 200 / 150 µstrain",
        "32 px   0.0116 px     35 px",
        "- 2.0 % of the pixels are saturated: shorten the exposure or reduce reflections",
    ],
)
def test_lines_of_recommended_settings(line: str) -> None:
    assert line in settings_report(ADVICE)


def test_settings_without_pixel_size_and_full_scale() -> None:
    text = settings_report(dataclasses.replace(ADVICE, pixel_size=None, full_scale=nan, saturated=nan))
    assert " mm" not in text
    assert "full scale                   not known" in text


@pytest.mark.parametrize(
    ("problem", "value", "limit", "words"),
    [
        (SettingsProblem.NOISE_OUT_OF_REACH, 0.002, 700, "needs a subset of 700 px, more than these images allow"),
        (SettingsProblem.PERIOD_TOO_FEW_FEATURES, 4, 3, "waves of 4 px lose more than 10 %"),
        (SettingsProblem.PERIOD_TOO_NOISY, 30, 0.014, "noise of 0.014 px, and 0.0095 px are requested"),
        (SettingsProblem.SMALL_FEATURES, 2.1, 3, "features of 2.1 px are small: below 3 px they alias"),
        (SettingsProblem.LARGE_FEATURES, 9, 7, "features of 9.0 px are large"),
        (SettingsProblem.SATURATED, 0.02, 0.005, "2.0 % of the pixels are saturated"),
        (SettingsProblem.DARK, 0.03, 0.01, "3.0 % of the pixels are black"),
        (SettingsProblem.UNDEREXPOSED, 0.4, 0.5, "reach 40 % of the range"),
        (SettingsProblem.QUANTISED, 0.2, 0.5, "less than half a grey level"),
        (SettingsProblem.EXCESS_NOISE, 0.03, 0.01, "scatters by 0.03 px, image noise explains 0.01 px"),
        (SettingsProblem.MOVED, 0.3, 0.05, "moved by 0.3 px: the images are not static"),
        (SettingsProblem.PERIODIC, 12, 6, "repeats every 12.0 px (0.6 mm): a displacement of more than 6.0 px between"),
        (SettingsProblem.FAINT, 2.34, 3, "only 2.3 times that of noise, the texture is faint, and fewer points are"),
    ],
)
def test_each_warning_has_a_sentence(problem: SettingsProblem, value: float, limit: float, words: str) -> None:
    assert words in warning_sentence(SettingsWarning(problem, value, limit), ADVICE)


def test_sentences_of_averaged_pixels() -> None:
    binned = dataclasses.replace(ADVICE, window=10, binning=4)
    assert "(width of the subset) 10 px with binning by 4: 40 px (2 mm), 8.5 features" in settings_report(binned)
    assert "virtual strain gauge         80 px" in settings_report(binned)
    assert "measure ... --window 10 --spacing 10" in settings_report(binned)
    sentence = warning_sentence(SettingsWarning(SettingsProblem.FAINT, 1.1, 3), binned)
    assert "blocks of 4 x 4 px are averaged, and a window of 10 px is a subset of 40 px" in sentence


def test_timing_of_pulsing_light() -> None:
    delay, refresh, settle, motion = timing_sentences(TIMING, 0.010, 0.005)
    assert "A pattern is visible 37.00 ms after the request (standard uncertainty 0.03 ms)" in delay
    assert "time constant" not in delay
    assert "pulses at 60.00 Hz" in refresh
    assert "one of 16.6667 ms (1 x 16.6667 ms)" in refresh
    assert "A settle time of 5 ms is too short: a pattern needs 37.1 ms" in settle
    assert "about 14 frames per second are taken" in motion, "22 + 10 + 37.1 ms"
    assert (
        "up to 0.10 fringes from frame to frame, 1.4 fringes per second (condition 1.9; motion blur leaves 100 % of the"
        in motion
    )
    assert "allows 4.1 fringes per second" in motion
    assert "A settle time of 50 ms is enough" in timing_sentences(TIMING, 0.010, 0.050)[2]


def test_timing_of_steady_and_slow_light() -> None:
    slow = dataclasses.replace(TIMING, refresh=None, rise=5e-3, fall=4e-3)
    delay, refresh, *_ = timing_sentences(slow, 0.010, 0.005)
    assert "rises with a time constant of 5.0 ms and falls with one of 4.0 ms" in delay
    assert refresh == "The light is steady."


def test_timing_with_an_unknown_delay() -> None:
    fast = dataclasses.replace(TIMING, delay=nan, delay_sigma=nan, jitter=nan)
    assert "before the camera can begin an exposure" in timing_sentences(fast, 0.01, 0.0)[0]


def test_noise_floor_as_text() -> None:
    metadata = NoiseFloorMetadata(
        steps=10,
        read_noise_grey_level=1.6,
        shot_noise_grey_level=0.03,
        flicker_percent=0.4,
        window_px=32,
        spatial={"u_um": 1.234},
        predicted={"u_um": 1.2},
    )
    text = noise_floor_text(metadata)
    assert "noise floor of 10 steps at rest" in text
    assert "camera: 1.6 grey levels without light, and a variance of 0.03 per grey level" in text
    assert "displacement u [µm]                       1.234            -            -          1.2" in text
    assert text.endswith("with window 32 px")
