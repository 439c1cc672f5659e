"""Entry point of the ``fringedic`` command."""

from __future__ import annotations

import sys

import typer

from fringedic.errors import FringedicError
from fringedic_bringup.command import calibration, experiments, images, recordings, rig_setup
from fringedic_bringup.command.app import app

__all__ = [
    "app",
    "calibration",
    "experiments",
    "images",
    "main",
    "recordings",
    "rig_setup",
]  # importing them adds their subcommands


def main() -> None:
    """Run the command; an error is one sentence on the error stream and exit code 1."""
    try:
        app()
    except FringedicError as error:
        typer.echo(error, err=True)
        sys.exit(1)
    except OSError as error:  # of a path that cannot be used, or a full disk
        place = f"{error.filename}: " if error.filename else ""
        typer.echo(f"{place}{error.strerror or error}; choose another path or make room", err=True)
        sys.exit(1)
    except KeyboardInterrupt:
        typer.echo("interrupted; the nodes have ended and the recording is closed", err=True)
        sys.exit(130)
