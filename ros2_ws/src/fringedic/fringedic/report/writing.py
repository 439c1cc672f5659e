"""Putting a report together."""

from __future__ import annotations

import base64
import io
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import plotly.io
import xarray as xr
from matplotlib.figure import Figure
from plotly.offline import get_plotlyjs

from fringedic.advice import Advice, advise_settings
from fringedic.errors import DatasetError, FringedicError, ProbeError
from fringedic.facts import NOISE_COLUMNS
from fringedic.pictures import Panel, maps_figure
from fringedic.probes import extensometer
from fringedic.provenance import git_commit, software
from fringedic.report import charts, checks, items, recorded, static
from fringedic.report.animation import animation
from fringedic.results import compare_with_truth, open_experiment
from fringedic.results.stores import SUFFIXES

MILLI, MICRO = 1e-3, 1e-6
TRUTH = "truth.nc"
PAD = 21.0  # [px], side of the pads of virtual extensometers
SHAPE_PANELS = (
    Panel("shape_z", "height z", "mm", MILLI, symmetric=False),
    Panel("u", "displacement u along x", "mm", MILLI, symmetric=False),
    Panel("v", "displacement v along y", "mm", MILLI, symmetric=False),
    Panel("w", "displacement w along z", "mm", MILLI, symmetric=False),
)
STRAIN_PANELS = (
    Panel("e_11", "strain e_11 along t1", "µstrain", MICRO, symmetric=False),
    Panel("e_22", "strain e_22 along t2", "µstrain", MICRO, symmetric=False),
    Panel("e_12", "shear strain e_12 (tensor)", "µstrain", MICRO, symmetric=False),
)
IN_PLANE_PANELS = (
    Panel("displacement_x", "displacement along columns", "px", 1.0, symmetric=False),
    Panel("displacement_y", "displacement along rows, downwards", "px", 1.0, symmetric=False),
)
_UNITS = {
    "displacement_x": ("px", 1.0),
    "displacement_y": ("px", 1.0),
    **dict.fromkeys(("u", "v", "w"), ("µm", MICRO)),
    **dict.fromkeys(("e_11", "e_22", "e_12"), ("µstrain", MICRO)),
}


