"""Exports of machines: their structure is recognised, their signals are those that were written."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import pytest
from machine_exports import BEGIN, STYLES, bluehill, measured

from fringedic.errors import RecordingError
from fringedic.signals import ExportOptions, Signal, read_export, recognise

TOLD = {"american": ExportOptions(date="mdy"), "two_times": ExportOptions(time=["TotalTime"])}
NONE = ExportOptions()


def read(data: bytes, options: ExportOptions = NONE) -> dict[str, Signal]:
    return read_export(data, recognise(data, options), "machine")


@pytest.mark.parametrize("style", STYLES)
def test_signals_are_those_that_the_machine_wrote(style: str) -> None:
    time, force, position = measured()
    signals = read(STYLES[style]((time, force, position)), TOLD.get(style, NONE))
    assert {"force", "position"} <= signals.keys() or style == "catman"
    second = signals.get("position", next(iter(signals.values())) if style != "catman" else signals.get("wa100"))
    assert second is not None
    np.testing.assert_allclose(signals["force"].values, force, atol=1e-2)
    np.testing.assert_allclose(second.values, position, atol=1e-7)
    stamps = signals["force"].stamps
    np.testing.assert_allclose(1e-9 * (stamps - stamps[0]), time, atol=1e-3)
    assert (signals["force"].channel.unit, second.channel.unit) == ("N", "m")


@pytest.mark.parametrize("style", TOLD)
def test_what_cannot_be_recognised_is_one_sentence_with_the_option(style: str) -> None:
    message = {"american": "may be 3 April or 4 March; say which (--date dmy", "two_times": "choose one: --time 1"}
    with pytest.raises(RecordingError, match=re.escape(message[style])):
        recognise(STYLES[style](measured()))


def test_dates_are_read_to_the_millisecond() -> None:
    signals = read(STYLES["labview_spreadsheet"](measured()))
    begin = np.datetime64(BEGIN, "ns").astype(np.int64)
    assert signals["force"].stamps[0] == begin


def test_repeated_headers_are_left_out_and_counted() -> None:
    layout = recognise(STYLES["flextest"](measured()))
    assert [each for each in layout.remarks if "12 lines between the rows" in each]


def replaced(data: bytes, line: int, text: str) -> bytes:
    lines = data.decode("cp1252").split("\r\n")
    lines[line - 1] = text
    return "\r\n".join(lines).encode("cp1252")


@pytest.mark.parametrize(
    ("shift", "reason"),
    [
        (-3600, "line 308: the time goes back by 3600 s, as at the end of daylight saving time; attach the lines"),
        (-7, "line 308: the time goes back by 6.9 s, its clock was set, or another test begins"),
        (3600, "line 308: the time jumps forward by an hour, as at the begin of daylight saving time"),
    ],
)
def test_a_clock_that_is_set_in_the_middle_is_refused(shift: int, reason: str) -> None:
    lines = STYLES["labview_spreadsheet"](measured()).decode("cp1252").split("\r\n")
    for place in range(307, len(lines) - 1):
        date, time, *others = lines[place].split("\t")
        hours, minutes, seconds = time.split(":")
        total = 3600 * int(hours) + 60 * int(minutes) + float(seconds.replace(",", ".")) + shift
        time = f"{int(total // 3600):02d}:{int(total // 60) % 60:02d}:{total % 60:06.3f}".replace(".", ",")
        lines[place] = "\t".join([date, time, *others])
    data = "\r\n".join(lines).encode("cp1252")
    if abs(shift) == 3600:
        reason = reason.replace("3600 s", "3599.9 s")
    with pytest.raises(RecordingError, match=re.escape(reason)):
        read(data)
    assert read(data, ExportOptions(lines=(1, 307)))["force"].values.size == 306
    assert read(data, ExportOptions(lines=(308, 700)))["force"].values.size == 294


def test_midnight_is_no_jump() -> None:
    rows = [f"{'23:59:59.' if each < 5 else '00:00:00.'}{each % 5}00;{each}.5" for each in range(10)]
    signals = read("\n".join(["time of day;force [N]", *rows]).encode())
    assert np.diff(signals["force"].stamps).min() > 0


def test_columns_of_the_same_name_are_all_read_and_numbered() -> None:
    data = b"time [s];force [N];force [N];force [N]\n0;1.5;2.5;9.5\n1;1.6;2.6;9.6\n"
    layout = recognise(data)
    assert list(layout.columns) == ["force", "force_3", "force_4"]
    assert "column 3 'force [N]' is named force_3, since force exists already" in layout.remarks
    assert read(data)["force_3"].values.tolist() == [2.5, 2.6]
    with pytest.raises(RecordingError, match="the columns 2 and 3 and 4 have this name"):
        recognise(data, ExportOptions(columns=["force"]))
    assert read(data, ExportOptions(columns=["4=force"]))["force"].values.tolist() == [9.5, 9.6]


def test_an_unknown_unit_leaves_the_column_out_and_can_be_told() -> None:
    data = b"time [s];force [stone];grip [degC]\n0;1.5;20.5\n1;1.6;20.6\n"
    layout = recognise(data)
    assert list(layout.columns) == ["grip"]
    assert "column 2 'force [stone]' has the unit 'stone', which is not known, and is left out" in layout.remarks[0]
    with pytest.raises(RecordingError, match="the column has the unit 'stone', which is not known"):
        recognise(data, ExportOptions(columns=["force"]))
    signals = read(data, ExportOptions(columns=["force [kN]=force", "grip=temperature_grip"]))
    assert signals["force"].values.tolist() == [1500.0, 1600.0]
    assert signals["temperature_grip"].values.tolist() == pytest.approx([293.65, 293.75])


@pytest.mark.parametrize(
    ("data", "options", "reason"),
    [
        (b"", {}, "no rows with two or more numbers were recognised"),
        (b"hello\nworld\n", {}, "no rows with two or more numbers were recognised"),
        (b"\x89PNG\r\n\x1a\n\x00\x00", {}, "no rows with two or more numbers"),
        (b"a;b\n1,234;2,345\n3,456;4,567\n", {}, "say which it is (--decimal"),
        (b"a;b\n1,5;2.5\n3,5;4.5\n", {}, "some numbers have a decimal point and others a decimal comma"),
        (b"force [N];grip [K]\n1.5;2.5\n3.5;4.5\n", {}, "no column contains a time, of 1 force [N], 2 grip [K]"),
        (b"time [s];force\n1.5;2.5\n3.5;4.5\n", {}, "no column has a known unit: column 2 'force' has no unit"),
        (b"time [mm];force [N]\n1.5;2.5\n3.5;4.5\n", {"time": ["1"]}, "has the unit 'mm', which is none of a time"),
        (
            b"time [s];force [N]\n1.5;2.5\n3.5;4.5\n",
            {"columns": ["Kraft=force"]},
            "has no such column, only 1 time [s]",
        ),
        (b"time [s];force [N]\n1.5;2.5\n3.5;4.5\n", {"lines": (9, 3)}, "--lines 9-3: the file has the lines 1-4"),
        (b"date;force [N]\n13/14/2026 10:00:00;2.5\n13/15/2026 10:00:00;4.5\n", {}, "have no month"),
        ("\xe4".encode("cp1252"), {"encoding": "utf-8"}, "byte 0 is no text in the encoding utf-8"),
    ],
)
def test_what_is_wrong_is_one_sentence(data: bytes, options: dict[str, Sequence[str]], reason: str) -> None:
    with pytest.raises(RecordingError, match=re.escape(reason)) as error:
        recognise(data, ExportOptions(**options))  # type: ignore[arg-type]
    assert "\n" not in str(error.value)


def test_cells_without_a_number_are_not_measured() -> None:
    data = replaced(STYLES["testxpert"](measured()), 100, "9,20;---;;Prüfen")
    force = read(data)["force"]
    assert np.isnan(force.values).sum() == 1
    assert force.values.size == 600


def test_a_layout_that_is_stored_reads_the_same() -> None:
    data = bluehill(measured())
    layout = recognise(data)
    again = type(layout).model_validate_json(layout.model_dump_json())
    assert again == layout
    assert read_export(data, again, "a")["force"].values.tolist() == read(data)["force"].values.tolist()
