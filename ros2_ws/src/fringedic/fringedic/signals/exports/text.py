"""Text of an export: its encoding, its cells, and how its numbers are written."""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Iterable, Sequence

import numpy as np

from fringedic.errors import RecordingError

SEPARATORS = {"semicolon": ";", "tab": "\t", "comma": ",", "bar": "|", "spaces": "  ", "space": " "}
ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252", "latin-1")
_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
_NUMBER = re.compile(r"[-+−]?(\d[\d.,'’\u00a0\u202f ]*|[.,]\d+)([eE][-+]?\d+)?")
_TIME_OF_DAY = re.compile(r"\d{1,3}:\d{2}(:\d{2}([.,:]\d+)?)?( ?[AaPp]\.?[Mm]\.?)?")
_DATE = re.compile(r"(\d{1,2}[./-]\d{1,2}[./-]\d{2,4}|\d{4}[-/.]\d{1,2}[-/.]\d{1,2})")
_GROUPING = " '’\u00a0\u202f"
_NO_VALUES = {"", "-", "--", "---", "n/a", "nan", "na", "null", "none", "overflow", "#n/a", "#wert!", "inf", "-inf"}
_MOST_LINES = 3000  # by which separator and decimal sign are recognised


def decode(data: bytes, encoding: str | None) -> tuple[str, str]:
    """Return the text of a file and its encoding; without one that was given it is recognised.

    Raises
    ------
    RecordingError
        The bytes are no text in this encoding.
    """
    name = encoding or _encoding_of(data)
    try:
        return data.decode(name), name
    except UnicodeDecodeError as error:
        raise RecordingError(
            f"byte {error.start} is no text in the encoding {name}: give another one (--encoding), "
            f"{', '.join(ENCODINGS)}"
        ) from error


def _encoding_of(data: bytes) -> str:
    for mark, name in _MARKS.items():
        if data.startswith(mark):
            return name
    head = data[:4096]
    zeros = head[0::2].count(0), head[1::2].count(0)
    if max(zeros) > len(head) / 8:
        return "utf-16-be" if zeros[0] > zeros[1] else "utf-16-le"
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        try:
            data.decode("cp1252")
        except UnicodeDecodeError:
            return "latin-1"
        return "cp1252"
    return "utf-8"


def split_cells(lines: Sequence[str], separator: str) -> list[list[str]]:
    """Return the cells of each line, without the spaces around them; quotation marks enclose separators."""
    if separator in ("  ", " "):
        pattern = re.compile(r"[ \t]{2,}|\t" if separator == "  " else r"\s+")
        return [pattern.split(line.strip()) if line.strip() else [] for line in lines]
    rows = []
    for line in lines:
        if '"' in line:
            cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
        else:
            cells = line.split(separator)
        rows.append([cell.strip() for cell in cells] if line.strip() else [])
    return rows


def is_value(cell: str) -> bool:
    """Return whether a cell contains a number, a time or a date."""
    return bool(_NUMBER.fullmatch(cell) or is_time_of_day(cell) or has_date(cell))


def is_time_of_day(cell: str) -> bool:
    """Return whether a cell contains hours, minutes and seconds, and no date."""
    return bool(_TIME_OF_DAY.fullmatch(cell))


def has_date(cell: str) -> bool:
    """Return whether a cell begins with a date."""
    return bool(_DATE.match(cell)) and len(cell) <= 40


def is_row_of_values(cells: Sequence[str], count: int) -> bool:
    """Return whether a line has this number of cells, most of them values or empty."""
    while len(cells) > count and not cells[-1]:
        cells = cells[:-1]
    if len(cells) != count or not any(cells):
        return False
    values = sum(map(is_value, cells))
    missing = sum(cell.lower() in _NO_VALUES for cell in cells)
    of_numbers = values >= 2 or (is_value(cells[0]) and missing > 0)
    return of_numbers and values + missing >= 0.6 * count and (is_value(cells[0]) or values >= 3)


def separator_of(lines: Sequence[str]) -> tuple[str, int]:
    """Return the separator with which most lines are rows of values, and the number of their cells.

    Raises
    ------
    RecordingError
        No separator makes rows of at least two values.
    """
    sample = lines[:_MOST_LINES]
    best = (0, "", 0)
    for separator in SEPARATORS.values():
        counts: Counter[int] = Counter()
        for cells in split_cells(sample, separator):
            trimmed = len(cells) - (bool(cells) and not cells[-1])
            if trimmed >= 2 and is_row_of_values(cells, trimmed):
                counts[trimmed] += 1
        if counts:
            count, rows = counts.most_common(1)[0]
            if rows > 1.2 * best[0]:
                best = (rows, separator, count)
    if not best[0]:
        raise RecordingError(
            "no rows with two or more numbers were recognised; export the file as text (CSV), or give the separator "
            f"(--separator {'|'.join(SEPARATORS)})"
        )
    return best[1], best[2]


def decimal_of(cells: Iterable[str], separator: str) -> str:
    """Return the decimal sign of numbers.

    Raises
    ------
    RecordingError
        It cannot be recognised, or both signs are used as one.
    """
    points, commas, grouped = 0, 0, Counter[str]()
    for cell in cells:
        if "." not in cell and "," not in cell:
            continue
        if not _NUMBER.fullmatch(cell):
            continue
        number = cell.lower().partition("e")[0]
        last = max(number.rfind("."), number.rfind(","))
        sign, other = number[last], "," if number[last] == "." else "."
        if number.count(sign) > 1:
            sign, certain = other, True
        else:
            whole = number[:last].lstrip("+-−").strip()
            certain = other in number or len(number) - last - 1 != 3 or whole in ("", "0") or len(whole) > 3
        if not certain:
            grouped[sign] += 1
        elif sign == ".":
            points += 1
        else:
            commas += 1
    if points and commas:
        raise RecordingError(
            "some numbers have a decimal point and others a decimal comma; say which it is (--decimal . or --decimal ,)"
        )
    if points or commas:
        return "." if points else ","
    if grouped[","] and separator != ",":
        raise RecordingError(
            "all numbers with a comma have three digits after it, which may be decimals or thousands; say which it is "
            "(--decimal , or --decimal .)"
        )
    return "."


def numbers(cells: Sequence[str], decimal: str) -> np.ndarray:
    """Return cells as numbers, NaN for those that contain none; shape (n,).

    Examples
    --------
    >>> numbers(["1.234,5", "1 234,5", "---"], ",").tolist()
    [1234.5, 1234.5, nan]
    """
    other = "," if decimal == "." else "."
    table = str.maketrans({other: None, decimal: ".", "−": "-", **dict.fromkeys(_GROUPING)})
    plain = [cell.translate(table) for cell in cells]
    try:
        found = np.array(plain, dtype=float)
    except ValueError:
        found = np.array([_number(cell) for cell in plain])
    return np.where(np.isfinite(found), found, np.nan)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")
