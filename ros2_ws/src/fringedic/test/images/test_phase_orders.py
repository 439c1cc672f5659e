"""Fringe orders of images of other programs under a nonlinear response, noise, and lists of shifts that do not fit.

The images are written from their formula: light (a + b cos)^gamma, texture, noise and 8 bits, on known columns.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fringedic.configuration.fringe_images import FringeImageDescription
from fringedic.errors import FringedicError, PhaseError, StepError
from fringedic.images import measure_phase_images
from fringedic.images.sentences import phase_sentences
from fringedic.images.wave_orders import Wave, solve_orders
from fringedic.phase.harmonic_correction import HarmonicError

TURN = 2 * np.pi
WIDTH = 1024
PITCH = {"pitch_px": 60.0, "images": ["a", "b", "c"]}
HETERODYNE = (1024 / 59, 16.0, 1024 / 70)
ROW, COLUMN = np.mgrid[:120, :320]
PLACE = 60 + 2.8 * COLUMN + 6 * np.sin(ROW / 25) * np.sin(COLUMN / 40) + 25.0 * ((ROW > 60) & (COLUMN > 160))


def profile(gamma: float, blur: float) -> np.ndarray:
    """Light over one period, 512 steps, whose harmonic m is attenuated by a blur [periods]."""
    light = (0.52 + 0.48 * np.cos(TURN * np.arange(512) / 512)) ** gamma
    harmonics = np.fft.rfft(light)
    return np.fft.irfft(harmonics * np.exp(-2 * (np.pi * blur * np.arange(len(harmonics))) ** 2))


def write(
    folder: Path,
    pitches: tuple[float, ...],
    shifts: int,
    *,
    gamma: float = 1.0,
    noise: float = 1.0,
    blur: float = 0.0,
    place: np.ndarray = PLACE,
    seed: int = 0,
) -> dict[str, Any]:
    """Write images of the shifts 1, 2, ... q of each pitch; return their description. `blur` in projector px."""
    random = np.random.default_rng(seed)
    reflectance = np.clip(1 + cv2.GaussianBlur(random.normal(0, 0.9, place.shape), (0, 0), 2), 0.4, 1.6)
    fringes = []
    for pitch in pitches:
        light = profile(gamma, blur / pitch)
        names = []
        for k in range(1, shifts + 1):
            seen = np.interp(place / pitch - k / shifts, np.arange(512) / 512, light, period=1)
            image = 3 + 150 * reflectance * seen + random.normal(0, noise, place.shape)
            names.append(f"p{pitch:.0f}_{k}.png")
            cv2.imwrite(str(folder / names[-1]), np.clip(np.round(image), 0, 255).astype(np.uint8))
        fringes.append({"pitch_px": pitch, "images": names})
    return {"projector_px": WIDTH, "origin_px": 0, "fringes": fringes}


def listed(content: dict[str, Any], order: list[int], pitches: tuple[int, ...]) -> dict[str, Any]:
    """List the images of some pitches in another order than that of their shifts."""
    fringes = [
        {**each, "images": [each["images"][k - 1] for k in order]} if number in pitches else each
        for number, each in enumerate(content["fringes"])
    ]
    return {**content, "fringes": fringes}


def described(content: dict[str, Any]) -> FringeImageDescription:
    return FringeImageDescription.model_validate(content)


@pytest.mark.parametrize(
    ("pitches", "shifts", "options", "least"),
    [
        ((1024.0, 32.0), 3, {"gamma": 2.2, "noise": 1.0}, 0.95),
        ((1024.0, 32.0), 3, {"gamma": 2.2, "noise": 1.5}, 0.7),  # beside this noise the frames show no contradiction
        ((1024.0, 32.0), 3, {"gamma": 2.2, "blur": 6.0}, 0.95),  # the fine fringes show hardly any harmonic
        ((1024.0, 128.0, 32.0), 3, {"gamma": 2.2}, 0.999),
        ((1024.0, 32.0), 4, {"gamma": 2.2}, 0.999),
        ((1024.0, 16.0), 4, {"noise": 1.5}, 0.6),
    ],
)
def test_no_order_is_wrong(
    tmp_path: Path, pitches: tuple[float, ...], shifts: int, options: dict[str, float], least: float
) -> None:
    measured = measure_phase_images(tmp_path, described(write(tmp_path, pitches, shifts, **options)))
    error = measured.coordinate.values - PLACE
    assert int((np.abs(error) > 0.5 * pitches[-1]).sum()) == 0
    share = float(measured.valid.mean())
    assert share > least
    assert measured.attrs["uncertain_orders"] == pytest.approx(1 - share, abs=0.002)
    assert (share < 0.999) == any("left out" in each for each in phase_sentences(measured))


def test_a_view_of_a_part_of_the_coarse_fringe_is_measured(tmp_path: Path) -> None:
    """Errors of the coarse phase that differ by a fringe of 32 px explain the images nearly as well."""
    place = 690 + 0.1 * COLUMN + 2 * np.sin(ROW / 25)
    content = write(tmp_path, (1024.0, 32.0), 3, gamma=2.2, place=place)
    measured = measure_phase_images(tmp_path, described(content))
    assert float(measured.valid.mean()) > 0.9
    assert float(np.nanmax(np.abs(measured.coordinate.values - place))) < 16


def test_the_finest_pitch_is_corrected_after_its_orders(tmp_path: Path) -> None:
    content = write(tmp_path, (1024.0, 32.0), 3, gamma=2.2)
    plain = measure_phase_images(tmp_path, described(content))
    corrected = measure_phase_images(tmp_path, described({**content, "correct_harmonics": True}))
    assert float(np.nanstd(plain.coordinate.values - PLACE)) > 0.9
    error = corrected.coordinate.values - PLACE
    assert float(np.nanstd(error)) < 0.12
    assert 0.9 < float(np.nanstd(error / corrected.sigma.values)) * TURN / 32 < 1.15
    assert 0.8 < float(np.nanmedian(np.abs(corrected.closure))) / 0.6745 < 1.3
    assert plain.attrs["harmonic_error"] == corrected.attrs["harmonic_error"] == pytest.approx(0.0325, abs=0.004)


def test_noise_that_leaves_most_orders_uncertain_is_refused(tmp_path: Path) -> None:
    content = write(tmp_path, (1024.0, 32.0), 4, noise=4.5)
    with pytest.raises(PhaseError, match=r"pitch 1024 px does not determine .* of pitch 32 px: .*or a pitch between"):
        measure_phase_images(tmp_path, described(content))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("shifts", [3, 4])
def test_good_images_lose_no_points(tmp_path: Path, shifts: int, seed: int) -> None:
    measured = measure_phase_images(tmp_path, described(write(tmp_path, (1024.0, 128.0, 16.0), shifts, seed=seed)))
    assert bool(measured.valid.all())
    assert float(np.abs(measured.coordinate.values - PLACE).max()) < 8


@pytest.mark.parametrize("origin", [0.0, 37.3, 511.5])
def test_the_beat_of_two_pitches_has_their_origin(origin: float) -> None:
    """Three shifts, gamma 2.2; the code gives the order of the beat, which has 900 px, 15 of the coarser fringes."""
    response, random = HarmonicError(3, 0.27), np.random.default_rng(1)
    waves = []
    for pitch in (60.0, 56.25):
        true = TURN * (PLACE - origin) / pitch
        raw = true + response.at(true) + random.normal(0, 0.01, PLACE.shape)
        start = TURN * origin / pitch
        waves.append(Wave(pitch, np.angle(np.exp(1j * raw)) + start, np.full(PLACE.shape, 0.01), 3, start))
    code = {"block_px": 256.0, "images": ["a", "b"]}
    description = described({"projector_px": WIDTH, "origin_px": origin, "fringes": [PITCH, PITCH], "gray_code": code})
    solved = solve_orders(waves, np.floor((PLACE + 0.5) / 256), description)
    error = solved.phase.values * 56.25 / TURN - PLACE
    assert float(np.nanmax(np.abs(error))) < 28
    assert solved.uncertain < 0.01


@pytest.mark.parametrize(
    ("pitches", "shifts", "order", "chosen", "words"),
    [
        ((1024.0, 32.0), 4, [4, 3, 2, 1], (0,), r"pitch 1024 px reversed: shifts \[4, 3, 2, 1\]"),
        ((1024.0, 32.0), 4, [4, 3, 2, 1], (1,), r"^the images fit .* pitch 32 px reversed: shifts \[4, 3, 2, 1\]"),
        ((1024.0, 32.0), 4, [4, 3, 2, 1], (0, 1), r"^the images fit .* 1024 and 32 px reversed: shifts \[4, 3, 2, 1\]"),
        ((1024.0, 32.0), 4, [3, 2, 1, 4], (1,), r"pitch 32 px reversed but for the last one: shifts \[3, 2, 1, 4\]"),
        ((1024.0, 32.0), 4, [4, 1, 2, 3], (0, 1), r"^the images fit .* 1024 and 32 px begun with .* \[4, 1, 2, 3\]"),
        ((1024.0, 32.0), 3, [3, 2, 1], (0,), r"^the images fit .* pitch 1024 px reversed: shifts \[3, 2, 1\]"),
        ((1024.0, 32.0), 3, [3, 2, 1], (0, 1), r"^the images fit .* 1024 and 32 px reversed: shifts \[3, 2, 1\]"),
        (HETERODYNE, 4, [4, 3, 2, 1], (1,), r"^the images fit .* pitch 16 px reversed: shifts \[4, 3, 2, 1\]"),
        (HETERODYNE, 4, [4, 3, 2, 1], (0, 1, 2), r"16 and 14.6286 px reversed: shifts \[4, 3, 2, 1\]"),
    ],
)
def test_lists_that_run_backwards_or_begin_elsewhere_are_named(
    tmp_path: Path, pitches: tuple[float, ...], shifts: int, order: list[int], chosen: tuple[int, ...], words: str
) -> None:
    content = listed(write(tmp_path, pitches, shifts), order, chosen)
    with pytest.raises(StepError, match=words):
        measure_phase_images(tmp_path, described(content))


def test_lists_that_mirror_the_column_are_reported(tmp_path: Path) -> None:
    """All phases have the other sign: no image contradicts another, but the column falls to the right."""
    content = write(tmp_path, (1024.0, 32.0), 4)
    backwards = measure_phase_images(tmp_path, described(listed(content, [3, 2, 1, 4], (0, 1))))
    assert any("falls to the right" in each and "reverse" in each for each in phase_sentences(backwards))
    forwards = measure_phase_images(tmp_path, described(content))
    assert not any("falls" in each for each in phase_sentences(forwards))


def test_heterodyne_pitches_are_measured_or_refused_for_their_harmonics(tmp_path: Path) -> None:
    measured = measure_phase_images(tmp_path, described(write(tmp_path, HETERODYNE, 4)))
    assert float(measured.valid.mean()) > 0.999
    assert float(np.nanmax(np.abs(measured.coordinate.values - PLACE))) < 0.5
    content = write(tmp_path, HETERODYNE, 3, gamma=2.2)
    with pytest.raises(FringedicError, match=r"agree at 0 % of the measured points only: set correct_harmonics"):
        measure_phase_images(tmp_path, described(content))
    corrected = measure_phase_images(tmp_path, described({**content, "correct_harmonics": True}))
    assert float(corrected.valid.mean()) > 0.99
    assert float(np.nanmax(np.abs(corrected.coordinate.values - PLACE))) < 0.5
