"""The report of an experiment: one HTML file."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fringedic.correlation import grey_residual
from fringedic.datasets.attributes import sensor_of
from fringedic.datasets.opening import open_experiment
from fringedic.datasets.quantities import largest_of, strain_measure_of, strain_unit
from fringedic.datasets.sentences import confirmation_sentence
from fringedic.datasets.stores import SUFFIXES
from fringedic.errors import CorrelationError, DatasetError, FringedicError, RecordingError
from fringedic.evaluation.named import SETTINGS, load_settings, run_of_evaluation
from fringedic.evaluation.noise_floor import check_static_steps, noise_floors
from fringedic.evaluation.noise_floor import static_steps as steps_at_rest
from fringedic.evaluation.probes import extensometer
from fringedic.evaluation.step_maps import with_principal_strains, with_stresses
from fringedic.evaluation.truth import TRUTH, open_truth, truth_errors
from fringedic.figures.animation import FRAME_MS, animation_frames
from fringedic.figures.charts import curve_charts, extensometer_charts, surface_chart
from fringedic.figures.maps import maps_figure, reference_figure
from fringedic.figures.panels import DISPLACEMENT, DISPLACEMENT_IN_IMAGE, ERRORS, FLAT_STRAIN, pictures_of
from fringedic.figures.residuals import residual_figure
from fringedic.figures.surface import surface_figure
from fringedic.frames.region import Point, Region
from fringedic.frames.sensor import JOINED, file_of
from fringedic.metadata import NOISE_COLUMNS
from fringedic.recording.bag_files import recording_of
from fringedic.recording.reader import BagReader
from fringedic.report.certificate import certificate, open_laboratory
from fringedic.report.data import ReportData, read_exposures, read_textures
from fringedic.report.entries import MISSING, Entry, hardware_entries, specimen_entries
from fringedic.report.laboratory import Laboratory
from fringedic.report.processing_entries import analysis_entries, changes_text, fringe_entries
from fringedic.report.tables import gauge_rows, noise_floor_row, region_rows, step_tables, truth_rows
from fringedic.report.templates import (
    base64_png,
    base64_text,
    chart_html,
    chart_script,
    render_page,
    require_new,
    write_errors_named,
    write_page,
)
from fringedic.report.warnings import warnings
from fringedic.rig_setup.advice import Advice
from fringedic.rig_setup.recommended_settings import advise_settings
from fringedic.sensors.sentences import overlap_sentence, registration_remarks, sensor_error_sentences
from fringedic.surface.strain_measures import TENSORS
from fringedic.wording.arguments import check_arguments, optional, path, several, whole

GAUGE_SUBSET = 21.0  # [px], side of the gauge subsets of virtual extensometers
GaugePoints = tuple[Point, Point]
"""The two points of a virtual extensometer, each (column, row) [px]."""


@dataclass(frozen=True)
class _Source:
    """The files of an experiment: the recording is None where only the dataset is there."""

    given: Path
    recording: Path | None

    @property
    def folder(self) -> Path:
        """The folder of the experiment."""
        return (self.recording or self.given).parent

    @property
    def evaluation(self) -> str | None:
        """The name of the evaluation that the dataset is, None if it is none."""
        return self.given.parent.name if run_of_evaluation(self.given.absolute().parent) is not None else None


@check_arguments(
    DatasetError, source=path, output=optional(path), static_steps=optional(several(whole())), laboratory=optional(path)
)
def write_report(
    source: str | os.PathLike[str],
    output: str | os.PathLike[str] | None = None,
    *,
    sensor: str | None = None,
    static_steps: Sequence[int] | None = None,
    gauges: Mapping[str, GaugePoints] | None = None,
    regions: Mapping[str, Region] | None = None,
    laboratory: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the report of an experiment as one HTML file, which needs no other file and no network.

    Parameters
    ----------
    source
        A recording or the folder of a run, whose dataset is opened or made as by `fringedic.open_experiment`; or a
        dataset, whose recording is looked for in the same folder.
    output
        The file; by default ``report.html`` beside the recording, with the name of a sensor that has one.
    sensor
        Name of the sensor, if there are several.
    static_steps
        Numbers of the steps at rest, from which the noise floor is taken, all with the same reference step, which does
        not count itself; by default the steps before and after the reference step at the same crosshead position.
    gauges
        Virtual extensometers by name, each the two positions (column, row) of its gauge points [px of the reference
        image]; by default those of the specimen's metadata.
    regions
        Regions by name, whose mean values the report lists.
    laboratory
        Settings file of the laboratory for the first page, see docs/results.md; by default ``laboratory.yaml`` in the
        folder of the recording or in the folder above, if there is one.
    overwrite
        Replace an existing file.

    Returns
    -------
    Path
        The report.

    Raises
    ------
    DatasetError
        The file exists already or cannot be written, the dataset lacks variables that a report needs, a step at
        rest does not exist, was not measured or has another reference, or no step was measured.
    RecordingError
        As of `fringedic.open_experiment`.
    ConfigurationError
        The settings file of the laboratory, or its logo, cannot be used.
    FringedicError
        A package of the extra ``report`` is not installed.

    Examples
    --------
    >>> write_report("recordings/plate-7/bag", gauges={"middle": ((200, 480), (1000, 480))})  # doctest: +SKIP
    PosixPath('recordings/plate-7/report.html')
    """
    with open_experiment(source, sensor=sensor) as dataset:
        _require_whole(source, dataset)
        place = recording_of(Path(source))
        if place.is_dir() and place.suffix not in SUFFIXES and "image" in dataset:
            place = Path(dataset.encoding["source"])  # the folder of measured images has no recording
        files = _Source(place, _recording(place, dataset))
        beside = files.folder if files.evaluation is None else files.given.parent
        target = file_of(beside / "report.html", sensor_of(dataset)) if output is None else Path(output)
        require_new(target, overwrite)
        with write_errors_named(target):
            target.parent.mkdir(parents=True, exist_ok=True)
        static = steps_at_rest(dataset) if static_steps is None else check_static_steps(dataset, static_steps)
        letterhead = open_laboratory(files.folder, None if laboratory is None else Path(laboratory))
        content = _content(dataset, files, static, gauges, regions or {}, letterhead)
        page = render_page("experiment.html.j2", **content)
    return write_page(page, target)


