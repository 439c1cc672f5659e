"""The phase from images of other programs: their conventions, their mistakes, and a real object."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter

from fringedic.configuration.fringe_images import FringeImageDescription
from fringedic.errors import ConfigurationError, FringedicError, ImageError, PhaseError, StepError
from fringedic.images import measure_phase_images
from fringedic.images.sentences import phase_sentences
from fringedic.virtual_rig import FringeScene

WIDTH, BLOCK, SHIFTS = 640, 64.0, 4
PITCHES = (128 / 3, 64.0)  # their beat has a period of two blocks
SCENE = FringeScene(rows=160, columns=320, seed=4, grey=70.0, first_column=20.0, last_column=600.0, relief=6.0)
COLUMN = np.arange(WIDTH)
SHARED = Path(__file__).parents[6] / "shared" / "data"
REAL = Path(os.environ.get("FRINGEDIC_DATA", SHARED)) / "fringes_object"
DESCRIPTIONS = Path(__file__).parents[5] / "docs" / "examples"
Content = dict[str, Any]


def save(folder: Path, name: str, shown: np.ndarray, number: int) -> str:
    image = np.clip(np.round(255 * shown), 0, 255).astype(np.uint8)
    cv2.imwrite(str(folder / name), SCENE.expose(image[None], number))
    return name


@pytest.fixture(scope="module")
def stack(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Content]:
    """Images whose shifts run the other way, whose phase begins at column 0, and a Gray code with inverses."""
    folder = tmp_path_factory.mktemp("images")
    fringes = []
    for number, pitch in enumerate(PITCHES):
        names = [
            save(
                folder,
                f"p{pitch:.0f}_{k}.png",
                0.5 + 0.5 * np.cos(2 * np.pi * (COLUMN / pitch + k / SHIFTS)),
                10 * number + k,
            )
            for k in range(SHIFTS)
        ]
        fringes.append({"pitch_px": pitch, "images": names, "shifts": [4, 3, 2, 1]})
    block = (COLUMN // BLOCK).astype(int)
    code = []
    for bit in (3, 2, 1, 0):
        bright = ((block ^ (block >> 1)) >> bit & 1).astype(float)
        code += [save(folder, f"bit{bit}.png", bright, 20 + bit), save(folder, f"not{bit}.png", 1 - bright, 30 + bit)]
    gray_code = {"block_px": BLOCK, "images": code, "inverted": True}
    return folder, {"projector_px": WIDTH, "origin_px": 0, "fringes": fringes, "gray_code": gray_code}


def described(content: Content, tmp_path: Path) -> FringeImageDescription:
    path = tmp_path / "phase.yaml"
    path.write_text(yaml.safe_dump(content))
    return FringeImageDescription.load(path)


def test_images_of_another_program_give_the_columns_of_the_projector(
    stack: tuple[Path, Content], tmp_path: Path
) -> None:
    folder, content = stack
    measured = measure_phase_images(folder, described(content, tmp_path))
    error = measured.coordinate.values - SCENE.projector_column
    assert float(measured.valid.mean()) > 0.9
    assert float(np.nanmax(np.abs(error))) < 1.0
    assert int(measured.other_block.sum()) == 0
    score = float(np.nanstd(error / measured.sigma.values)) * 2 * np.pi / PITCHES[0]
    assert 0.9 < score < 1.1
    assert 0.8 < float(np.nanstd(measured.closure)) < 1.3


def test_a_phase_without_orders_is_relative(stack: tuple[Path, Content], tmp_path: Path) -> None:
    folder, content = stack
    alone = {**content, "fringes": content["fringes"][:1]}
    with pytest.raises(PhaseError, match=r"blocks of 64 px .* 85.* px or more"):
        measure_phase_images(folder, described(alone, tmp_path))
    measured = measure_phase_images(folder, described({**alone, "gray_code": None}, tmp_path))
    assert measured.phase.attrs["relative"] == 1


def turn(content: Content, numbers: tuple[int, ...]) -> Content:
    fringes = [{**each, "shifts": [1, 2, 3, 4]} if n in numbers else each for n, each in enumerate(content["fringes"])]
    return {**content, "fringes": fringes}


def swap(content: Content) -> Content:
    first = {**content["fringes"][0], "shifts": [4, 2, 3, 1]}
    return {**content, "fringes": [first, content["fringes"][1]]}


def swap_bits(content: Content) -> Content:
    images = list(content["gray_code"]["images"])
    images[2:4], images[4:6] = images[4:6], images[2:4]
    return {**content, "gray_code": {**content["gray_code"], "images": images}}


def wrong_pitch(content: Content) -> Content:
    return {**content, "fringes": [{**content["fringes"][0], "pitch_px": 30.0}, content["fringes"][1]]}


def other_file(content: Content) -> Content:
    first = {**content["fringes"][0], "images": ["none.png", *content["fringes"][0]["images"][1:]]}
    return {**content, "fringes": [first, content["fringes"][1]]}


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda content: turn(content, (0,)), StepError, "with the list of shifts of pitch 42.6667 px reversed"),
        (lambda content: turn(content, (0, 1)), StepError, "42.6667 px reversed"),
        (lambda content: {**content, "origin_px": 40}, StepError, "displaced by 40 px .*origin_px 0 would fit"),
        (swap, StepError, r"p43_1.png, p43_2.png: frames 5 and 6 are interchanged"),
        (swap_bits, StepError, "bit1.png and bit2.png of the Gray code are interchanged"),
        (wrong_pitch, StepError, r"in the image their pitch is 42\.\d px"),
        (other_file, ImageError, "none.png"),
        (lambda content: {**content, "projector": 3}, ConfigurationError, "projector"),
        (
            lambda content: {**content, "gray_code": {"block_px": 64, "images": ["a", "b", "c"], "inverted": True}},
            ConfigurationError,
            "3 images are not pairs",
        ),
    ],
)
def test_descriptions_that_do_not_fit_are_refused_with_the_correction(
    stack: tuple[Path, Content],
    tmp_path: Path,
    change: Callable[[Content], Content],
    error: type[FringedicError],
    words: str,
) -> None:
    folder, content = stack
    with pytest.raises(error, match=words):
        measure_phase_images(folder, described(change(content), tmp_path))


def test_images_of_two_sizes_are_refused(stack: tuple[Path, Content], tmp_path: Path) -> None:
    folder, content = stack
    cv2.imwrite(str(folder / "small.png"), np.zeros((20, 30), np.uint8))
    fringes = [{**content["fringes"][0], "images": ["small.png", *content["fringes"][0]["images"][1:]]}]
    with pytest.raises(ImageError, match=r"p43_1\.png has 320x160 px, .*small\.png has 30x20 px: give images of one"):
        measure_phase_images(folder, described({**content, "fringes": fringes}, tmp_path))
    code = {**content["gray_code"], "images": ["small.png"] * len(content["gray_code"]["images"])}
    with pytest.raises(ImageError, match=r"small\.png has 30x20 px, .*p64_0\.png has 320x160 px"):
        measure_phase_images(folder, described({**content, "gray_code": code}, tmp_path))


@pytest.fixture(scope="module")
def flickering(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Content, np.ndarray, np.ndarray]:
    """Images of 12 shifts of three pitches, written from their formula, with a gain of 0.95 to 1.05 for each."""
    folder, random = tmp_path_factory.mktemp("flickering"), np.random.default_rng(3)
    row, column = np.mgrid[:160, :320]
    place = 100 + 4.4 * column + 3 * np.sin(row / 40)
    fringes, gains = [], []
    for pitch in (48.0, 45.0, 42.0):
        gain = 1 + 0.05 * random.uniform(-1, 1, 12)
        names = []
        for k in range(12):
            level = gain[k] * (110 + 70 * np.cos(2 * np.pi * (place / pitch - (k + 1) / 12)))
            names.append(f"p{pitch:.0f}_{k}.png")
            image = np.clip(np.round(level + random.normal(0, 1.5, place.shape)), 0, 255).astype(np.uint8)
            cv2.imwrite(str(folder / names[-1]), image)
        fringes.append({"pitch_px": pitch, "images": names})
        gains.append(gain / gain.mean())
    return folder, {"projector_px": 1920, "origin_px": 0, "fringes": fringes}, np.concatenate(gains), place


def test_flicker_of_twelve_shifts_is_fitted_and_reported(
    flickering: tuple[Path, Content, np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    folder, content, gains, place = flickering
    measured = measure_phase_images(folder, described(content, tmp_path))
    assert np.abs(measured.gain.values - gains).max() < 0.002
    assert 0.0001 < float(measured.gain_sigma.mean()) < 0.001
    assert list(measured.frame.values[:2]) == ["p48_0.png", "p48_1.png"]
    assert float(measured.valid.mean()) > 0.999
    error = (measured.coordinate.values - place) * 2 * np.pi / 42
    assert 0.95 < float(np.sqrt(np.nanmean((error / measured.sigma.values) ** 2))) < 1.05
    sentences = list(phase_sentences(measured))
    assert any("light: it changes by" in each and "contained in sigma" in each for each in sentences)


def test_the_limit_of_the_error_by_flicker_is_a_key(
    flickering: tuple[Path, Content, np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    folder, content, _, _ = flickering
    with pytest.raises(StepError, match=r"flicker.*leaves a phase error of .* fringe; 1e-05 is allowed"):
        measure_phase_images(folder, described({**content, "maximum_error_fringe": 1e-5}, tmp_path))


@pytest.mark.skipif(not REAL.is_dir(), reason=f"no real fringes in {REAL}")
@pytest.mark.parametrize("direction", ["vertical", "horizontal"])
def test_orders_of_a_real_object_agree_with_its_gray_code(direction: str) -> None:
    description = FringeImageDescription.load(DESCRIPTIONS / f"fringes_object_{direction}.yaml")
    measured = measure_phase_images(REAL, description.model_copy(update={"correct_harmonics": True}))
    place, valid = measured.coordinate.values, measured.valid.values
    steps = maximum_filter(np.where(valid, place, -1e9), 3) - minimum_filter(np.where(valid, place, 1e9), 3) > 12
    inside = valid & (distance_transform_edt(~(steps | ~valid)) > 5)
    assert float(inside.mean()) > 0.4
    assert float(measured.other_block.values[inside].mean()) <= 1e-4
    assert float(np.nanmedian(np.abs(measured.closure))) / 0.6745 < 5
