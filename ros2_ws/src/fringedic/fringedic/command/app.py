"""The ``fringedic`` command: shared by its subcommands. Those that start nodes come from packages that need ROS."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
import yaml
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from typer.core import TyperCommand, TyperGroup

from fringedic.command.folders import output_folder
from fringedic.command.plugins import INSTALL, load_commands
from fringedic.errors import ConfigurationError, FringedicError, RecordingError
from fringedic.wording.control_characters import visible
from fringedic.wording.yaml_text import load_yaml

if TYPE_CHECKING:
    from fringedic.frames.region import Region
    from fringedic.report.experiment import GaugePoints

BagKind = TypeVar("BagKind", Path, str)


class _Plain:
    """Help without a type beside an option that takes no value."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters, also those that typer adds, as it asks for them to write the help."""
        parameters: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for each in parameters:
            if getattr(each, "is_bool_flag", False):
                each.metavar = ""
        return parameters


class _Command(_Plain, TyperCommand):
    """A subcommand."""


class Group(_Plain, TyperGroup):
    """A command with subcommands."""


class _WithOtherPackages(Group):
    """The command, with the subcommands of other packages, which are imported when none of the library has the name."""

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002 (of click)
        """Return the names of all subcommands, by the order of their panels."""
        self._load()
        panels: dict[str, Any] = {name: getattr(each, "rich_help_panel", "") for name, each in self.commands.items()}
        return sorted(panels, key=lambda name: PANELS.index(panels[name]) if panels[name] in PANELS else len(PANELS))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a subcommand; None when there is none of this name."""
        if cmd_name not in self.commands:
            self._load()
        return super().get_command(ctx, cmd_name)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the subcommand of the arguments; the error about an unknown one names packages that are missing."""
        try:
            return super().resolve_command(ctx, args)
        except Exception as error:  # of click, or of the copy of it in typer
            if not self._load() and hasattr(error, "message"):
                error.message = (
                    f"{error.message.rstrip('.')}; commands that start nodes, such as run, come with the package "
                    f"fringedic_bringup, which is missing: {INSTALL}"
                )
            raise

    def _load(self) -> bool:
        """Add the subcommands of other packages, and return whether there are any."""
        found = load_commands()
        if len(app.registered_commands) + len(app.registered_groups) != len(self.commands):
            self.commands = typer.main.get_group(app).commands
        return found


class VisibleConsole(Console):
    """Shows control characters of texts that are printed, instead of sending them to the terminal."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield the parts of what is printed; those that move the cursor of progress bars are no texts."""
        for part in super().render(renderable, options):
            yield part if part.control else part._replace(text=visible(part.text))


class Commands(typer.Typer):
    """Collects subcommands."""

    def command(self, name: str | None = None, **options: Any) -> Any:
        """Return the decorator of a subcommand, with the options of `typer.Typer.command`."""
        return super().command(name, cls=_Command, **options)


SET_UP = "Set up and calibrate a rig"
MEASURE = "Measure"
IMAGES = "Images of other programs, no rig"
RESULTS = "Recordings and results"
MANY = "Many tests"
PANELS = (SET_UP, MEASURE, RESULTS, IMAGES, MANY)  # in the order of the help

app = Commands(
    cls=_WithOtherPackages,
    help="3D shape and displacement of surfaces, measured with one camera and one projector.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",  # brackets of units are no markup there,
)
console = VisibleConsole(width=None if sys.stdout.isatty() else 120)


def begin(path: Path) -> Path:
    """Return a path, and print it as the first line of a command: libraries and nodes load for seconds after it."""
    say(f"reading {path}")
    return path


def _recording(path: Path) -> Path:
    begin(path)
    from fringedic.recording.bag_files import recording_of

    return recording_of(path)


def _optional_recording(path: Path | None) -> Path | None:
    return None if path is None else _recording(path)


def _place(text: str) -> str:
    """Return a recording as `_recording` does, or its address in an object store, which is no path."""
    if "://" not in text:
        return str(_recording(Path(text)))
    say(f"reading {text}")
    return text