def _require_whole(source: str | os.PathLike[str], dataset: xr.Dataset) -> None:
    """Refuse a dataset from which a person has taken variables that a report needs."""
    needed = {"reference_step", "valid_fraction", "rms_displacement"}
    needed |= {"position"} if "force" in dataset else set()
    needed |= {"displacement_x", "displacement_y"} if "texture" in dataset else set()
    present = set(map(str, dataset.variables))
    needed |= set("xyzuv") if "w" in present else set()
    lacking = sorted(needed - present)
    if lacking:
        raise DatasetError(
            f"{source}: has no {' and no '.join(lacking)}, which a report needs; give the whole dataset, or process "
            "its recording again"
        )


def _recording(source: Path, dataset: xr.Dataset) -> Path | None:
    if source.suffix not in SUFFIXES:
        return source
    name = dataset.attrs.get("source")  # compared with the names there: of another person, it may be any text
    folder = run_of_evaluation(source.absolute().parent) or source.parent
    return next((each for each in folder.iterdir() if each.name == name and each != source), None)


def _content(
    dataset: xr.Dataset,
    files: _Source,
    static: list[int],
    gauges: Mapping[str, GaugePoints] | None,
    regions: Mapping[str, Region],
    letterhead: tuple[Laboratory, str, list[str]],
) -> dict[str, Any]:
    """Return the values of the template."""
    laboratory, logo, unused = letterhead
    date = _date(dataset)
    floors = noise_floors(dataset, static)
    recording, unreadable = _open_recording(files.recording, sensor_of(dataset))
    exposures = None if recording is None else read_exposures(recording, str(dataset.attrs["experiment"]))
    data = ReportData(dataset, exposures, _advice(dataset, recording, static))
    points = _entered_gauges(data) if gauges is None else gauges
    strains, failed = _extensometers(dataset, points)
    truth, unread = _truth(dataset, files.folder / TRUTH)
    return {
        "title": str(dataset.attrs.get("experiment", "experiment")),
        "date": date,
        "evaluation": _evaluation(files),
        "certificate": certificate(data, laboratory, logo, strains, date),
        "written": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "simulated": data.simulated,
        "confirmation": confirmation_sentence(dataset),
        "overlap": overlap_sentence(dataset),
        "warnings": warnings(data, static, floors)
        + registration_remarks(dataset)
        + sensor_error_sentences(dataset)
        + failed
        + unread
        + unreadable
        + unused,
        "static_steps": static,
        "floors": [noise_floor_row(floor) for floor in floors],
        "noise": data.metadata.noise,
        "noise_columns": NOISE_COLUMNS,
        "images_alone": data.images_alone,
        "step_tables": step_tables(dataset),
        "strain_words": _strain_words(data),
        "regions": region_rows(dataset.sel(step=_last_measured(dataset)), regions),
        "truth": truth,
        "error_maps": _error_maps(dataset, files.folder / TRUTH),
        "parameters": json.dumps(data.attribute("parameters"), indent=1),
        "calibration": json.dumps(data.calibration, indent=1),
        **_conditions(data),
        **_pictures(data, points),
        **_gauge_content(data, strains),
    }


