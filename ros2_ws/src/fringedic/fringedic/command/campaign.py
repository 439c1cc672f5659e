"""Subcommands of campaigns: many recordings, one store, without ROS."""

from __future__ import annotations

import time
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from fringedic.command.app import MANY, Commands, Group, app, begin, console, output_file, say
from fringedic.errors import CampaignError, ConfigurationError
from fringedic.wording.numbers import number_text

if TYPE_CHECKING:
    from fringedic.campaign import Engine, Status, Unit
    from fringedic.campaign.receipts import Failure, Receipt

campaigns = Commands(
    cls=Group,
    help="Process many recordings into one store; resumable at any time.",
    no_args_is_help=True,
    epilog="Example: fringedic campaign run batch-7 --workers 2",
)
app.add_typer(campaigns, name="campaign", rich_help_panel=MANY)

Folder = Annotated[
    Path, typer.Argument(metavar="DIR", help="Folder of the campaign with its campaign.yaml.", callback=begin)
]
Recompute = Annotated[
    bool, typer.Option("--recompute", help="Remove results of other settings, recordings or software.")
]


class EngineName(StrEnum):
    """Engines of a campaign."""

    SERIAL = "serial"
    PROCESSES = "processes"
    DASK = "dask"


EngineChoice = Annotated[
    EngineName | None,
    typer.Option("--engine", help="By default dask with a scheduler, processes with several workers, or serial."),
]
Workers = Annotated[int, typer.Option(min=1, help="Worker processes of this computer.")]
Scheduler = Annotated[str | None, typer.Option(metavar="ADDRESS", help="Of a Dask cluster: tls://computer:8786.")]
Shard = Annotated[str, typer.Option(metavar="I/N", help="Only the I-th of N parts, for arrays of jobs.")]


@campaigns.command(epilog="Example: fringedic campaign init batch-7")
def init(folder: Folder) -> None:
    """Write an example of campaign.yaml into a new folder."""
    from fringedic.campaign.settings import EXAMPLE, FILE

    file = output_file(folder / FILE, overwrite=False)
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(EXAMPLE, encoding="utf-8")
    say(f"campaign: {file}", f"next: enter the recordings, then `fringedic campaign plan {folder}`")


@campaigns.command(epilog="Example: fringedic campaign plan batch-7")
def plan(folder: Folder, recompute: Recompute = False) -> None:
    """Read the summaries of the recordings and write the plan; refuse what is damaged."""
    from fringedic.campaign import load_campaign, update_plan
    from fringedic.campaign.sentences import plan_sentences

    made = update_plan(load_campaign(folder), recompute=recompute)
    say(*plan_sentences(made), f"next: `fringedic campaign run {folder}`")
    if made.refused:
        raise typer.Exit(1)


@campaigns.command(epilog="Example: fringedic campaign run batch-7 --workers 2")
def run(
    folder: Folder,
    workers: Workers = 1,
    engine: EngineChoice = None,
    scheduler: Scheduler = None,
    shard: Shard = "1/1",
    recompute: Recompute = False,
    follow: Annotated[
        bool, typer.Option("--follow", help="Process recordings that are being made, too, each step when it has ended.")
    ] = False,
) -> None:
    """Process all recordings that are not complete; after any interruption the command continues."""
    chosen = _engine(engine, workers, scheduler)
    _run(folder, chosen, _shard(shard), recompute=recompute, follow=follow)


@campaigns.command(epilog="Example: fringedic campaign retry batch-7")
def retry(
    folder: Folder,
    workers: Workers = 1,
    engine: EngineChoice = None,
    scheduler: Scheduler = None,
) -> None:
    """Plan again, and process the recordings that failed or were refused before."""
    from fringedic.campaign import CampaignStore, forget_failures, load_campaign, update_plan

    campaign = load_campaign(folder)
    update_plan(campaign)
    forget_failures(CampaignStore(campaign.store))
    _run(folder, _engine(engine, workers, scheduler), (1, 1))


@campaigns.command(epilog="Example: fringedic campaign status batch-7")
def status(
    folder: Folder,
    verify: Annotated[
        bool, typer.Option("--verify", help="Read all results, and compare their checksums with the receipts.")
    ] = False,
) -> None:
    """Say what is complete, failed and waiting, by the receipts in the store alone."""
    from fringedic.campaign import CampaignStore, read_plan, status_of
    from fringedic.campaign.run import damaged
    from fringedic.campaign.sentences import status_sentences, verification_sentences
    from fringedic.campaign.settings import store_address

    store = CampaignStore(store_address(folder))
    found = status_of(store, read_plan(store))
    say(*status_sentences(found))
    if verify:
        say(*verification_sentences(found, wrong := damaged(store, found)))
        if wrong:
            raise typer.Exit(1)
    _end(found)


