"""Subcommand that attaches files of other programs to a recording."""

from __future__ import annotations

import math
import re
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fringedic.command.app import RESULTS, Bag, Overwrite, Why, app, refuse_unused, say
from fringedic.errors import ConfigurationError

if TYPE_CHECKING:
    from fringedic.signals import Attached, ExportLayout, ExportOptions

_OFFSET = re.compile(r"\s*(?P<value>[-+]?[\d.]+(e[-+]?\d+)?)\s*((\+-|\+/-|±)\s*(?P<sigma>[\d.]+(e[-+]?\d+)?))?\s*")
_OF_A_FILE = ("columns", "time", "interval", "lines", "encoding", "separator", "decimal", "date", "by", "offset")


@app.command(
    rich_help_panel=RESULTS,
    epilog="Example: fringedic attach recordings/plate-7 machine.csv --columns 'Load [kN]=force'",
)
def attach(  # noqa: PLR0913 (options of a command)
    context: typer.Context,
    bag: Bag,
    file: Annotated[
        Path | None, typer.Argument(metavar="FILE", help="Export of a machine or logger; without it all are listed.")
    ] = None,
    columns: Annotated[
        list[str] | None,
        typer.Option(
            metavar="HEADING[UNIT]=NAME",
            help="Only this column: heading or number, its unit if the file has none, name; may be repeated.",
        ),
    ] = None,
    time: Annotated[
        list[str] | None, typer.Option(metavar="HEADING", help="Column with the time; twice for date and time of day.")
    ] = None,
    interval: Annotated[float | None, typer.Option(help="Seconds between two rows of a file without times.")] = None,
    lines: Annotated[str | None, typer.Option(metavar="FIRST-LAST", help="Only these lines of the file.")] = None,
    encoding: Annotated[str | None, typer.Option(help="Encoding of the file, such as cp1252 or utf-16.")] = None,
    separator: Annotated[
        str | None, typer.Option(help="Between the columns: semicolon, tab, comma, bar, spaces (two or more), space.")
    ] = None,
    decimal: Annotated[str | None, typer.Option(help="Decimal sign, . or ,")] = None,
    date: Annotated[str | None, typer.Option(help="Order of day, month and year: dmy, mdy or ymd.")] = None,
    by: Annotated[
        str | None, typer.Option(metavar="SIGNAL", help="Signal of both that fixes the clock, such as position.")
    ] = None,
    offset: Annotated[
        str | None,
        typer.Option(
            metavar="'SECONDS +- SIGMA'",
            help="Clock of the file minus that of the recording, instead of a fit; without dates it counts from the "
            "begin of the recording. Without +- it counts as rounded to its last digit.",
        ),
    ] = None,
    sigma: Annotated[
        list[str] | None, typer.Option(metavar="NAME=VALUE", help="Standard uncertainty of a signal in its SI unit.")
    ] = None,
    instead: Annotated[
        bool, typer.Option("--instead", help="Its signals replace recorded ones of the same name, such as force.")
    ] = False,
    name: Annotated[str | None, typer.Option(help="Name of the attachment, by default that of the file.")] = None,
    show: Annotated[bool, typer.Option("--show", help="Only show the structure that was recognised.")] = False,
    remove: Annotated[str | None, typer.Option(metavar="NAME", help="Remove this attachment.")] = None,
    overwrite: Overwrite = False,
    why: Why = "",
) -> None:
    """Attach the signals of a testing machine's export to a recording; structure and clock are recognised and shown.

    The clock is fitted with a signal that both have: force or position. The recording is not changed.
    """
    from fringedic.evidence.changes import because
    from fringedic.signals.attachments import remove_attachment

    if file is None:
        refuse_unused(context, _OF_A_FILE, "need a file to attach; give it after the recording")
        if remove is None:
            _list(bag)
            return
        with because(why):
            remove_attachment(bag, remove)
        say(f"{remove}: removed", _next(bag))
        return
    if remove is not None:
        raise ConfigurationError(f"--remove {remove}: give either a file to attach or an attachment to remove")
    options = _options(columns, time, interval, lines, encoding, separator, decimal, date)
    if show:
        _show_structure(file, options)
        return
    with because(why):
        _attach(
            bag,
            file,
            options,
            name=name,
            by=by,
            offset=None if offset is None else _offset(offset),
            sigmas=_sigmas(sigma or []),
            instead=instead,
            overwrite=overwrite,
        )
    say(_next(bag))


def _next(bag: Path) -> str:
    return f"next: `fringedic process {bag} --overwrite` makes the dataset with the signals that are attached now"


def _attach(bag: Path, file: Path, options: ExportOptions, **others: object) -> None:
    from fringedic.evidence.changes import noted
    from fringedic.figures.alignment import alignment_figure
    from fringedic.signals.attachments import PICTURE, attach, attachment_folder

    folder = attachment_folder(bag)
    with noted(folder, "attach"):
        attached = attach(bag, file, options=options, **others)  # type: ignore[arg-type]
        say(*_structure(attached.attachment.layout), *_clock(attached))
        if attached.alignment is not None:
            picture = folder / f"{attached.name}{PICTURE}"
            channel = attached.signals[attached.attachment.clock.by].channel
            alignment_figure(attached.alignment, channel, attached.name).savefig(picture)
            say(f"picture of the fit: {picture}")
    say(f"attached: {folder / attached.name}")