def write_report(
    source: str | os.PathLike[str],
    output: str | os.PathLike[str] | None = None,
    *,
    static_steps: Sequence[int] | None = None,
    extensometers: Sequence[Sequence[float]] | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the report of an experiment as one HTML file that needs nothing else, no network either.

    Parameters
    ----------
    source
        A recording, whose dataset is opened or made as by `fringedic.open_experiment`; or a dataset, beside which its
        recording is looked for.
    output
        The file; by default ``report.html`` beside the recording.
    static_steps
        Steps at rest, from which the noise floor is taken; by default those before and behind the reference step at the
        same crosshead position.
    extensometers
        Virtual extensometers, each (row, column, row, column) of its two pads [px of the reference image]; by default
        those of the specimen's facts.
    overwrite
        Replace an existing file.

    Returns
    -------
    Path
        The report.

    Raises
    ------
    DatasetError
        The file exists already or cannot be written, a static step does not exist, or no step was measured.
    MissingTopicError, RecordingError
        As `fringedic.open_experiment`.
    """
    source = Path(source)
    with open_experiment(source) as dataset:
        recording = _recording(source, dataset)
        target = Path(output) if output is not None else (recording or source).with_name("report.html")
        if target.exists() and not overwrite:
            raise DatasetError(f"{target} exists already; choose another --output or ask to overwrite it")
        with _naming_what_cannot_be_written(target):
            target.parent.mkdir(parents=True, exist_ok=True)
        page = _page(dataset, recording, source, static_steps, extensometers)
    with _naming_what_cannot_be_written(target):
        temporary = target.with_name(f".{target.name}.writing")
        temporary.write_text(page, encoding="utf-8")
        temporary.replace(target)
    return target


@contextmanager
def _naming_what_cannot_be_written(target: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise DatasetError(f"{target}: cannot be written: {error.strerror}") from error


def _recording(source: Path, dataset: xr.Dataset) -> Path | None:
    if source.suffix not in SUFFIXES:
        return source
    beside = source.with_name(str(dataset.attrs.get("source", "")) or "none")
    return beside if beside.exists() and beside != source else None


def _page(
    dataset: xr.Dataset,
    recording: Path | None,
    source: Path,
    chosen: Sequence[int] | None,
    extensometers: Sequence[Sequence[float]] | None,
) -> str:
    steps = static.static_steps(dataset) if chosen is None else list(chosen)
    floors = static.noise_floors(dataset, steps)
    exposures = None if recording is None else recorded.read_exposures(recording, str(dataset.attrs["experiment"]))
    known = items.Known(dataset, exposures, _advice(dataset, recording, steps))
    sections = {
        "Specimen": items.specimen_items(known),
        "Hardware": items.hardware_items(known),
        "Analysis": items.analysis_items(known),
        "Fringes": items.fringe_items(known),
    }
    square_millimetres = known.specimen.get("section_mm2")
    section = None if square_millimetres is None else 1e-6 * square_millimetres
    places = known.specimen.get("extensometers_px", []) if extensometers is None else extensometers
    gauges, lost = _gauges(dataset, places)
    shown = _last_measured(dataset)
    last = dataset.sel(step=shown)
    surface = np.isfinite(last["w"].values).any()
    folder = (recording or source).parent
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("fringedic.report", "."), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template("page.html.j2").render(
        title=str(dataset.attrs.get("experiment", "experiment")),
        date=_date(dataset),
        written=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        software=f"{software()}, commit {git_commit()}",
        simulated=known.simulated,
        warnings=checks.warnings(known, steps, floors) + lost,
        missing=[(name, item) for name, listed in sections.items() for item in listed if item.value is None],
        missing_word=items.MISSING,
        sections=sections,
        static_steps=steps,
        floors=[_floor_cells(floor) for floor in floors],
        noise=known.noise,
        noise_columns=NOISE_COLUMNS,
        steps=_step_rows(dataset),
        truth=_truth_rows(dataset, folder / TRUTH),
        shown=shown,
        maps=_maps(last, surface),
        animation=_animation(dataset),
        surface=_chart(charts.surface_chart(last)) if surface else "",
        curves=[_chart(figure) for figure in charts.curve_charts(dataset, section)],
        gauges=[_chart(figure) for figure in charts.extensometer_charts(dataset, gauges, section)],
        gauge_rows=_gauge_rows(gauges),
        pad=PAD,
        parameters=json.dumps(known.attribute("parameters"), indent=1),
        calibration=json.dumps(known.attribute("calibration"), indent=1),
        plotly=get_plotlyjs(),
    )


def _gauges(dataset: xr.Dataset, places: Sequence[Sequence[float]]) -> tuple[dict[str, xr.Dataset], list[str]]:
    """Return the virtual extensometers by name, and a sentence about each that has nothing to hold on."""
    gauges, lost = {}, []
    for number, (top, left, bottom, right) in enumerate(places, start=1):
        name = f"{number}: ({top:g}, {left:g}) to ({bottom:g}, {right:g})"
        try:
            gauges[name] = extensometer(dataset, (top, left), (bottom, right), pad=PAD)
        except ProbeError as error:
            lost.append(f"extensometer {name} px: {error}")
    return gauges, lost


def _gauge_rows(gauges: dict[str, xr.Dataset]) -> list[list[str]]:
    """Return a line per extensometer about its last measured step."""
    rows = []
    for name, gauge in gauges.items():
        measured = np.flatnonzero(np.isfinite(gauge["strain"].values))
        if not measured.size:
            rows.append([name, *["-"] * 4])
            continue
        last = gauge.isel(step=int(measured[-1]))
        strain, sigma = float(last["strain"]), float(last.get("sigma_strain", np.nan))
        length = float(last["length"] - last["elongation"])
        figures = (length / MILLI, float(last["elongation"]) / MICRO, strain / MICRO, sigma / MICRO)
        rows.append([name, *(_figure(each) for each in figures)])
    return rows


def _advice(dataset: xr.Dataset, recording: Path | None, steps: Sequence[int]) -> Advice | None:
    """Return what the textures at rest tell; None without two of them, or when they show no usable texture."""
    if recording is None or len(steps) < 2:
        return None
    references = dataset["reference_step"].sel(step=list(steps)).values
    numbers = [int(references[0]), *steps[:2]]
    stamps = dataset["time"].sel(step=numbers).values.astype("datetime64[ns]").astype(np.int64)
    textures = recorded.read_textures(recording, [int(stamp) for stamp in stamps])
    if not textures:
        return None
    try:
        return advise_settings(*textures)
    except FringedicError:
        return None


def _last_measured(dataset: xr.Dataset) -> int:
    for name in ("w", "displacement_x"):
        for index in reversed(range(dataset.sizes["step"])):
            if np.isfinite(dataset[name].isel(step=index).values).any():
                return int(dataset["step"].values[index])
    raise DatasetError("no step of the experiment was measured")


def _date(dataset: xr.Dataset) -> str:
    return f"{np.datetime_as_string(dataset['time'].values.min(), unit='s')} UTC".replace("T", " ", 1)


def _floor_cells(floor: static.NoiseFloor) -> list[str]:
    unit, factor = _UNITS[floor.name]
    values = (floor.spatial, floor.temporal, floor.bias, floor.predicted)
    return [f"{floor.name} [{unit}]", *(_figure(value / factor) for value in values), str(floor.points)]


def _step_rows(dataset: xr.Dataset) -> list[list[str]]:
    begin = dataset["time"].values.min()
    rows = []
    for index, number in enumerate(dataset["step"].values):
        step = {name: float(dataset[name].values[index]) for name in ("force", "position", "valid_fraction")}
        seconds = (dataset["time"].values[index] - begin) / np.timedelta64(1, "s")
        rows.append(
            [
                str(int(number)),
                f"{seconds:.1f}",
                _figure(step["force"]),
                _figure(step["position"] / MILLI),
                *(_step_number(dataset, name, index) for name in ("reference_step", "correlated_step")),
                _figure(100 * step["valid_fraction"]),
                _figure(float(dataset["rms_displacement"].values[index]) / MICRO),
                str(dataset["error"].values[index]),
            ]
        )
    return rows


def _step_number(dataset: xr.Dataset, name: str, index: int) -> str:
    number = int(dataset[name].values[index]) if name in dataset else -1
    return str(number) if number >= 0 else "-"


def _truth_rows(dataset: xr.Dataset, file: Path) -> list[list[str]]:
    """Return the errors against the truth that a virtual rig left beside the recording."""
    if not file.exists():
        return []
    try:
        errors = compare_with_truth(dataset, file)
    except DatasetError:
        return []
    names = [f"error_{name}" for name in "uvwz"]
    return [
        [str(int(step)), *(_figure(float(errors[name].sel(step=step))) for name in names)]
        for step in errors["step"].values
    ]


def _maps(step: xr.Dataset, surface: bool) -> list[str]:
    groups: list[tuple[Panel, ...]] = [SHAPE_PANELS, STRAIN_PANELS] if surface else [IN_PLANE_PANELS]
    pictures = []
    for panels in groups:
        if all(panel.name in step and np.isfinite(step[panel.name].values).any() for panel in panels):
            pictures.append(_png(maps_figure(step, panels, title=f"step {int(step.step)}")))
    return pictures


def _animation(dataset: xr.Dataset) -> str:
    for panel in (SHAPE_PANELS[3], IN_PLANE_PANELS[1]):
        try:
            return base64.b64encode(animation(dataset, panel)).decode()
        except DatasetError:
            continue
    return ""


def _png(figure: Figure) -> str:
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return base64.b64encode(stream.getvalue()).decode()


def _chart(figure: Any) -> str:
    return str(
        plotly.io.to_html(
            figure, include_plotlyjs=False, full_html=False, config={"displaylogo": False, "responsive": True}
        )
    )


def _figure(value: float) -> str:
    if not np.isfinite(value):
        return "-"
    return f"{value:.0f}" if abs(value) >= 1e4 else f"{value:.4g}"