@campaigns.command("open", epilog="Example: fringedic campaign open batch-7")
def open_results(
    folder: Folder,
    output: Annotated[Path | None, typer.Option(help="HTML file; by default campaign.html in the folder.")] = None,
) -> None:
    """Print the catalogue, write a page with a thumbnail of each recording and data-summary.json into the store."""
    from fringedic.campaign import CampaignStore, data_summary, open_campaign, read_plan, status_of
    from fringedic.campaign.page import write_campaign_page
    from fringedic.campaign.sentences import unplanned_sentences
    from fringedic.campaign.settings import store_address

    _, catalogue = open_campaign(folder)
    columns = ["specimen", "group", "steps", "reference_step", "confirmed_fraction"]
    columns += ["largest_strain", "sigma_largest_strain"]
    table = Table(title=f"{folder}: {len(catalogue)} recordings", title_justify="left")
    for heading in ("recording", *columns):
        table.add_column(heading.replace("_", " "))
    for name, row in catalogue.iterrows():
        table.add_row(str(name), *(_cell(row[column]) for column in columns))
    console.print(table)
    store = CampaignStore(store_address(folder))
    found = status_of(store, read_plan(store))
    say(*unplanned_sentences(found))
    page = write_campaign_page(store, found, output or folder / "campaign.html")
    store.write(data_summary.FILE, data_summary.data_summary(store, found))
    say(f"page: {page}", f'tree, catalogue = fringedic.open_campaign("{folder}")')


def _cell(value: object) -> str:
    return number_text(value) if isinstance(value, float) else str(value)


def _run(
    folder: Path, engine: Engine, shard: tuple[int, int], *, recompute: bool = False, follow: bool = False
) -> None:
    from fringedic.campaign import CampaignStore, current_plan, load_campaign, status_of, update_plan
    from fringedic.campaign.sentences import plan_sentences, status_sentences, unrecorded_sentences

    campaign = load_campaign(folder)
    store = CampaignStore(campaign.store)
    made = current_plan(campaign, recompute=recompute, follow=follow)
    say(*plan_sentences(made))
    unrecorded: list[Failure] = []  # of a store that can no longer be written: there they count as waiting
    while units := status_of(store, made).share(*shard):
        failures = _process(units, engine)
        waiting = {unit.name for unit in status_of(store, made).waiting}
        unrecorded = [failure for failure in failures if failure.name in waiting]
        if not follow or unrecorded:
            break
        made = update_plan(campaign, follow=True)  # recordings that were followed are complete, others have begun
    found = status_of(store, made)
    say(*status_sentences(found), *unrecorded_sentences(store.address, unrecorded))
    say(f"next: `fringedic campaign open {folder}`")
    _end(found, unrecorded)


def _process(units: list[Unit], engine: Engine) -> list[Failure]:
    """Process units, and return the failures of recordings."""
    from fringedic.campaign.receipts import Failure
    from fringedic.campaign.sentences import CampaignProgress

    outcome: Receipt | Failure
    parts = [part for unit in units if not unit.growing for part in unit.parts]
    first = sorted(units, key=lambda unit: not unit.growing)  # that are being made: their steps come now
    failures = []
    for batch in (parts, first) if parts else (first,):
        progress, started = CampaignProgress(batch), time.monotonic()
        for outcome in engine.outcomes(batch):
            say(progress.sentence(outcome, time.monotonic() - started))
        failures = [each for each in progress.finished if isinstance(each, Failure)]
    return failures


def _end(found: Status, unrecorded: Sequence[Failure] = ()) -> None:
    if found.failed or found.plan.refused or unrecorded:
        raise typer.Exit(1)


def _engine(name: EngineName | None, workers: int, scheduler: str | None) -> Engine:
    from fringedic.campaign import Dask, Processes, Serial

    if scheduler:
        if name not in (None, EngineName.DASK):
            raise ConfigurationError(f"--scheduler belongs to the engine dask, not to {name}; leave one of them out")
        if not scheduler.startswith("tls://"):
            say(f"warning: whoever reaches {scheduler} can run programs as its user; tls:// requires a certificate")
        return Dask(scheduler)
    if name is EngineName.DASK:
        raise ConfigurationError("the engine dask needs the --scheduler of a cluster; use processes on this computer")
    chosen = name or (EngineName.PROCESSES if workers > 1 else EngineName.SERIAL)
    if chosen is EngineName.PROCESSES:
        return Processes(workers)
    if workers > 1:
        raise ConfigurationError("the engine serial has one worker; leave --workers out or choose another engine")
    return Serial()


def _shard(text: str) -> tuple[int, int]:
    number, slash, count = text.partition("/")
    if not (slash and number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise CampaignError(f"--shard {text}: write I/N, for example 2/8 for the second of eight parts")
    return int(number), int(count)