def _list(bag: Path) -> None:
    from fringedic.signals.attachments import attachment_names, read_attachment

    names = attachment_names(bag)
    if not names:
        say(f"{bag}: nothing is attached")
    for name in names:
        attached = read_attachment(bag, name)
        say(f"{name}: {', '.join(attached.signals)}; SHA-256 {attached.attachment.sha256}", *_clock(attached))


def _show_structure(file: Path, options: ExportOptions) -> None:
    from fringedic.errors import RecordingError
    from fringedic.signals.exports.layout import recognise

    try:
        say(*_structure(recognise(file.read_bytes(), options)))
    except RecordingError as error:
        raise RecordingError(f"{file}: {error}") from error


def _structure(layout: ExportLayout) -> list[str]:
    """Return the structure of a file as lines."""
    from fringedic.signals.exports.text import SEPARATORS

    separators = {sign: name for name, sign in SEPARATORS.items()}
    time = " and ".join(f"{number} {layout.headings[number - 1]}" for number in layout.time)
    if layout.interval is not None:
        time = f"{layout.interval:g} s between two rows"
    elif layout.time_kind != "number":
        time += f", {layout.time_kind}{f' ({layout.time_order})' if layout.time_order else ''}"
    sign = "comma" if layout.decimal == "," else "point"
    return [
        f"text: {layout.encoding}, separated by {separators.get(layout.separator, repr(layout.separator))}, decimal "
        f"{sign}, values in the lines {layout.first_line} to {layout.last_line}",
        f"time: {time}",
        *(
            f"{name}: column {column.number} {column.heading}"
            + (f", {column.unit} to {column.si}" if column.unit != column.si else "")
            for name, column in layout.columns.items()
        ),
        *(f"note: {remark}" for remark in layout.remarks),
    ]


def _clock(attached: Attached) -> list[str]:
    """Return the clock of an attachment as lines."""
    clock = attached.attachment.clock
    drift = f", drift {1e6 * clock.drift:+.1f} ± {1e6 * clock.sigma_drift:.1f} ppm" if clock.sigma_drift else ""
    how = "as given" if clock.by == "given" else f"by the {clock.by}"
    offset = f"{clock.offset:+.4f} s ± {1e3 * clock.sigma_offset:.2g} ms"
    lines = [f"clock of the file: {offset}{drift} (standard uncertainty), {how}"]
    lines += [f"note: {reason}" for reason in attached.refused.values()]
    alignment = attached.alignment
    if alignment is not None:
        unit = attached.signals[clock.by].channel.unit
        lines.append(
            f"values of the recording: {alignment.gain:.5g} times those of the file plus {alignment.level:.4g} {unit}"
        )
        if alignment.unusual_drift:
            lines.append("note: the drift is larger than that of crystal clocks; check the unit of the time")
    return lines


def _options(
    columns: list[str] | None,
    time: list[str] | None,
    interval: float | None,
    lines: str | None,
    encoding: str | None,
    separator: str | None,
    decimal: str | None,
    date: str | None,
) -> ExportOptions:
    """Return what is told of a file, checked."""
    from fringedic.signals.exports.layout import ExportOptions
    from fringedic.signals.exports.text import ENCODINGS, SEPARATORS

    if separator is not None and separator not in SEPARATORS and separator not in SEPARATORS.values():
        raise ConfigurationError(f"--separator {separator}: is none of {', '.join(SEPARATORS)}")
    if decimal not in (None, ".", ","):
        raise ConfigurationError(f"--decimal {decimal}: is neither . nor ,")
    if date not in (None, "dmy", "mdy", "ymd"):
        raise ConfigurationError(f"--date {date}: is none of dmy, mdy, ymd")
    if encoding is not None and encoding not in ENCODINGS:
        raise ConfigurationError(f"--encoding {encoding}: is none of {', '.join(ENCODINGS)}")
    if interval is not None and not 0 < interval < 1e6:
        raise ConfigurationError(f"--interval {interval}: is no time between two rows; give it in seconds")
    if lines is not None and not re.fullmatch(r"\d+-\d+", lines):
        raise ConfigurationError(f"--lines {lines}: write the first and the last line, such as 12-4000")
    first, _, last = (lines or "").partition("-")
    return ExportOptions(
        encoding=encoding,
        separator=None if separator is None else SEPARATORS.get(separator, separator),
        decimal=decimal,
        date=date,  # type: ignore[arg-type]
        time=tuple(time or ()),
        columns=tuple(columns or ()),
        lines=(int(first), int(last)) if lines else None,
        interval=interval,
    )


def _offset(text: str) -> tuple[float, float]:
    """Return offset and standard uncertainty; without one that of a number that is rounded to its last digit."""
    match = _OFFSET.fullmatch(text)
    try:
        if match is None:
            raise ValueError
        if match["sigma"] is None:
            last_digit = 10.0 ** int(Decimal(match["value"]).as_tuple().exponent)
            return float(match["value"]), last_digit / math.sqrt(12)
        return float(match["value"]), float(match["sigma"])
    except (ValueError, InvalidOperation) as error:
        raise ConfigurationError(f"--offset {text}: write seconds, such as 3600 or '12.4 +- 0.1'") from error


def _sigmas(texts: list[str]) -> dict[str, float]:
    found = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            found[name] = float(value)
            if not 0 <= found[name] < float("inf"):
                raise ValueError
        except ValueError as error:
            raise ConfigurationError(f"--sigma {text}: write NAME=VALUE in the SI unit, such as force=2.5") from error
    return found
