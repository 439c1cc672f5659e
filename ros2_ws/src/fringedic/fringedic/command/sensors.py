"""Subcommand that places several sensors in one frame."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fringedic.command.app import SET_UP, Bag, Overwrite, app, calibration_file, console, output_file, say
from fringedic.command.progress import LiveProgress
from fringedic.errors import ConfigurationError

if TYPE_CHECKING:
    from fringedic.rig.model import RigModel


@app.command(
    rich_help_panel=SET_UP,
    epilog="Example: fringedic register recordings/balls/bag --balls-mm 10 --output recordings/plate-7",
)
def register(
    bag: Bag,
    balls_mm: Annotated[
        float | None,
        typer.Option(help="Diameter of the balls of the common object; without it the object is a plane."),
    ] = None,
    number: Annotated[int, typer.Option(min=3, help="How many balls every sensor sees.")] = 3,
    reference: Annotated[
        str | None,
        typer.Option(metavar="SENSOR", help="Its frame becomes the common one; by default the first by name."),
    ] = None,
    calibration: Annotated[
        list[str] | None,
        typer.Option(
            metavar="SENSOR=FILE", help="Calibration instead of the recorded one: file or folder; may be repeated."
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(help="File or folder for the registration; by default registration.yaml beside the recording."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Place several sensors in one frame by an object that they recorded in several places; exit code 1 for NO-GO.

    The object is one of three or more balls, or a plane that is tilted about two axes.
    """
    from fringedic.evidence.changes import noted
    from fringedic.sensors.files import REGISTRATION_FILE, save_registration
    from fringedic.sensors.findings import RegistrationVerdict
    from fringedic.sensors.recorded import Balls, register_recording
    from fringedic.sensors.sentences import registration_in_words

    if balls_mm is not None and not (math.isfinite(balls_mm) and balls_mm > 0):
        raise ConfigurationError(f"--balls-mm {balls_mm}: give the diameter of the balls in mm, such as 10")
    target = bag.parent if output is None else output
    file = output_file(target if target.suffix in (".yaml", ".yml") else target / REGISTRATION_FILE, overwrite)
    with LiveProgress(console) as progress:
        progress.stage(f"registering the sensors of {bag}")
        registration = register_recording(
            bag,
            balls=None if balls_mm is None else Balls(1e-3 * balls_mm, number),
            calibrations=_calibrations(calibration or []),
            reference=reference,
            progress=progress.note,
        )
    with noted(file, "register"):
        save_registration(registration, file)
    say(*registration_in_words(registration), f"registration: {file}")
    if registration.verdict is RegistrationVerdict.NO_GO:
        raise typer.Exit(1)
    say("next: `fringedic process BAG` measures all sensors of a recording beside it, and their joined surface")


def _calibrations(texts: list[str]) -> dict[str, RigModel]:
    from fringedic.rig.model import RigModel

    found = {}
    for text in texts:
        name, equals, file = text.partition("=")
        if not (name and equals and file):
            raise ConfigurationError(f"--calibration {text}: write SENSOR=FILE, such as left=left/calibration.yaml")
        found[name] = RigModel.from_yaml(calibration_file(Path(file)))
    return found
