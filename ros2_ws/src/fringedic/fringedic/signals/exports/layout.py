"""The structure of an export: what was recognised, and what a person has told."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from pydantic import BaseModel, ConfigDict

from fringedic.errors import RecordingError
from fringedic.signals.exports.text import decimal_of, decode, is_row_of_values, is_value, separator_of, split_cells
from fringedic.signals.exports.times import DateOrder, date_order, kind_of
from fringedic.signals.signal import FORCE, POSITION
from fringedic.signals.units import Unit, find_unit, known_units

_BRACKETS = re.compile(r"(?P<name>.*?)[\s,;:_/-]*[\[(<{](?P<unit>[^\[\](){}<>]*)[\])>}]\s*")
_TAIL = re.compile(r"(?P<name>.+?)(\s*[,/]\s*|\s+in\s+|\s+|_)(?P<unit>\S+)")
_ROW_OF_UNITS = re.compile(r"(y_)?unit(_label|s)?|einheit(en)?|unit[ée]s?|unidad(es)?", re.I)
_INTERVAL = re.compile(r"(delta[_ ]?[xt]|sample interval|abtastintervall|sampling interval)", re.I)
_TIME = re.compile(r"time|zeit|temps|tiempo|tempo\b|\bt\b|x_value|uhr|datum|date|elapsed|seconds?\b|時間|时间", re.I)
_DATE_ALONE = re.compile(r"date|datum|fecha|data\b", re.I)
_FORCE = re.compile(r"force|load|kraft|last\b|f\b|fuerza|carga|試験力|荷重|力", re.I)
_POSITION = re.compile(
    r"position|crosshead|travers|extension|displacement|stroke|verl[äa]ngerung|elongation|weg\b|standardweg|course|d[ée]placement|変位|位移",
    re.I,
)
_FEWEST_ROWS = 10  # of values; fewer above the others are a table of results
_SLUG = re.compile(r"\W+")


class ExportColumn(BaseModel):
    """One signal of an export."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    number: int  # from 1
    heading: str
    unit: str
    si: str
    factor: float
    zero: float


