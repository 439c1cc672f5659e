"""Times in an export: seconds, times of day and dates, as stamps on the clock of the file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Literal

import numpy as np

from fringedic.errors import RecordingError
from fringedic.signals.exports.text import has_date, is_time_of_day, numbers
from fringedic.wording.numbers import number_text

DateOrder = Literal["dmy", "mdy", "ymd"]
SINCE_1904 = 2_082_844_800  # [s] from the epoch of LabVIEW to that of Unix
_FEWEST_OF_UNIX, _FEWEST_OF_1904, _LATEST = 1e9, 2.95e9, 6e9
_HOUR, _DAY = 3600, 86_400
_PAUSE = 60  # [s]
_TIME = re.compile(
    r"(?P<h>\d{1,3}):(?P<m>\d{2})(:(?P<s>\d{2})([.,:](?P<f>\d{1,9})\d*)?)?\s*(?P<half>[AaPp])?\.?[Mm]?\.?"
    r"\s*(?P<zone>Z|[-+]\d{2}:?\d{2})?"
)
_DATE = re.compile(r"(?P<a>\d{1,4})(?P<sign>[./-])(?P<b>\d{1,2})[./-](?P<c>\d{1,4})[T ,]*(?P<rest>.*)")


def kind_of(cells: Sequence[str]) -> str:
    """Return how times are written: ``date``, ``time of day`` or ``number``; empty for no times."""
    shown = [cell for cell in cells if cell]
    if shown and all(map(is_time_of_day, shown)):
        return "time of day"
    if shown and all(has_date(cell) for cell in shown):
        return "date"
    return "number"


def date_order(cells: Sequence[str], column: str) -> DateOrder:
    """Return the order of day, month and year.

    Raises
    ------
    RecordingError
        The dates can be read in two orders, or in none.
    """
    found = [match for cell in cells if (match := _DATE.match(cell))]
    if all(len(match["a"]) == 4 for match in found):
        return "ymd"
    first, second = (max(int(match[part]) for match in found) for part in "ab")
    if first > 12 and second > 12:
        raise RecordingError(f"the dates in '{column}', such as {found[0][0]!r}, have no month; correct the file")
    if first > 12 or found[0]["sign"] == ".":
        return "dmy"
    if second > 12:
        return "mdy"
    a, b = int(found[0]["a"]), int(found[0]["b"])
    if first == second and all(match["a"].zfill(2) == match["b"].zfill(2) for match in found):
        return "dmy"
    months = [datetime(2000, number, 1).strftime("%B") for number in (b, a)]
    raise RecordingError(
        f"the dates in '{column}', such as {found[0][0].strip()!r}, may be {a} {months[0]} or {b} {months[1]}; say "
        "which (--date dmy or --date mdy)"
    )


def stamps_of(cells: Sequence[str], kind: str, order: str, scale: float, decimal: str) -> np.ndarray:
    """Return times as seconds (whole and fraction) in nanoseconds, int64 (n,); the smallest number for no time.

    Parameters
    ----------
    cells
        As they are in the file.
    kind
        From `kind_of`.
    order
        Order of day, month and year, for dates.
    scale, decimal
        Seconds of a unit, and decimal sign, for numbers.
    """
    if kind == "number":
        seconds = scale * numbers(cells, decimal)
        usual = seconds[np.isfinite(seconds)]
        if usual.size and _FEWEST_OF_1904 < usual[0] < _LATEST:
            seconds = seconds - SINCE_1904
        known = np.isfinite(seconds) & (np.abs(seconds) < _LATEST)
        whole = np.where(known, np.floor(seconds), 0)
        found = whole.astype(np.int64) * 1_000_000_000 + np.rint(
            1e9 * (seconds - whole), where=known, out=0 * whole
        ).astype(np.int64)
        return np.where(known, found, NO_TIME)
    if kind == "time of day":
        return _over_midnight(np.array([_time_of_day(cell) for cell in cells], dtype=np.int64))
    return np.array([_date(cell, order) for cell in cells], dtype=np.int64)


NO_TIME = int(np.iinfo(np.int64).min)


def is_absolute(stamps: np.ndarray) -> bool:
    """Return whether times are dates, and do not count from a beginning of their own."""
    known = stamps[stamps != NO_TIME]
    return bool(known.size and known[0] > _FEWEST_OF_UNIX * 1e9)


def _time_of_day(cell: str) -> int:
    match = _TIME.fullmatch(cell.strip())
    if match is None:
        return NO_TIME
    hours, minutes, seconds = (int(match[part] or 0) for part in "hms")
    if match["half"]:
        hours = hours % 12 + 12 * (match["half"] in "pP")
    zone = match["zone"] or "Z"
    shift = 0 if zone == "Z" else int(f"{zone[0]}1") * (60 * int(zone[1:3]) + int(zone[-2:])) * 60
    fraction = int((match["f"] or "0").ljust(9, "0"))
    return (hours * _HOUR + minutes * 60 + seconds - shift) * 1_000_000_000 + fraction


def _over_midnight(stamps: np.ndarray) -> np.ndarray:
    """Return times of day that go on after midnight."""
    known = stamps != NO_TIME
    times = stamps[known]
    days = np.cumsum(np.diff(times, prepend=times[:1]) < -(_DAY - 2 * _HOUR) * 1_000_000_000)
    stamps[known] = times + days * _DAY * 1_000_000_000
    return stamps


def _date(cell: str, order: str) -> int:
    match = _DATE.fullmatch(cell.strip())
    if match is None:
        return NO_TIME
    parts = dict(zip(order, (int(match[part]) for part in "abc"), strict=True))
    year = parts["y"] + (2000 if parts["y"] < 100 else 0)
    time = _time_of_day(match["rest"]) if match["rest"].strip() else 0
    try:
        day = datetime(year, parts["m"], parts["d"], tzinfo=UTC) - datetime(1970, 1, 1, tzinfo=UTC)
    except ValueError:
        return NO_TIME
    return NO_TIME if time == NO_TIME else day // timedelta(seconds=1) * 1_000_000_000 + time


def refuse_jumps(stamps: np.ndarray, lines: np.ndarray, kind: str, *, lines_told: bool) -> None:
    """Refuse times that go back, or jump by the hour of daylight saving.

    Parameters
    ----------
    stamps, lines
        Times [ns] and the numbers of their lines, shape (n,).
    kind
        From `kind_of`.
    lines_told
        Whether the lines to read were given, which confirms an hour without samples.

    Raises
    ------
    RecordingError
        The message names the line.
    """
    steps = np.diff(stamps)
    back = np.flatnonzero(steps < 0)
    if back.size:
        place = int(back[0])
        by = -1e-9 * float(steps[place])
        usual = 1e-9 * float(np.median(steps))
        summer = abs(by + usual - _HOUR) < max(2.0, 2 * usual)
        reason = "as at the end of daylight saving time" if summer else "its clock was set, or another test begins"
        raise RecordingError(
            f"line {lines[place + 1]}: the time goes back by {number_text(by, 6)} s, {reason}; attach the lines before "
            f"and after it as two files: --lines {lines[0]}-{lines[place]} and --lines {lines[place + 1]}-{lines[-1]}"
        )
    if lines_told or kind == "number" or not steps.size:
        return
    usual = 1e-9 * float(np.median(steps))
    hour = np.flatnonzero(np.abs(1e-9 * steps - usual - _HOUR) < 2.0)
    if usual < _PAUSE and hour.size:
        place = int(hour[0])
        raise RecordingError(
            f"line {lines[place + 1]}: the time jumps forward by an hour, as at the begin of daylight saving time; "
            f"attach the lines before and after it as two files (--lines {lines[0]}-{lines[place]} and --lines "
            f"{lines[place + 1]}-{lines[-1]}), or all of them if the machine paused: --lines {lines[0]}-{lines[-1]}"
        )
