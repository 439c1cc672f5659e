"""Named evaluations of a run: listed, previewed and made."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fringedic.command.app import (
    RESULTS,
    Bag,
    ReferenceStep,
    Sensor,
    Settings,
    Why,
    app,
    console,
    named_gauges,
    next_reading,
    parameter_values,
    say,
)
from fringedic.command.progress import LiveProgress
from fringedic.errors import ConfigurationError, StepFailedError

if TYPE_CHECKING:
    from fringedic.evaluation.named import EvaluationSettings


@app.command(
    rich_help_panel=RESULTS,
    epilog="Example: fringedic evaluate recordings/plate-7 --name fine --set dic.window=24 --why 'small features'",
)
def evaluate(  # noqa: PLR0913 (options of a command)
    bag: Bag,
    name: Annotated[str | None, typer.Option(help="Name of the new evaluation; without one they are listed.")] = None,
    settings: Settings = None,
    reference: ReferenceStep = None,
    region: Annotated[
        Path | None, typer.Option(metavar="POLYGONS.yaml", help="Measured region, of `fringedic region`.")
    ] = None,
    extensometer: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=COLUMN,ROW,COLUMN,ROW", help="Virtual extensometers in place of the recorded ones."),
    ] = None,
    like: Annotated[
        Path | None,
        typer.Option(metavar="evaluation.yaml", help="Settings of another evaluation; other options replace them."),
    ] = None,
    preview: Annotated[
        int | None, typer.Option(metavar="STEP", help="Measure this step only, compare it, and keep nothing.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(help="With --preview: folder for pictures and figures (preview.json).")
    ] = None,
    sensor: Sensor = None,
    why: Why = "",
) -> None:
    """Process a run with other settings as a named evaluation beside its results, which stay as they are."""
    from fringedic.configuration.yaml_section import validate
    from fringedic.evaluation import named
    from fringedic.evidence.changes import because
    from fringedic.frames.region import Region

    changed = named.EvaluationSettings() if like is None else named.load_settings(like)
    given = validate(
        named.EvaluationSettings,
        {
            "overrides": {**changed.overrides, **parameter_values(settings)},
            "reference": changed.reference if reference is None else reference,
            "region": changed.region if region is None else Region.load(region).to_text(),
            "gauges": [
                {"name": each, "first": list(first), "second": list(second)}
                for each, (first, second) in named_gauges(extensometer).items()
            ]
            if extensometer
            else changed.gauges,
            "sensor": sensor or changed.sensor,
            "note": why or changed.note,
        },
        "evaluation",
    )
    if preview is not None:
        _preview(bag, given, preview, output)
    elif name is not None:
        with because(why):
            _make(bag, name, given)
    elif settings or reference is not None or region or extensometer or like or sensor:
        raise ConfigurationError("give a --name for the evaluation, or --preview STEP to look at one step first")
    else:
        found = named.evaluations(bag.parent)
        for each in found:
            words = json.dumps(each.settings.model_dump(exclude_defaults=True), ensure_ascii=False)
            say(f"{each.name}: {words}", f"  dataset: {each.dataset}")
        if not found:
            say(f"{bag.parent}: no evaluation beside the results of the run; --name NAME makes one")


def _make(bag: Path, name: str, settings: EvaluationSettings) -> None:
    from fringedic.evaluation.named import evaluate
    from fringedic.report import write_report

    errors = []
    with LiveProgress(console) as progress:
        progress.stage(f"evaluation {name}")

        def tell(step: int, error: str) -> None:
            errors.append(error)
            progress.note(f"step {step}: {error or 'measured'}")

        made = evaluate(bag, name, settings, tell)
    say(f"dataset: {made.dataset}", f"whole: {errors.count('')} of {len(errors)} steps")
    if "" not in errors:
        raise StepFailedError(f"no step was measured, the reasons are above and in {made.dataset}")
    say(f"report: {write_report(made.dataset, made.report)}", next_reading(made.dataset))


def _preview(bag: Path, settings: EvaluationSettings, step: int, output: Path | None) -> None:
    from fringedic.evaluation.named import preview
    from fringedic.report.previewed_evaluation import preview_rows, write_preview

    before, after = preview(bag, settings, step)
    if output is not None:
        write_preview(before, after, output)
    for row in preview_rows(before, after):
        say(f"{row.quantity} [{row.unit}]: {row.before} before, {row.after} with the settings")
