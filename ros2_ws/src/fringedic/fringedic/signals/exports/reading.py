"""Signals of an export, on the clock of its file."""

from __future__ import annotations

import numpy as np

from fringedic.errors import RecordingError
from fringedic.signals.exports.layout import ExportLayout, text_lines
from fringedic.signals.exports.text import decode, is_row_of_values, numbers, split_cells
from fringedic.signals.exports.times import NO_TIME, refuse_jumps, stamps_of
from fringedic.signals.signal import FORCE, POSITION, Channel, Signal
from fringedic.signals.units import QUANTITIES


def read_export(data: bytes, layout: ExportLayout, source: str) -> dict[str, Signal]:
    """Read the signals of an export, in SI units.

    Parameters
    ----------
    data
        Content of the file.
    layout
        From `recognise`.
    source
        Name of the signals' source.

    Returns
    -------
    dict
        The signals by their names. Their stamps are nanoseconds since 1970 for a file with dates (UTC where it states
        no zone), else those of the file, which count from a beginning of its own. Uncertainties are not known.

    Raises
    ------
    RecordingError
        The times go back, or jump by the hour of daylight saving.
    """
    lines = text_lines(decode(data, layout.encoding)[0])[layout.first_line - 1 : layout.last_line]
    count = len(layout.headings)
    numbered = [
        (number, row)
        for number, row in enumerate(split_cells(lines, layout.separator), layout.first_line)
        if is_row_of_values(row, count)
    ]
    rows = [row + [""] * (count - len(row)) for _, row in numbered]
    places = np.array([number for number, _ in numbered])
    stamps = _stamps(rows, layout)
    timed = stamps != NO_TIME
    if not timed.any():
        raise RecordingError("no row has a time that can be read; name the column (--time), or the order (--date)")
    refuse_jumps(stamps[timed], places[timed], layout.time_kind, lines_told=layout.lines_told)
    signals = {}
    for name, column in layout.columns.items():
        values = column.factor * numbers([row[column.number - 1] for row in rows], layout.decimal) + column.zero
        known = next((each for each in (FORCE, POSITION) if (each.name, each.unit) == (name, column.si)), None)
        channel = known or Channel(name, QUANTITIES[column.si], column.si)
        nothing = np.full(int(timed.sum()), np.nan)
        signals[name] = Signal(channel._replace(source=source), stamps[timed], values[timed], nothing)
    return signals


def _stamps(rows: list[list[str]], layout: ExportLayout) -> np.ndarray:
    if layout.interval is not None:
        return np.asarray(np.rint(1e9 * layout.interval * np.arange(len(rows))), dtype=np.int64)
    cells = [" ".join(row[number - 1] for number in layout.time) for row in rows]
    return stamps_of(cells, layout.time_kind, layout.time_order, layout.time_scale, layout.decimal)
