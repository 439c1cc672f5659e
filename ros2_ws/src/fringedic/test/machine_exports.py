"""Files as testing machines and data acquisition export them, written without any code of the reader."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime, timedelta

import numpy as np

BEGIN = datetime(2026, 11, 29, 9, 59, 58, 500_000)
Table = tuple[np.ndarray, np.ndarray, np.ndarray]  # time [s], force [N], position [m]


def measured(count: int = 600, seed: int = 3) -> Table:
    """Return a test of ramps and holds: time [s], force [N] and position [m]."""
    time = 0.1 * np.arange(count)
    position = 1e-3 * np.interp(time, np.arange(0, 60, 6), np.repeat(np.arange(5), 2) * 0.31)
    force = 3.1e6 * position + np.random.default_rng(seed).normal(0, 2, count)
    return time, force, position


def comma(value: float, digits: int, thousands: str = "") -> str:
    """Return a number with a decimal comma."""
    whole, _, rest = f"{value:,.{digits}f}".partition(".")
    return whole.replace(",", thousands) + "," + rest


def quoted(cells: Sequence[str]) -> list[str]:
    """Return cells in quotation marks."""
    return [f'"{cell}"' for cell in cells]


def bluehill(table: Table) -> bytes:
    """Instron Bluehill, English."""
    head = ['"Results Table 1"', '"","Maximum load"', '"","(N)"', '"1","3844.2"', "", '"Specimen 1"']
    head += ['"Time","Extension","Load"', '"(s)","(mm)","(N)"']
    rows = [",".join(quoted([f"{t:.3f}", f"{1e3 * x:.5f}", f"{f:.4f}"])) for t, f, x in zip(*table, strict=True)]
    return "\r\n".join([*head, *rows, ""]).encode("utf-8")


def bluehill_german(table: Table) -> bytes:
    """Instron Bluehill, German, with points between the thousands."""
    head = ['"Probenbezeichnung";"Blech längs 3"', "", '"Zeit";"Verlängerung";"Last"', '"(s)";"(mm)";"(kN)"']
    rows = [
        ";".join(quoted([comma(t, 3), comma(1e3 * x, 5), comma(1e-3 * f, 6)])) for t, f, x in zip(*table, strict=True)
    ]
    return "\r\n".join([*head, *rows, ""]).encode("cp1252")


def testxpert(table: Table) -> bytes:
    """ZwickRoell testXpert II."""
    head = ["Prüfprotokoll;", "Prüfnorm;ISO 6892-1", "Vorkraft;5;N", "Prüfgeschwindigkeit;1,5;mm/min", ""]
    head += ["Prüfzeit;Standardweg;Standardkraft;Zustand", "s;mm;N;"]
    rows = [
        f"{comma(t, 2)};{comma(1e3 * x, 4)};{comma(f, 3, '.')};{'Prüfen' if t > 1 else 'Vorkraft'}"
        for t, f, x in zip(*table, strict=True)
    ]
    return "\r\n".join([*head, *rows, ""]).encode("cp1252")


def testxpert_unicode(table: Table) -> bytes:
    """ZwickRoell testXpert III: tabs, UTF-16, thin spaces between the thousands."""
    head = ["Prüfung 7", "Prüfer\tMüller", "", "Prüfzeit [s]\tTraversenweg [µm]\tKraft [N]"]
    rows = [
        f"{comma(t, 1)}\t{comma(1e6 * x, 2, ' ')}\t{comma(f, 2, chr(0x202F))}" for t, f, x in zip(*table, strict=True)
    ]
    return "\r\n".join([*head, *rows, ""]).encode("utf-16")


def testsuite(table: Table) -> bytes:
    """MTS TestSuite."""
    head = ["MTS TestSuite", "Test Run Name:\tTension 4", "Date:\t11/29/2026 10:00:00 AM", ""]
    head += ["Time\tAxial Displacement\tAxial Force", "sec\tmm\tN"]
    rows = [f"{t:.4f}\t{1e3 * x:.6e}\t{f:.6e}" for t, f, x in zip(*table, strict=True)]
    return "\n".join([*head, *rows, ""]).encode("utf-8-sig")


def flextest(table: Table) -> bytes:
    """MTS FlexTest: the header is repeated with every block of data."""
    lines = ["MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A", ""]
    for first in range(0, table[0].size, 150):
        lines += [f"Data Acquisition: Block {first // 150 + 1}\t\t\tTime:\t{table[0][first]:.3f}\tSec"]
        lines += ["Station Name:\tRig.cfg", "Running Time\tAxial Stroke\tAxial Load", "Sec\tmm\tkN"]
        block = (each[first : first + 150] for each in table)
        lines += [f"{t:.5f}\t{1e3 * x:.5f}\t{1e-3 * f:.6f}" for t, f, x in zip(*block, strict=True)]
        lines += [""]
    return "\r\n".join(lines).encode("ascii")


def trapezium(table: Table) -> bytes:
    """Shimadzu Trapezium X."""
    head = ['"Key word","","Product Name",""', '"Test Type","Tensile"', '"","1 _ 1","",""']
    head += ['"Time","Force","Stroke"', '"sec","N","mm"']
    rows = [",".join(quoted([f"{t:.2f}", f"{f:.3f}", f"{1e3 * x:.5f}"])) for t, f, x in zip(*table, strict=True)]
    return "\r\n".join([*head, *rows, ""]).encode("cp1252")


def labview_measurement(table: Table) -> bytes:
    """LabVIEW measurement file (.lvm)."""
    head = [
        "LabVIEW Measurement\t",
        "Writer_Version\t2",
        "Separator\tTab",
        "Decimal_Separator\t.",
        "Multi_Headings\tNo",
    ]
    head += ["X_Columns\tOne", "Time_Pref\tRelative", "Operator\tlab", "Date\t2026/11/29", "Time\t09:59:58.5000000"]
    head += ["***End_of_Header***\t", "", "Channels\t2\t\t", f"Samples\t{table[0].size}\t{table[0].size}\t"]
    head += ["Y_Unit_Label\tNewtons\tmm\t", "X_Dimension\tTime\tTime\t", "***End_of_Header***\t\t\t"]
    head += ["X_Value\tLoad cell\tStroke\tComment"]
    rows = [f"{t:.6f}\t{f:.6f}\t{1e3 * x:.6f}" for t, f, x in zip(*table, strict=True)]
    return "\r\n".join([*head, *rows, ""]).encode("ascii")


def labview_spreadsheet(table: Table) -> bytes:
    """LabVIEW, written as a spreadsheet with date and time of day in two columns."""
    lines = ["Datum\tUhrzeit\tKraft / N\tWeg / mm"]
    for t, f, x in zip(*table, strict=True):
        now = BEGIN + timedelta(seconds=float(t))
        lines.append(
            f"{now:%d.%m.%Y}\t{now:%H:%M:%S},{now.microsecond // 1000:03d}\t{comma(f, 3)}\t{comma(1e3 * x, 5)}"
        )
    return "\r\n".join([*lines, ""]).encode("cp1252")


def catman(table: Table) -> bytes:
    """HBM catman."""
    head = [
        "HBM_CATMANEASYBINFILE_ASCII",
        "Dateikommentar:\t",
        "",
        "Zeit  1 - Standardmessrate [s]\tKraft [kN]\tWA100 [mm]",
    ]
    rows = [f"{t:.6f}\t{1e-3 * f:.7f}\t{1e3 * x:.6f}" for t, f, x in zip(*table, strict=True)]
    return "\r\n".join([*head, *rows, ""]).encode("utf-16-le")


def american(table: Table) -> bytes:
    """A logger with American dates, which cannot be told from British ones (3/4/2026), pounds and inches."""
    begin = BEGIN.replace(month=3, day=4)
    lines = ["Timestamp,Load (lbf),Extension (in)"]
    for t, f, x in zip(*table, strict=True):
        now = begin + timedelta(seconds=float(t))
        stamp = f"{now.month}/{now.day}/{now:%Y %I:%M:%S}.{now.microsecond // 1000:03d} {now:%p}"
        lines.append(f'{stamp},"{f / 4.4482216152605:,.4f}",{x / 0.0254:.7f}')
    return "\n".join([*lines, ""]).encode("ascii")


def two_times(table: Table) -> bytes:
    """A controller that writes the time of the test and that of the segment, in columns of fixed width."""
    lines = ["# controller 4.1", "#", "TotalTime(s)   SegmentTime(s)   Force(N)     Position(mm)"]
    lines += [f"{t:12.4f}   {t % 6:12.4f}   {f:12.4f}   {1e3 * x:12.6f}" for t, f, x in zip(*table, strict=True)]
    return "\n".join([*lines, ""]).encode("ascii")


STYLES: dict[str, Callable[[Table], bytes]] = {
    each.__name__: each
    for each in (
        bluehill,
        bluehill_german,
        testxpert,
        testxpert_unicode,
        testsuite,
        flextest,
        trapezium,
        labview_measurement,
        labview_spreadsheet,
        catman,
        american,
        two_times,
    )
}
