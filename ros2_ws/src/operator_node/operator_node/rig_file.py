"""What the page shows of the rig file: programme, region, calibration; read again after each change."""

from __future__ import annotations

import math
import time
from contextlib import suppress
from datetime import UTC, datetime
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any

import yaml

from fringedic.calibration.sentences import in_force_words
from fringedic.configuration.forecast import forecast
from fringedic.configuration.known_rigs import known_rigs
from fringedic.configuration.programme import Programme
from fringedic.configuration.programme_check import check_programme, parse_programme
from fringedic.configuration.rig_file import RigFile, load_rig_file
from fringedic.configuration.sections import VIRTUAL_RIG
from fringedic.configuration.sentences import forecast_sentence
from fringedic.configuration.test_form import answered_specimen, answers_of, specimen_field
from fringedic.configuration.test_series import Series, load_series, series_file
from fringedic.errors import FringedicError, OperatorError
from fringedic.frames.region import Region
from fringedic.frames.sensor import SENSOR
from fringedic.report.page_server.catalogue import Catalogue, RecordedTest, opened_test
from fringedic.report.page_server.recorded import RecordedRig
from fringedic.wording.causes import cause_of
from fringedic.wording.yaml_text import load_yaml

MOST_ROWS = 1000  # of the programme table
LOOK_S = 3.0  # between two looks for tests
BEFORE = ".before-"  # in the name of a rig file before a change