def _places(texts: list[str]) -> list[str]:
    return [_place(text) for text in texts]


def _begun(paths: list[Path]) -> list[Path]:
    for path in paths:
        begin(path)
    return paths


def _recordings(paths: list[Path]) -> list[Path]:
    return [_recording(path) for path in paths]


Rig = Annotated[
    Path,
    typer.Argument(
        metavar="RIG", help="Rig file, or the name of one that is installed with fringedic.", callback=begin
    ),
]
Source = Annotated[
    Path, typer.Argument(metavar="BAG|DATASET", help="Recording, folder of a run, or dataset.", callback=begin)
]

Sources = Annotated[
    list[Path],
    typer.Argument(metavar="BAG|DATASET", help="Recordings, folders of runs, or datasets.", callback=_begun),
]

Bag = Annotated[Path, typer.Argument(metavar="BAG", help="Folder of a recording, or of a run.", callback=_recording)]
OptionalBag = Annotated[
    Path | None,
    typer.Argument(metavar="BAG", help="Folder of a recording, or of a run.", callback=_optional_recording),
]
Bags = Annotated[
    list[Path],
    typer.Argument(
        metavar="BAGS", help="Folders of recordings or runs, processed one after the other.", callback=_recordings
    ),
]
Place = Annotated[
    str, typer.Argument(metavar="BAG", help="Folder of a recording or run, or its address: s3://...", callback=_place)
]
Places = Annotated[
    list[str],
    typer.Argument(
        metavar="BAGS",
        help="Folders of recordings or runs, or their addresses (s3://...), processed one after the other.",
        callback=_places,
    ),
]
Steps = Annotated[list[int] | None, typer.Option("--step", help="Only this step and its reference; may be repeated.")]
ReferenceStep = Annotated[
    int | None, typer.Option("--reference", help="Step against which all others are measured, also earlier ones.")
]
Calibration = Annotated[
    Path | None, typer.Option(help="Calibration that replaces the recorded one: its file or folder.")
]
Sensor = Annotated[
    str | None,
    typer.Option("--sensor", metavar="NAME", help="Name of the sensor, if the recording contains several."),
]
RigSensor = Annotated[
    str | None,
    typer.Option("--sensor", metavar="NAME", help="Name of the sensor, if the rig file has several."),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace existing files.")]
Output = Annotated[Path | None, typer.Option(help="Output folder.")]
Why = Annotated[str, typer.Option(metavar="TEXT", help="Reason, for the log of the run that the file is written into.")]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NODE.PARAMETER=VALUE", help="Replaces a recorded parameter; may be repeated."),
]


def _print_version(wanted: bool) -> None:
    if not wanted:
        return
    from fringedic.provenance import git_commit, software

    say(f"{software()}, commit {git_commit()}, Python {sys.version.split()[0]}")
    raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and end.", is_eager=True, callback=_print_version)
    ] = False,
) -> None:
    """Take the options that come before a subcommand."""


def say(*lines: object) -> None:
    """Print lines as they are, without markup or colours."""
    for line in lines:
        console.print(str(line), markup=False, highlight=False)


def calibration_file(path: Path) -> Path:
    """Return the file of a calibration that is given as file or folder.

    Raises
    ------
    ConfigurationError
        There is no such file.
    """
    file = path / "calibration.yaml" if path.is_dir() else path
    if not file.is_file():
        raise ConfigurationError(f"{file}: no such calibration; give its file or folder")
    return file


def refuse_unused(context: typer.Context, names: Collection[str], reason: str) -> None:
    """Refuse options that were given although the command does not use them beside others.

    Parameters
    ----------
    context
        Of the command.
    names
        Names of the options in the function of the command.
    reason
        End of the sentence: why they are not used, and what to do.

    Raises
    ------
    ConfigurationError
        At least one was given.
    """
    options = {str(each.name): each.opts[0] for each in context.command.params if each.name in names}
    unused = [option for name, option in options.items() if given(context, name)]
    if unused:
        raise ConfigurationError(f"{', '.join(unused)}: {reason}")


