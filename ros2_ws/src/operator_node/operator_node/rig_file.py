"""What the page shows of the rig file: programme, region, calibration; read again after each change."""

from __future__ import annotations

import math
import time
from contextlib import suppress
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from fringedic.calibration.sentences import in_force_words
from fringedic.configuration.forecast import forecast
from fringedic.configuration.programme import Programme
from fringedic.configuration.programme_check import check_programme, parse_programme
from fringedic.configuration.rig_file import RigFile, load_rig_file
from fringedic.configuration.sections import VIRTUAL_RIG
from fringedic.configuration.sentences import forecast_sentence
from fringedic.errors import FringedicError
from fringedic.frames.region import Region

MOST_ROWS = 1000  # of the programme table
MOST_TESTS = 200  # of the list of tests, the latest ones
LOOK_S = 3.0  # between two looks for tests


class RecordedTest(NamedTuple):
    """A folder with a recording, the time of its last change [s], and whether it has a report."""

    folder: Path
    when: float
    has_report: bool


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
        self._looked = -math.inf
        self._recordings: Path | None = None

    def shown(self) -> dict[str, Any]:
        """Return the present content."""
        try:
            changed = self._path.stat().st_mtime_ns
        except OSError:
            changed = 0
        if changed != self._changed:
            self._changed, self._shown = changed, self._read()
        return self._shown

    def tests(self) -> dict[str, RecordedTest]:
        """Return the recorded tests of the rig by the names of their folders, the latest first."""
        if time.monotonic() - self._looked > LOOK_S:
            self._looked = time.monotonic()
            with suppress(OSError):  # a folder that is being removed is looked at again
                self._tests = _tests_in(self._recordings)
        return self._tests

    def check(self, text: str) -> dict[str, Any]:
        """Return what a programme would do on the rig, and the reason why it may not be started.

        Parameters
        ----------
        text
            The programme (YAML); empty for that of the rig file.

        Returns
        -------
        dict
            ``rows`` of its first steps, ``count`` of all, ``words`` about time and disk space, and ``problem``, which
            is empty when it may be started.
        """
        checked: dict[str, Any] = {"rows": [], "count": 0, "words": "", "problem": ""}
        try:
            rig = load_rig_file(self._path)
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
        try:
            rig = load_rig_file(self._path)
            self._recordings = self._path.absolute().parent / rig.recording.folder
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


def _rows(programme: Programme) -> list[dict[str, Any]]:
    names = ("position_mm", "speed_mm_per_s", "hold_s", "mode", "set_reference")
    return [
        {name: getattr(step, name) for name in names} | {"until": step.until is not None}
        for step in islice(programme.walk(), MOST_ROWS)
    ]


def _tests_in(folder: Path | None) -> dict[str, RecordedTest]:
    if folder is None or not folder.is_dir():
        return {}
    found = []
    for each in folder.iterdir():
        if (each / "bag").is_dir():
            report = each / "report.html"
            has_report = report.is_file()
            found.append(RecordedTest(each, (report if has_report else each).stat().st_mtime, has_report))
    found.sort(key=lambda test: test.when, reverse=True)
    return {test.folder.name: test for test in found[:MOST_TESTS]}