class ShownRigFile:
    """Programme, region and calibration of a rig file, as plain values.

    Parameters
    ----------
    path
        The rig file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._changed = -1
        self._shown: dict[str, Any] = {}
        self._tests: dict[str, RecordedTest] = {}
        self._shown_tests: list[dict[str, Any]] = []
        self._series: tuple[int, dict[str, Any]] = (-1, {})
        self._rigs: list[str] = []
        self._elsewhere: list[str] = []
        self._catalogue = Catalogue()
        self._looked = -math.inf
        self._recordings: Path | None = None
        self._sensor = SENSOR

    def shown(self) -> dict[str, Any]:
        """Return the present content."""
        changed = _changed_at(self._path)
        if changed != self._changed:
            self._changed, self._shown = changed, self._read()
        return self._shown

    def tests(self) -> dict[str, RecordedTest]:
        """Return the recorded tests of the rig by the names of their folders, the latest first."""
        if time.monotonic() - self._looked > LOOK_S:
            self._looked = time.monotonic()
            with suppress(OSError):  # a folder that is being removed is looked at again
                self._tests = self._catalogue.tests(self._recordings, self._sensor)
                self._shown_tests = [each.shown() for each in self._tests.values()]
                self._rigs = _rigs_beside(self._path)
                folder = self._path.absolute().parent
                self._elsewhere = [str(each) for each in known_rigs() if each.parent != folder]
        return self._tests

    def shown_tests(self) -> list[dict[str, Any]]:
        """Return the tests for the page."""
        self.tests()
        return self._shown_tests

    def rigs(self) -> list[dict[str, Any]]:
        """Return the rig files in the folder of this one with the number of their tests, and others of the computer."""
        tested = [each.card.rig_file for each in self._tests.values() if each.card is not None]
        beside = [{"file": name, "tests": tested.count(name), "own": name == self._path.name} for name in self._rigs]
        return beside + [{"file": path, "tests": None, "own": False} for path in self._elsewhere]

    def opened(self, test: str) -> RecordedRig:
        """Return the maps and curves of an earlier test.

        Raises
        ------
        OperatorError
            There is no such test, or it has no results.
        """
        return opened_test(self._tests, test)

    def programme_of(self, test: str) -> str:
        """Return the text of the programme of an earlier test; empty when it is not known."""
        card = self._tests[test].card if test in self._tests else None
        return "" if card is None or card.programme is None else _text_of(card.programme)

    def series(self) -> dict[str, Any]:
        """Return the specimens that are to be tested, their programme and answers, and why they cannot be read."""
        file = series_file(self._path)
        changed = _changed_at(file)
        if changed != self._series[0]:
            self._series = changed, _shown_series(file)
        return self._series[1]

    def plan_series(self, series: Series) -> None:
        """Keep a series of tests; an empty one is removed.

        Raises
        ------
        FringedicError
            An answer of the form is not valid, or the file cannot be written.
        """
        rig = load_rig_file(self._path)
        field = specimen_field(rig.test_form)
        for specimen in series.specimens:
            answered_specimen(rig.test_form, rig.specimen, {**series.answers, field: specimen})
        try:
            series.model_copy(update={"planned": time.time()}).save(series_file(self._path))
        except OSError as error:
            raise OperatorError(f"the series cannot be kept: {cause_of(error)}") from error

    def check(self, text: str) -> dict[str, Any]:
        """Return what a programme would do on the rig, and the reason why it may not be started.

        Parameters
        ----------
        text
            The programme (YAML); empty for that of the rig file.

        Returns
        -------
        dict
            ``rows`` of its first steps, ``count`` of all, ``words`` about time and disk space, ``text``, its content as
            ``programme`` (None when it is no YAML), and ``problem``, which is empty when it may be started.
        """
        checked: dict[str, Any] = {"rows": [], "count": 0, "words": "", "problem": "", "text": text, "programme": None}
        try:
            rig = load_rig_file(self._path)
            if not text.strip() and rig.programme is not None:
                checked["text"] = _text_of(rig.programme)
            checked["programme"] = _mapping(checked["text"])
            programme = parse_programme(text) if text.strip() else rig.programme
            if programme is not None:
                checked |= {"rows": _rows(programme), "count": programme.count()}
                check_programme(rig, programme)
                expected = forecast(rig, programme)
                checked["words"] = forecast_sentence(expected)
                expected.check_disk(self._path.absolute().parent / rig.recording.folder)
            elif rig.camera.source == "files":
                checked["words"] = "each image of the camera's files is measured as one step"
            else:
                checked["problem"] = f"{self._path.name} has no programme: write one here"
        except FringedicError as error:
            checked["problem"] = str(error)
        return checked

    def _read(self) -> dict[str, Any]:
        self._recordings = None
        shown: dict[str, Any] = {"file": self._path.name, "file_error": "", "region": [], "changed": self._changed}
        shown |= {"form": [], "specimen_field": "", "answers": {}}
        try:
            rig = load_rig_file(self._path)
            self._recordings, self._sensor = self._path.absolute().parent / rig.recording.folder, rig.sensor
            shown["form"] = [field.model_dump() for field in rig.test_form]
            shown["specimen_field"] = specimen_field(rig.test_form)
            shown["answers"] = answers_of(rig.test_form, rig.specimen)
            shown |= {"load_frame": rig.load_frame is not None, "stage": rig.virtual_rig is not None}
            shown |= {"has_programme": rig.programme is not None, "calibration": self._calibration(rig)}
            if rig.region_file is not None:
                region = Region.load(rig.region_file)
                shown["region"] = [{"points": each.points, "hole": each.hole} for each in region.polygons]
        except FringedicError as error:
            shown["file_error"] = str(error)
        return shown

    def _calibration(self, rig: RigFile) -> list[str]:
        if rig.calibration is None:
            return ["none: only the displacement in the image is measured"]
        if (file := rig.calibration_file) is not None:
            return in_force_words(file, datetime.now(UTC))
        return ["the values of the virtual rig" if rig.calibration == VIRTUAL_RIG else "values in the rig file"]


def _text_of(programme: Programme) -> str:
    written = programme.model_dump(mode="json", exclude_unset=True)
    return yaml.safe_dump(written, sort_keys=False, allow_unicode=True, width=100)


def _rows(programme: Programme) -> list[dict[str, Any]]:
    names = ("position_mm", "speed_mm_per_s", "hold_s", "mode", "set_reference")
    return [
        {name: getattr(step, name) for name in names} | {"until": step.until is not None}
        for step in islice(programme.walk(), MOST_ROWS)
    ]


def _changed_at(file: Path) -> int:
    """Return the time of the last change of a file [ns], 0 without it."""
    try:
        return file.stat().st_mtime_ns
    except OSError:
        return 0


def _shown_series(file: Path) -> dict[str, Any]:
    try:
        return load_series(file).model_dump() | {"problem": ""}
    except FringedicError as error:
        return Series().model_dump() | {"problem": str(error)}


def _mapping(text: str) -> dict[str, Any] | None:
    """Return the content of a programme as it is written, for the form; None when it has no keys."""
    try:
        content = load_yaml(text)
    except yaml.YAMLError:
        return None
    return content if isinstance(content, dict) else None


def _rigs_beside(rig_file: Path) -> list[str]:
    """Return the names of the rig files in the folder of a rig file; files of before a change are none."""
    found = []
    for each in sorted(rig_file.absolute().parent.glob("*.yaml")):
        content = None if BEFORE in each.name or each.name.startswith(".") else _mapping_in(each)
        if each.name == rig_file.name or (content is not None and "camera" in content):
            found.append(each.name)
    return found


@lru_cache(maxsize=200)
def _read_mapping(file: Path, changed: int) -> dict[str, Any] | None:  # noqa: ARG001 (a key of the cache)
    try:
        return _mapping(file.read_text("utf-8"))
    except (OSError, UnicodeDecodeError):
        return None


def _mapping_in(file: Path) -> dict[str, Any] | None:
    return _read_mapping(file, file.stat().st_mtime_ns)