class ExportLayout(BaseModel):
    """Complete structure of an export; with it the file is read without recognising anything again.

    Attributes
    ----------
    encoding, separator, decimal
        Of the text; the separator of columns, ``"  "`` for two or more spaces.
    headings
        Names of all columns, with their units.
    first_line, last_line
        Lines of the first and the last row of values, from 1.
    time
        Numbers of the columns with the time, from 1: one, or date and time of day; none with `interval`.
    time_kind, time_order, time_scale
        How times are written, order of a date, and seconds of a unit.
    interval
        Time between two rows [s] of a file without times.
    columns
        The signals by their names.
    remarks
        What was recognised in another way than a person may expect.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    encoding: str
    separator: str
    decimal: str
    headings: tuple[str, ...]
    first_line: int
    last_line: int
    lines_told: bool
    time: tuple[int, ...]
    time_kind: str
    time_order: str
    time_scale: float
    interval: float | None
    columns: dict[str, ExportColumn]
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class ExportOptions:
    """What a person tells of an export; everything else is recognised.

    Attributes
    ----------
    encoding, separator, decimal, date
        As of `ExportLayout`.
    time
        Heading or number of the column with the time; two for date and time of day.
    columns
        The signals to read, ``"Load [kN]=force"``: heading or number of a column, its unit unless the file contains it,
        and the name of the signal unless it is that of the heading. All columns without any.
    lines
        First and last line to read.
    interval
        Time between two rows [s], if no column contains a time.
    """

    encoding: str | None = None
    separator: str | None = None
    decimal: str | None = None
    date: DateOrder | None = None
    time: Sequence[str] = ()
    columns: Sequence[str] = ()
    lines: tuple[int, int] | None = None
    interval: float | None = None


RECOGNISED = ExportOptions()
"""Nothing is told: everything is recognised."""


@dataclass
class _Heading:
    """A column while its layout is recognised."""

    number: int
    text: str
    name: str
    unit: str
    cells: list[str] = field(repr=False)

    @property
    def is_time(self) -> bool:
        unit = find_unit(self.unit) if self.unit else None
        if kind_of(self.cells) != "number":
            return True
        of_seconds = unit is not None and unit.si == "s"
        return (bool(_TIME.search(self.name)) and (unit is None or of_seconds)) or (of_seconds and not self.name)


def recognise(data: bytes, options: ExportOptions = RECOGNISED) -> ExportLayout:
    r"""Recognise the structure of an export.

    Parameters
    ----------
    data
        Content of the file.
    options
        What a person tells of it.

    Raises
    ------
    RecordingError
        Something cannot be recognised; the message says what to tell.

    Examples
    --------
    >>> layout = recognise("Zeit;Kraft\ns;kN\n0,0;1,25\n0,1;1,5\n".encode())
    >>> layout.decimal, layout.columns["force"].factor
    (',', 1000.0)
    """
    text, encoding = decode(data, options.encoding)
    lines = text_lines(text)
    first, last = options.lines or (1, len(lines))
    if not 1 <= first <= last:
        raise RecordingError(f"--lines {first}-{last}: the file has the lines 1-{len(lines)}")
    last = min(last, len(lines))
    separator, count = _separator(lines[first - 1 : last], options.separator)
    rows = split_cells(lines, separator)
    body = _body(rows, first - 1, last, count)
    if not body:
        raise RecordingError(f"the lines {first}-{last} contain no row of {count} numbers; give others (--lines)")
    found = [rows[place] + [""] * (count - len(rows[place])) for place in body]
    skipped = [
        place + 1 for place in range(body[0], body[-1]) if rows[place] and not is_row_of_values(rows[place], count)
    ]
    decimal = options.decimal or decimal_of((cell for row in found for cell in row[:count]), separator)
    preamble = rows[: body[0]] if options.lines is None else rows[: _body(rows, 0, len(rows), count)[0]]
    headings = _headings(preamble, [[row[column] for row in found] for column in range(count)])
    remarks = [_skipped_sentence(skipped)] if skipped else []
    time, interval = _time_columns(headings, options, preamble, remarks)
    kinds = {kind_of(column.cells) for column in time}
    kind = "date" if "date" in kinds else "time of day" if "time of day" in kinds else "number"
    of_date = next((column for column in time if kind_of(column.cells) == "date"), None)
    order = "" if of_date is None else options.date or date_order(of_date.cells, of_date.text)
    return ExportLayout(
        encoding=encoding,
        separator=separator,
        decimal=decimal,
        headings=tuple(column.text for column in headings),
        first_line=body[0] + 1,
        last_line=body[-1] + 1,
        lines_told=options.lines is not None,
        time=tuple(column.number for column in time),
        time_kind=kind,
        time_order=order,
        time_scale=_time_scale(time, kind, remarks),
        interval=interval,
        columns=_columns(headings, time, options.columns, remarks),
        remarks=tuple(remarks),
    )


def text_lines(text: str) -> list[str]:
    """Return the lines of a text; page breaks and other separators of Unicode are no ends of a line."""
    return text.replace("\r\n", "\n").replace("\r", "\n").lstrip("\ufeff").split("\n")


def _separator(lines: Sequence[str], told: str | None) -> tuple[str, int]:
    if told is None:
        return separator_of(lines)
    counts = [len(row) for row in split_cells(lines, told) if len(row) > 1 and is_row_of_values(row, len(row))]
    if not counts:
        raise RecordingError(f"separated by {told!r}, no line has two or more numbers; give another --separator")
    return told, max(set(counts), key=counts.count)


def _body(rows: Sequence[Sequence[str]], first: int, last: int, count: int) -> list[int]:
    """Return the places of the rows of values, without a table of results above them."""
    runs: list[list[int]] = []
    for place in range(first, last):
        if is_row_of_values(rows[place], count):
            if runs and runs[-1][-1] == place - 1:
                runs[-1].append(place)
            else:
                runs.append([place])
    longest = max(map(len, runs), default=0)
    while runs and len(runs[0]) < min(_FEWEST_ROWS, longest):
        runs.pop(0)
    return [place for run in runs for place in run]


def _skipped_sentence(lines: Sequence[int]) -> str:
    shown = ", ".join(map(str, lines[:5])) + (", ..." if len(lines) > 5 else "")
    return f"{len(lines)} lines between the rows of values are no such rows and were left out: {shown}"


def _headings(preamble: Sequence[Sequence[str]], columns: Sequence[list[str]]) -> list[_Heading]:
    """Return the columns with their names and units, which are in the lines above the first row."""
    count = len(columns)
    above = [list(row) for row in preamble if any(row)]
    units, names = [""] * count, [""] * count
    fitting = [row for row in above if count - 1 <= len(row) <= count + 1 and sum(map(bool, row)) >= min(2, count)]
    labelled = next((row for row in reversed(above) if _ROW_OF_UNITS.fullmatch(row[0]) and len(row) > 1), None)
    if fitting and _is_row_of_units(fitting[-1]):
        units = _padded(fitting.pop(), count)
    elif labelled is not None:
        units = _padded(labelled, count)
        fitting = [row for row in fitting if row is not labelled and not _ROW_OF_UNITS.fullmatch(row[0])]
        units[0] = "" if _ROW_OF_UNITS.fullmatch(units[0]) else units[0]
    if fitting and not all(map(is_value, filter(None, fitting[-1]))):
        names = _padded(fitting[-1], count)
    found = []
    for place, (name, unit) in enumerate(zip(names, units, strict=True)):
        text = name if not unit else f"{name} [{_bare(unit)}]".strip()
        plain, inside = (name, _bare(unit)) if unit else _name_and_unit(name)
        found.append(_Heading(place + 1, text or f"column {place + 1}", plain, inside, columns[place]))
    return found


def _padded(row: Sequence[str], count: int) -> list[str]:
    return [*row[:count], *[""] * (count - len(row))]


def _bare(unit: str) -> str:
    return unit.strip().strip("[](){}<>").strip()


def _is_row_of_units(row: Sequence[str]) -> bool:
    cells = [cell for cell in row if cell]
    known = sum(find_unit(_bare(cell)) is not None for cell in cells)
    bracketed = sum(cell[0] in "[(" and cell[-1] in "])" for cell in cells)
    return known + bracketed > 0 and max(known, bracketed) >= 0.5 * len(cells) and not any(map(is_value, cells))


def _name_and_unit(heading: str) -> tuple[str, str]:
    """Return name and unit of a heading, ``Load (kN)``, ``Load, kN`` or ``Load kN``."""
    if match := _BRACKETS.fullmatch(heading):
        return match["name"].strip(), match["unit"].strip()
    if (match := _TAIL.fullmatch(heading)) and find_unit(match["unit"]) is not None:
        return match["name"].strip(), match["unit"]
    return heading, ""


def _chosen(headings: Sequence[_Heading], text: str, option: str) -> _Heading:
    """Return the column that a person names: by its heading, with or without the unit, or by its number."""
    wanted = text.strip()
    if wanted.isdecimal() and 1 <= int(wanted) <= len(headings):
        return headings[int(wanted) - 1]
    named = [each for each in headings if wanted.lower() in (each.text.lower(), each.name.lower())]
    if len(named) == 1:
        return named[0]
    if named:
        places = " and ".join(str(each.number) for each in named)
        raise RecordingError(
            f"{option} {wanted}: the columns {places} have this name; give the number of one of them: {option} "
            f"{named[0].number}"
        )
    present = ", ".join(f"{each.number} {each.text}" for each in headings)
    raise RecordingError(f"{option} {wanted}: the file has no such column, only {present}")


def _time_columns(
    headings: Sequence[_Heading], options: ExportOptions, preamble: Sequence[Sequence[str]], remarks: list[str]
) -> tuple[list[_Heading], float | None]:
    """Return the columns with the time, or the time between two rows."""
    if options.time:
        return [_chosen(headings, text, "--time") for text in options.time], None
    if options.interval is not None:
        return [], options.interval
    found = [each for each in headings if each.is_time]
    dates = [each for each in found if kind_of(each.cells) == "date" and not any(":" in cell for cell in each.cells)]
    of_day = [each for each in found if kind_of(each.cells) == "time of day"]
    if len(dates) == 1 and len(of_day) == 1 and len(found) == 2:
        return [dates[0], of_day[0]], None
    with_unit = [each for each in found if each.unit]
    if len(found) > 1 and len(with_unit) == 1 and not any(kind_of(each.cells) != "number" for each in found):
        found = with_unit
    if len(found) > 1:
        names = " and ".join(f"{each.number} {each.text}" for each in found)
        raise RecordingError(f"the columns {names} contain times; choose one: --time {found[0].number}")
    if found:
        return found, None
    interval = _recorded_interval(preamble, options)
    if interval is None:
        present = ", ".join(f"{each.number} {each.text}" for each in headings)
        raise RecordingError(
            f"no column contains a time, of {present}; name it (--time), or give the seconds between two rows "
            "(--interval)"
        )
    remarks.append(f"no column contains a time; the preamble states {interval:g} s between two rows")
    return [], interval


def _recorded_interval(preamble: Sequence[Sequence[str]], options: ExportOptions) -> float | None:
    """Return the time between two rows as a preamble states it [s]."""
    for row in preamble:
        if len(row) > 1 and _INTERVAL.match(row[0]):
            text = row[1].replace(",", ".") if options.decimal != "." else row[1]
            try:
                value = float(text)
            except ValueError:
                continue
            if value > 0:
                return value
    return None


def _time_scale(time: Sequence[_Heading], kind: str, remarks: list[str]) -> float:
    if kind != "number" or not time:
        return 1.0
    unit = find_unit(time[0].unit) if time[0].unit else None
    if time[0].unit and (unit is None or unit.si != "s"):
        raise RecordingError(
            f"the time '{time[0].text}' has the unit '{time[0].unit}', which is none of a time; name another column "
            "(--time)"
        )
    if unit is None:
        remarks.append(f"the time '{time[0].text}' has no unit; it is read as seconds")
    return 1.0 if unit is None else unit.factor


def _columns(
    headings: Sequence[_Heading], time: Sequence[_Heading], told: Sequence[str], remarks: list[str]
) -> dict[str, ExportColumn]:
    """Return the signals by their names."""
    if told:
        return _told_columns(headings, told)
    columns: dict[str, ExportColumn] = {}
    for each in headings:
        if each in time or each.is_time or not any(map(is_value, each.cells)):
            continue
        unit = find_unit(each.unit) if each.unit else None
        if unit is None:
            reason = f"the unit '{each.unit}', which is not known" if each.unit else "no unit"
            remarks.append(
                f"column {each.number} '{each.text}' has {reason}, and is left out; to read it, name its unit, one "
                f"such as {known_units()}: --columns '{each.number} [N]=force'"
            )
            continue
        name = _signal_name(each, unit)
        if name in columns:
            other, name = name, f"{name}_{each.number}"
            remarks.append(f"column {each.number} '{each.text}' is named {name}, since {other} exists already")
        columns[name] = _column(each, unit, each.unit)
    if not columns:
        reasons = "; ".join(remarks)
        raise RecordingError(f"no column has a known unit: {reasons or 'there is only a time'}")
    return columns


def _told_columns(headings: Sequence[_Heading], told: Sequence[str]) -> dict[str, ExportColumn]:
    columns: dict[str, ExportColumn] = {}
    for text in told:
        wanted, _, name = text.partition("=")
        try:
            each, given = _chosen(headings, wanted, "--columns"), ""
        except RecordingError:
            plain, given = _name_and_unit(wanted)
            if not given or plain == wanted:
                raise
            each = _chosen(headings, plain, "--columns")
        written = given or each.unit
        unit = find_unit(written) if written else None
        if unit is None:
            reason = f"the unit '{written}', which is not known" if written else "no unit"
            raise RecordingError(
                f"--columns {text}: the column has {reason}; write one such as {known_units()}: "
                f"--columns '{each.number} [N]={name or 'force'}'"
            )
        name = name.strip() or _signal_name(each, unit)
        if name in columns:
            raise RecordingError(f"--columns {text}: another column is named '{name}', too; give it another name")
        columns[name] = _column(each, unit, written)
    return columns


def _column(heading: _Heading, unit: Unit, written: str) -> ExportColumn:
    return ExportColumn(number=heading.number, heading=heading.text, unit=written, **_si(unit))


def _si(unit: Unit) -> dict[str, Any]:
    return {"si": unit.si, "factor": unit.factor, "zero": unit.zero}


def _signal_name(heading: _Heading, unit: Unit) -> str:
    """Return ``force`` or ``position`` for columns of this meaning, and the heading as a name for others."""
    if unit.si == FORCE.unit and (not heading.name or _FORCE.search(heading.name)):
        return FORCE.name
    if unit.si == POSITION.unit and (not heading.name or _POSITION.search(heading.name)):
        return POSITION.name
    return _SLUG.sub("_", heading.name.lower()).strip("_") or f"column_{heading.number}"