def _open_recording(place: Path | None, sensor: str) -> tuple[BagReader | None, list[str]]:
    """Open the recording beside a dataset, or tell why the page goes without: its results do not depend on it."""
    if place is None or sensor == JOINED:  # exposures are those of each sensor, in its own report
        return None, []
    try:
        return BagReader(place, sensor=sensor), []
    except RecordingError as error:
        return None, [f"Conditions of the exposures are not listed, the recording cannot be read: {error}."]


def _truth(dataset: xr.Dataset, file: Path) -> tuple[list[list[str]], list[str]]:
    """Return the rows of the comparison with the ground truth, and why there are none although there is a truth."""
    try:
        return truth_rows(dataset, file), []
    except DatasetError as error:
        return [], [f"No comparison with the ground truth: {error}."]


def _conditions(data: ReportData) -> dict[str, Any]:
    sections = {
        "Specimen": specimen_entries(data),
        "Hardware": hardware_entries(data),
        "Analysis": analysis_entries(data),
    }
    if not data.images_alone:
        sections["Fringes"] = fringe_entries(data)
    missing: list[tuple[str, Entry]] = [
        (name, entry) for name, entries in sections.items() for entry in entries if entry.value is None
    ]
    return {"sections": sections, "missing": missing, "missing_word": MISSING}


def _pictures(data: ReportData, gauges: Mapping[str, GaugePoints]) -> dict[str, Any]:
    shown = _last_measured(data.dataset)
    last = with_principal_strains(data.dataset.sel(step=shown))
    modulus, ratio = data.metadata.specimen.youngs_modulus_gpa, data.metadata.specimen.poisson_ratio
    if modulus is not None and ratio is not None:
        last = with_stresses(last, 1e9 * modulus, ratio)
    surface = "w" in last and bool(np.isfinite(last["w"].values).any())
    return {
        "shown": shown,
        "stress": "s_1" in last,
        "reference": _reference(data.dataset, last, gauges),
        "maps": [base64_png(maps_figure(last, panels, title=f"step {shown}")) for panels in pictures_of(last).values()],
        "residual": _residual(data.dataset, last),
        "animation": _animation(data.dataset),
        "frame_ms": FRAME_MS,
        "surface": chart_html(surface_chart(last)) if surface else "",
        "surface_picture": base64_png(surface_figure(last)) if surface else "",
        "curves": [chart_html(chart) for chart in curve_charts(data.dataset, data.section)],
        "plotly": chart_script(),
    }


def _evaluation(files: _Source) -> str:
    """Return the name of an evaluation and what it changes; empty for the results of the run."""
    settings = files.given.parent / SETTINGS
    if files.evaluation is None or not settings.is_file():
        return ""
    return f"{files.evaluation}: {changes_text(load_settings(settings)) or 'nothing is changed'}"


def _strain_words(data: ReportData) -> str:
    """Return which strain is shown."""
    measure = TENSORS[strain_measure_of(data.dataset)]
    plane = "image" if data.images_alone else "tangent plane of the surface"
    return f"{measure.title}, {measure.definition}, in the {plane}; shear is the tensor shear, half the engineering one"


def _gauge_content(data: ReportData, strains: Mapping[str, xr.Dataset]) -> dict[str, Any]:
    charts = extensometer_charts(data.dataset, strains, data.section)
    unit = strain_unit(largest_of(each["strain"].values for each in strains.values()))
    return {
        "gauges": [chart_html(chart) for chart in charts],
        "gauge_rows": gauge_rows(strains, unit),
        "gauge_unit": unit.text,
        "gauge_subset": GAUGE_SUBSET,
    }


