"""Tables to signals."""

from __future__ import annotations

import csv
import re
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from fringedic.errors import RecordingError
from fringedic.signals.signal import FORCE, POSITION, Channel, Signal
from fringedic.signals.units import QUANTITIES
from fringedic.wording.causes import cause_of

_HEADING = re.compile(r"\s*(?P<name>\S(?:.*\S)?)\s*\[(?P<unit>[^\[\]]+)\]\s*")
_SIGMA = "sigma "
_LATEST = 9_000_000_000  # [s] that int64 contains in nanoseconds


def read_table(path: Path) -> dict[str, Signal]:
    """Read signals from a CSV file.

    Parameters
    ----------
    path
        Its first line contains ``time [s]``, and name and SI unit of each signal, such as ``temperature_grip [K]``; a
        column ``sigma temperature_grip [K]`` has its standard uncertainty. Times are seconds since 1970 (UTC) on the
        clock of the table, see `Signal.on_the_clock_of_the_rig`. An empty cell is not measured.

    Returns
    -------
    dict
        The signals by their name, with the name of the file as their source; force and position with the sign
        conventions of the load frame.

    Raises
    ------
    RecordingError
        The file is no such table; the message names line and column.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            heading, *rows = list(csv.reader(file, strict=True)) or [[]]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RecordingError(f"{path}: cannot be read as CSV in UTF-8: {cause_of(error)}") from error
    columns = _columns(path, heading)
    cells = {line: row for line, row in enumerate(rows, 2) if row}
    for line, row in cells.items():
        if len(row) != len(columns):
            raise RecordingError(
                f"{path}: line {line} has {len(row)} cells, the first line {len(columns)}; complete it"
            )
    values = {
        name: [_number(path, line, name, row[place]) for line, row in cells.items()]
        for place, name in enumerate(columns)
    }
    stamps = np.array(
        [int(1_000_000_000 * time) for time in values.pop("time") if time.is_finite() and abs(time) < _LATEST],
        dtype=np.int64,
    )
    if len(stamps) < len(cells) or not len(stamps) or (np.diff(stamps) <= 0).any():
        raise RecordingError(
            f"{path}: the times have to be numbers that grow from line to line, at least one; sort the lines and "
            "remove those without a time of their own"
        )
    signals = {}
    for name in (name for name in values if not name.startswith(_SIGMA)):
        known = next((each for each in (FORCE, POSITION) if (each.name, each.unit) == (name, columns[name])), None)
        channel = known or Channel(name, QUANTITIES.get(columns[name], ""), columns[name])
        sigmas = values.get(_SIGMA + name, [np.nan] * len(stamps))
        arrays = (np.array([float(each) for each in column]) for column in (values[name], sigmas))
        signals[name] = Signal(channel._replace(source=path.name), stamps, *arrays)
    return signals


def _columns(path: Path, heading: list[str]) -> dict[str, str]:
    """Return the units of the columns of a table by their names."""
    found = [_HEADING.fullmatch(cell) for cell in heading]
    columns = {each["name"]: each["unit"] for each in found if each is not None}
    if len(columns) < max(len(heading), 2) or columns.get("time") != "s":
        raise RecordingError(
            f"{path}: the first line has to contain time [s], and each signal once with its unit, such as "
            f"time [s],force [N]; it is {','.join(heading)[:80]!r}"
        )
    for name, unit in columns.items():
        if name.startswith(_SIGMA) and columns.get(name.removeprefix(_SIGMA)) != unit:
            raise RecordingError(
                f"{path}: '{name} [{unit}]' has no column '{name.removeprefix(_SIGMA)} [{unit}]'; add it"
            )
    return columns


def _number(path: Path, line: int, name: str, cell: str) -> Decimal:
    """Return the number in a cell, NaN for an empty one; a Decimal has the nanoseconds of a time."""
    try:
        number = Decimal(cell.strip() or "nan")
        return number if number.is_finite() or number.is_qnan() else Decimal("no number")
    except InvalidOperation as error:
        raise RecordingError(
            f"{path}: line {line}, {name}: {cell[:40]!r} is no number; write it as 1234.5, or leave the cell empty"
        ) from error