def given(context: typer.Context, name: str) -> bool:
    """Return whether the option of a parameter was written in the command line."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def parameter_values(settings: Iterable[str] | None) -> dict[str, Any]:
    """Return ``["dic.window=24"]`` as {"dic.window": 24}.

    Raises
    ------
    ConfigurationError
        A setting has another form.
    """
    values = {}
    for setting in settings or []:
        name, equals, text = setting.partition("=")
        if not equals or name.count(".") != 1:
            raise ConfigurationError(f"--set {setting}: write node.parameter=value, for example dic.window=24")
        try:
            values[name] = load_yaml(text)
        except yaml.YAMLError as error:
            raise ConfigurationError(f"--set {name}: {error}") from error
    return values


def named_gauges(texts: Iterable[str] | None) -> dict[str, GaugePoints]:
    """Return virtual extensometers by name from ``["edge=200,480,1000,480"]``; without a name they are numbered.

    Raises
    ------
    ConfigurationError
        A text has another form.
    """
    gauges: dict[str, GaugePoints] = {}
    for number, text in enumerate(texts or [], start=1):
        name, _, positions = text.rpartition("=")
        try:
            values = [float(part) for part in positions.split(",")]
            if len(values) != 4 or not all(map(math.isfinite, values)):
                raise ValueError
        except ValueError as error:
            raise ConfigurationError(
                f"--extensometer {text}: give COLUMN,ROW,COLUMN,ROW in pixels, such as 200,480,1000,480, or with a "
                "name edge=200,480,1000,480"
            ) from error
        gauges[name or str(number)] = ((values[0], values[1]), (values[2], values[3]))
    return gauges


def named_regions(texts: Iterable[str] | None) -> dict[str, Region]:
    """Return regions by name from ``["hole=hole.yaml"]``, files of `fringedic region`; without a name that of the file.

    Raises
    ------
    ImageError
        A file cannot be read or contains no region.
    """
    from fringedic.frames.region import Region

    regions = {}
    for text in texts or []:
        name, _, file = text.rpartition("=")
        regions[name or Path(file).stem] = Region.load(file)
    return regions


def for_each(bags: list[BagKind], work: Callable[[BagKind], None]) -> None:
    """Call a function with each recording; when one fails, report it and continue with the others.

    Raises
    ------
    RecordingError
        Some of several recordings failed.
    FringedicError
        The only recording failed.
    """
    if len(bags) == 1:
        work(bags[0])
        return
    failed = []
    for bag in bags:
        try:
            work(bag)
        except FringedicError as error:
            say(f"{bag}: {error}")
            failed.append(str(bag))
    if failed:
        raise RecordingError(f"failed: {', '.join(failed)}")


def losses(bag: Path) -> list[str]:
    """Return what of a damaged recording is whole and what is lost; nothing of a whole one."""
    from fringedic.recording.repair import info
    from fringedic.recording.sentences import content_sentences

    content = info(bag)
    return [] if content.whole else content_sentences(content)


def next_reading(source: Path) -> str:
    """Return the commands that show the results of a recording or dataset."""
    return f"next: `fringedic report {source}` shows the results, `fringedic export {source}` converts them"


@contextmanager
def kept_if_filled(folder: Path) -> Iterator[None]:
    """Create a folder for results, and remove it when nothing was written into it."""
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        with suppress(OSError):  # it is not empty
            folder.rmdir()


def output_file(file: Path, overwrite: bool) -> Path:
    """Return a file after a check that it can be written and does not replace another one unasked.

    Raises
    ------
    ConfigurationError
        It cannot, or it exists.
    """
    output_folder(file.parent)
    if file.exists() and not overwrite:
        raise ConfigurationError(f"{file} exists already; choose another --output, or replace it with --overwrite")
    return file
