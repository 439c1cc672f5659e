"""The subcommand with the operator's page."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated

import typer

from fringedic.command.app import MEASURE, Rig, app, say
from fringedic.command.folders import output_folder
from fringedic.command.view import LOCAL, PORT, Certificate, Host, Key, announce, ended_by_signals, page_address
from fringedic.configuration.installed_rigs import rig_path_of
from fringedic.errors import ConfigurationError

Port = Annotated[int, typer.Option(min=1, max=65535, help="Port of the page.")]


@app.command(rich_help_panel=MEASURE, epilog="Example: fringedic operate plate.yaml")
def operate(
    rig: Rig,
    attach: Annotated[bool, typer.Option("--attach", help="Join a rig that runs already.")] = False,
    port: Port = PORT,
    address: Host = LOCAL,
    certificate: Certificate = None,
    key: Key = None,
) -> None:
    """Set up, run and watch a test in a browser; prints the address of the page."""
    from fringedic.configuration.rig_sensors import load_rig_sensors
    from fringedic_bringup.operating.operate import operate as serve
    from fringedic_bringup.operating.procedures import Place

    path = rig if rig.exists() else own_copy(rig_path_of(rig))
    if len(names := load_rig_sensors(path).names) > 1:
        raise ConfigurationError(
            f"{path}: the page shows one sensor, and the rig has {', '.join(names)}. Set up each of them in a "
            f"terminal, such as with 'fringedic calibrate {path} --sensor {names[0]}', start a test with 'fringedic "
            f"run {path}', and look at its folder in the browser with 'fringedic view FOLDER/bag --sensor {names[0]}'"
        )
    place = page_address(address, port, certificate, key)
    stop = ended_by_signals().is_set
    serve(Place(path), place, attach=attach, ready=lambda: announce(place, "drive the machine"), stop=stop)


def own_copy(installed: Path) -> Path:
    """Return a copy of an installed rig file in this folder, where settings can be changed.

    Raises
    ------
    ConfigurationError
        It cannot be written.
    """
    copy = output_folder(Path()) / installed.name
    if not copy.exists():
        shutil.copyfile(installed, copy)
        say(f"rig file: {copy} (a copy of the installed one, for your settings)")
    return copy
