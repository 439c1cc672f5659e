"""Subcommands about the evidence of a run: its audit, and entries in its log."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from fringedic.command.app import RESULTS, Overwrite, app, console, output_file, say
from fringedic.command.progress import LiveProgress
from fringedic.errors import ConfigurationError

Run = Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, or of a calibration.")]


@app.command(rich_help_panel=RESULTS, epilog="Example: fringedic audit recordings/plate-7 --key laboratory.pem")
def audit(
    run: Run,
    key: Annotated[
        list[Path] | None,
        typer.Option(help="Public key of the laboratory (PEM), by default that of this computer; may be repeated."),
    ] = None,
    authority: Annotated[
        Path | None, typer.Option(help="Root certificates (PEM) of time-stamp authorities that you trust.")
    ] = None,
    recompute: Annotated[
        bool, typer.Option("--recompute/--no-recompute", help="Compute results and calibration from the raw data.")
    ] = True,
    output: Annotated[Path | None, typer.Option(help="Page for an auditor, .html; or .json for programs.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Check everything that supports the results of a run; the exit code is 0 only if all of it holds."""
    from fringedic.audit import audit_run
    from fringedic.audit.sentences import part_sentence, verdict_sentence
    from fringedic.evidence.keys import read_public_key
    from fringedic.evidence.time_stamps import read_certificates
    from fringedic.report.audit import write_audit_page

    target = None if output is None else output_file(output, overwrite)
    keys = [read_public_key(path) for path in key or []]
    authorities = [] if authority is None else read_certificates(authority)
    with LiveProgress(console) as progress:
        found = audit_run(run, keys=keys, authorities=authorities, recompute=recompute, progress=progress.stage)
    for part in found.parts:
        say(part_sentence(part))
        if part.action:
            say(f"    {part.action}")
    say(verdict_sentence(found))
    if target is not None and target.suffix == ".json":
        content = {"run": str(found.run), "time": found.time.isoformat(), "holds": found.holds}
        parts = [asdict(part) for part in found.parts]
        entries = [entry.model_dump() for entry in found.entries]
        target.write_text(json.dumps({**content, "parts": parts, "log": entries}, indent=1), encoding="utf-8")
    elif target is not None:
        write_audit_page(found, target)
    if target is not None:
        say(f"written: {target}")
    if not found.holds:
        raise typer.Exit(1)


@app.command(rich_help_panel=RESULTS, epilog='Example: fringedic note recordings/plate-7 "specimen had slipped"')
def note(
    run: Run,
    text: Annotated[str, typer.Argument(metavar="WHY", help="The note, or why files were changed.")] = "",
    file: Annotated[
        list[Path] | None,
        typer.Option(help="File in the run that was changed, added or removed by hand; may be repeated."),
    ] = None,
    time_stamp: Annotated[
        str | None, typer.Option(metavar="SERVER", help="Have this RFC 3161 authority confirm the log.")
    ] = None,
) -> None:
    """Add a note to the log of a run and sign it; a run without a log is signed as it is."""
    from fringedic.evidence.changes import add_note, begin_log
    from fringedic.evidence.log import has_log
    from fringedic.evidence.time_stamps import add_time_stamp

    if not run.is_dir():
        raise ConfigurationError(f"{run}: no such folder; give the folder of a run")
    if not text and time_stamp is None:
        raise ConfigurationError("there is nothing to note: give a text, or --time-stamp SERVER")
    if not has_log(run):
        begin_log(run, "signed later", why=text, details={})
        say(f"{run}: signed as it is now")
    elif text:
        add_note(run, text, file or [])
        say(f"{run}: noted")
    if time_stamp is not None:
        when = add_time_stamp(run, time_stamp, text)
        say(f"{run}: confirmed by {time_stamp} at {when:%Y-%m-%d %H:%M:%S} UTC")
