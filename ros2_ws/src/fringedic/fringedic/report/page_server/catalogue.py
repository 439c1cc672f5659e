"""The tests of a rig: their folders with specimen, operator, date, verdict and a small picture."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from fringedic.configuration.test_card import Card, load_card
from fringedic.configuration.test_form import DEFAULT_FORM, SPECIMEN, answers_of
from fringedic.datasets import open_experiment
from fringedic.datasets.attributes import recorded_metadata
from fringedic.datasets.opening import RESULTS
from fringedic.errors import FringedicError, OperatorError
from fringedic.figures.palettes import palette
from fringedic.frames.sensor import SENSOR, file_of
from fringedic.metadata import SpecimenMetadata
from fringedic.report.page_server.maps import tile
from fringedic.report.page_server.recorded import RecordedRig
from fringedic.wording.translation import Sentence, translatable

MOST_TESTS = 200  # of the list, the latest ones
SMALL_PX = 96  # largest side of the small picture of a test
_PICTURED = ("v", "u", "displacement_y", "shape_z")  # maps of the small picture, the first one that is measured
_SHOWN_SHARE = (2, 98)  # percentiles at the ends of its colours
_OPENED = 4  # tests that stay open


class Found(NamedTuple):
    """What the dataset of a test contains: its specimen, and the number of its steps and of those that failed."""

    specimen: SpecimenMetadata
    steps: int
    failed: int


@dataclass(frozen=True)
class RecordedTest:
    """A folder with a recording.

    Attributes
    ----------
    folder
        The folder.
    when
        Time of its last change [s].
    has_report
        Whether it has a report.
    results
        Its dataset; None before it is written.
    card
        What was entered before it; None of a test that was started elsewhere.
    planned
        Largest number of measured steps of its programme; None when it is not known, as with measured moves.
    found
        What is in its dataset; None without one, and until it has been read.
    """

    folder: Path
    when: float
    has_report: bool
    results: Path | None = None
    card: Card | None = None
    planned: int | None = None
    found: Found | None = None

    def shown(self) -> dict[str, Any]:
        """Return name, specimen, operator, entries and verdict for the page."""
        answers = dict(self.card.answers) if self.card is not None else {}
        specimen = self.found.specimen if self.found is not None else None
        if specimen is not None:
            answers = answers_of(DEFAULT_FORM, specimen) | specimen.entries | answers
        state, verdict = self._verdict()
        return {
            "name": self.folder.name,
            "when": self.when,
            "report": self.has_report,
            "results": self.results is not None,
            "specimen": str(answers.get(SPECIMEN, "")),
            "operator": str(answers.get("operator", "")),
            "rig": "" if self.card is None else self.card.rig_file,
            "answers": answers,
            "state": state,
            "verdict": verdict,
            "continues": state == "care" and self.card is not None and self.card.programme is not None,
        }

    def _verdict(self) -> tuple[str, str]:
        """Return good, care or bad, and the words about it."""
        if self.found is None:
            return ("care", translatable("no results")) if self.results is None else ("", "")
        steps, failed = self.found.steps, self.found.failed
        if failed:
            return "bad", Sentence("{failed} of {steps} steps failed", failed=failed, steps=steps)
        if self.planned is not None and steps < self.planned:
            return "care", Sentence("{steps} of at most {planned} steps", steps=steps, planned=self.planned)
        return "good", Sentence("{steps} steps measured", steps=steps)


class Catalogue:
    """The tests in a folder; their datasets are read in a thread of its own, each once after every change."""

    def __init__(self) -> None:
        self._found: dict[Path, tuple[int, Found | None]] = {}
        self._reading: threading.Thread | None = None

    def tests(self, folder: Path | None, sensor: str = SENSOR) -> dict[str, RecordedTest]:
        """Return the tests in a folder by the names of their folders, the latest first.

        Raises
        ------
        OSError
            A folder cannot be read.
        """
        listed = _listed(folder, sensor)
        unread = [each.results for each in listed if each.results is not None and not self._is_read(each.results)]
        if unread and (self._reading is None or not self._reading.is_alive()):
            self._reading = threading.Thread(target=self._read, args=[unread], daemon=True)
            self._reading.start()
        return {each.folder.name: self._with_found(each) for each in listed}

    def _is_read(self, results: Path) -> bool:
        return results in self._found and self._found[results][0] == results.stat().st_mtime_ns

    def _with_found(self, test: RecordedTest) -> RecordedTest:
        found = None if test.results is None else self._found.get(test.results, (0, None))[1]
        return replace(test, found=found)

    def _read(self, files: list[Path]) -> None:
        for file in files:
            try:
                changed = file.stat().st_mtime_ns
            except OSError:  # removed meanwhile
                continue
            try:
                with open_experiment(file) as dataset:
                    failed = int((dataset["error"].values != "").sum())
                    found = Found(recorded_metadata(dataset).specimen, dataset.sizes["step"], failed)
            except (FringedicError, OSError, KeyError, ValueError):  # a damaged one is shown without its content
                found = None
            self._found = {**self._found, file: (changed, found)}


@lru_cache(maxsize=1000)
def _card_of(folder: Path, changed: int) -> tuple[Card | None, int | None]:  # noqa: ARG001 (a key of the cache)
    """Return the card of a test, and the number of measured steps of its programme; None with measured moves."""
    try:
        card = load_card(folder)
    except FringedicError:
        return None, None
    if card is None or card.programme is None:
        return card, None
    modes = [step.mode for step in card.programme.walk()]
    return card, None if "moving" in modes else len(modes) - modes.count("none")


def _listed(folder: Path | None, sensor: str) -> list[RecordedTest]:
    """Return the tests in a folder, the latest first, without the content of their datasets."""
    if folder is None or not folder.is_dir():
        return []
    tests = []
    for each in folder.iterdir():
        if (each / "bag").is_dir():
            report, results = each / "report.html", file_of(each / f"{RESULTS}.nc", sensor)
            has_report = report.is_file()
            when = (report if has_report else each).stat().st_mtime
            card, planned = _card_of(each, each.stat().st_mtime_ns)
            is_there = results.is_file()
            tests.append(RecordedTest(each, when, has_report, results if is_there else None, card, planned))
    tests.sort(key=lambda test: test.when, reverse=True)
    return tests[:MOST_TESTS]


def opened_test(tests: Mapping[str, RecordedTest], name: str) -> RecordedRig:
    """Return the maps and curves of a test.

    Raises
    ------
    OperatorError
        There is no such test, or it has no results yet.
    """
    test = tests.get(name)
    if test is None:
        raise OperatorError(Sentence("there is no test {test}: choose one of the list", test=name[:100]))
    if test.results is None:
        raise OperatorError(
            Sentence("{test} has no results: measure it again from its recording with 'fringedic process'", test=name)
        )
    return _opened(test.results, test.results.stat().st_mtime_ns)


@lru_cache(maxsize=_OPENED)
def _opened(results: Path, changed: int) -> RecordedRig:  # noqa: ARG001 (a key of the cache)
    return RecordedRig(results)


def small_picture(rig: RecordedRig) -> bytes:
    """Return a PNG of a map of the last step that was measured, transparent where it was not.

    Raises
    ------
    OperatorError
        No step has a map.
    """
    for step, names in reversed(rig.maps.names().items()):
        name = next((each for each in _PICTURED if each in names), None)
        if name is not None:
            values = tile(rig.maps, step, name).values
            every = math.ceil(max(values.shape) / SMALL_PX)
            return _coloured(values[::every, ::every])
    raise OperatorError(translatable("no step of this test has a map"))


def _coloured(values: np.ndarray) -> bytes:
    seen = np.isfinite(values)
    low, high = np.percentile(values[seen], _SHOWN_SHARE) if seen.any() else (0.0, 1.0)
    place = np.clip((np.nan_to_num(values) - low) / max(high - low, np.finfo(float).tiny), 0, 1)
    blue_green_red = palette("viridis")[(255 * place).astype(np.uint8)][..., ::-1]
    encoded = cv2.imencode(".png", np.dstack([blue_green_red, 255 * seen.astype(np.uint8)]))[1]
    return bytes(encoded.tobytes())