def _entered_gauges(data: ReportData) -> dict[str, GaugePoints]:
    return {
        gauge.name or str(number): ((gauge.first[0], gauge.first[1]), (gauge.second[0], gauge.second[1]))
        for number, gauge in enumerate(data.metadata.specimen.gauges_px, start=1)
    }


def _extensometers(dataset: xr.Dataset, gauges: Mapping[str, GaugePoints]) -> tuple[dict[str, xr.Dataset], list[str]]:
    """Return the virtual extensometers by name, and a sentence about each that cannot be measured."""
    strains, failed = {}, []
    for title, (first, second) in gauges.items():
        name = f"{title}: ({first[0]:g}, {first[1]:g}) to ({second[0]:g}, {second[1]:g})"
        try:
            strains[name] = extensometer(dataset, first, second, subset=GAUGE_SUBSET)
        except DatasetError as error:
            failed.append(f"extensometer {name} px: {error}")
    return strains, failed


def _advice(dataset: xr.Dataset, recording: BagReader | None, static: Sequence[int]) -> Advice | None:
    """Return the figures of the textures at rest; None without two of them and their reference, or a usable texture."""
    if recording is None or len(static) < 2:
        return None
    reference = int(dataset["reference_step"].sel(step=static[0]))
    if reference not in dataset["step"].values:
        return None
    numbers = [reference, *static[:2]]
    stamps = dataset["time"].sel(step=numbers).values.astype("datetime64[ns]").astype(np.int64)
    textures = read_textures(recording, [int(stamp) for stamp in stamps])
    if not textures:
        return None
    try:
        return advise_settings(*textures)
    except FringedicError:
        return None


def _last_measured(dataset: xr.Dataset) -> int:
    for name in (name for name in ("w", "displacement_x") if name in dataset):
        for index in reversed(range(dataset.sizes["step"])):
            if np.isfinite(dataset[name].isel(step=index).values).any():
                return int(dataset["step"].values[index])
    raise DatasetError("no step of the experiment was measured")


def _date(dataset: xr.Dataset) -> str:
    """Return when the experiment began; empty for images, whose times are not known."""
    if "time" not in dataset:
        return ""
    return f"{np.datetime_as_string(dataset['time'].values.min(), unit='s')} UTC".replace("T", " ", 1)


def _reference(dataset: xr.Dataset, measured: xr.Dataset, gauges: Mapping[str, GaugePoints]) -> str:
    """Return the picture of the reference image; empty where it is not in the dataset."""
    step = int(measured.get("reference_step", -1))
    if "texture" not in dataset or step not in dataset["step"].values:
        return ""
    reference = dataset.sel(step=step)
    if not np.isfinite(reference["texture"].values).any():
        return ""
    return base64_png(reference_figure(reference, measured, gauges))


def _residual(dataset: xr.Dataset, measured: xr.Dataset) -> str:
    """Return the picture of the grey-level residual; empty where the images are not known at every pixel."""
    step = int(measured.get("reference_step", -1))
    if "texture" not in dataset or step not in dataset["step"].values:
        return ""
    reference = dataset.sel(step=step)["texture"].values
    if "grey_residual" not in measured:
        if not np.all(np.diff(dataset["column"].values) == 1):
            return ""
        moved = measured["displacement_x"].values, measured["displacement_y"].values
        try:
            residual = grey_residual(reference, measured["texture"].values, *moved)
        except CorrelationError:
            return ""  # of a step without a texture
        measured = measured.assign(grey_residual=(("row", "column"), residual, {"units": "grey level"}))
    return base64_png(residual_figure(measured, float(np.nanstd(reference))))


def _animation(dataset: xr.Dataset) -> list[str]:
    """Return a map over the steps as pictures; none when no step has one."""
    for panel in (DISPLACEMENT[-1], FLAT_STRAIN[1], DISPLACEMENT_IN_IMAGE[-1]):
        try:
            return [base64_text(frame) for frame in animation_frames(dataset, panel)]
        except DatasetError:
            continue
    return []


def _error_maps(dataset: xr.Dataset, file: Path) -> str:
    """Return the maps of the errors of the last step against the truth of a virtual rig; empty without one."""
    if not file.exists():
        return ""
    step = _last_measured(dataset)
    try:
        with open_truth(file) as truth:
            errors = truth_errors(dataset, truth, step)
            return base64_png(maps_figure(errors, ERRORS, title=f"step {step}: measured minus true"))
    except DatasetError:
        return ""  # the warnings say why
