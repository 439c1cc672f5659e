"""The first page of an experiment's report: what was tested, the results in figures, verdicts, and fields to sign."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from fringedic.datasets.quantities import strain_measure_of, strain_unit
from fringedic.datasets.sentences import confirmation_sentence
from fringedic.datasets.signals import knows_sigma, sigma_name
from fringedic.errors import ConfigurationError, DatasetError
from fringedic.evaluation.elasticity import elastic_constants
from fringedic.evaluation.probes import surface_means
from fringedic.report.data import ReportData
from fringedic.report.entries import Entry
from fringedic.report.laboratory import LABORATORY, Laboratory, load_laboratory
from fringedic.signals import FORCE
from fringedic.surface.strain_measures import TENSORS
from fringedic.wording.numbers import counted, number_text, uncertain_text

_GIGA, _KILO = 1e9, 1e3
_STRAINS = (("e_11", "e_22"), ("e_xx", "e_yy"))
_DIRECTIONS = {"e_11": "right", "e_22": "up", "e_xx": "right", "e_yy": "up"}
_NEEDS = "needs a force, section_mm2 of the specimen, and a strain"


@dataclass(frozen=True)
class Certificate:
    """The content of the first page.

    Attributes
    ----------
    laboratory, logo
        Settings of the laboratory, and its logo as an address of a picture; "" without one.
    details
        What was tested, for whom.
    results
        Figures with their standard uncertainty.
    verdicts
        Calibration, checks and steps.
    """

    laboratory: Laboratory
    logo: str
    details: list[Entry]
    results: list[Entry]
    verdicts: list[Entry]


def open_laboratory(folder: Path, given: Path | None) -> tuple[Laboratory, str, list[str]]:
    """Return the settings of the laboratory, its logo, and a sentence about a file that cannot be used.

    Parameters
    ----------
    folder
        Of the run: its settings file, or that of the folder above, is used where none is given.
    given
        Settings file that a person chose.

    Raises
    ------
    ConfigurationError
        The file that a person chose cannot be used.
    """
    if given is not None:
        return *load_laboratory(given), []
    beside = folder.absolute()
    file = next((each for each in (beside / LABORATORY, beside.parent / LABORATORY) if each.is_file()), None)
    if file is None:
        return Laboratory(), "", []
    try:
        return *load_laboratory(file), []
    except ConfigurationError as error:  # the report of a test is written all the same
        return Laboratory(), "", [f"the settings of the laboratory are not used: {error}"]


def certificate(
    data: ReportData, laboratory: Laboratory, logo: str, gauges: Mapping[str, xr.Dataset], date: str
) -> Certificate:
    """Return the first page.

    Parameters
    ----------
    data
        The experiment.
    laboratory, logo
        Of `open_laboratory`.
    gauges
        Virtual extensometers by name.
    date
        When the experiment began; "" where it is not known.
    """
    specimen = data.metadata.specimen
    values = {name: getattr(specimen, name, "") for name in laboratory.details.values()}
    values |= {"experiment": str(data.dataset.attrs.get("experiment", "")), "date": date}
    details = [Entry(title, str(values[name]) or None) for title, name in laboratory.details.items()]
    return Certificate(laboratory, logo, details, _results(data, gauges), _verdicts(data))


def _results(data: ReportData, gauges: Mapping[str, xr.Dataset]) -> list[Entry]:
    dataset = data.dataset
    step = _step_of_interest(dataset)
    where = f"step {step}"
    entries = [_force(dataset, step)]
    for name, gauge in gauges.items():
        strain, sigma = (float(gauge[each].sel(step=step)) if each in gauge else np.nan for each in _GAUGE)
        entries.append(Entry(f"strain, extensometer {name.partition(':')[0]}", _strain_text(strain, sigma), where))
    entries += [
        Entry(f"mean strain {name} ({_DIRECTIONS[name]})", _strain_text(*means), f"{where}, all measured points")
        for name, means in _mean_strains(dataset.sel(step=step)).items()
    ]
    return [*entries, *_constants(data), _measure(data)]


_GAUGE = ("strain", "sigma_strain")


def _step_of_interest(dataset: xr.Dataset) -> int:
    """Return the step with the largest force of those that were measured; the last measured one without a force."""
    measured = np.array([not error for error in dataset["error"].values])
    usable = dataset["step"].values[measured if measured.any() else slice(None)]
    if FORCE.name in dataset:
        force = np.abs(dataset[FORCE.name].sel(step=usable).values.astype(float))
        if np.isfinite(force).any():
            return int(usable[np.nanargmax(force)])
    return int(usable[-1])


def _force(dataset: xr.Dataset, step: int) -> Entry:
    one = dataset.sel(step=step)
    if FORCE.name not in one or not np.isfinite(float(one[FORCE.name])):
        return Entry("maximum force", None, "no load cell was recorded")
    sigma = float(one[sigma_name(FORCE.name)]) if knows_sigma(dataset, FORCE.name) else np.nan
    force = float(one[FORCE.name])
    factor, unit = (_KILO, "kN") if abs(force) >= 10 * _KILO else (1.0, "N")
    return Entry("maximum force", f"{uncertain_text(force / factor, sigma / factor)} {unit}", f"step {step}")


def _strain_text(strain: float, sigma: float) -> str | None:
    if not np.isfinite(strain):
        return None
    unit = strain_unit(abs(strain))
    return f"{uncertain_text(strain / unit.factor, sigma / unit.factor)} {unit.text}"


def _mean_strains(step: xr.Dataset) -> dict[str, tuple[float, float]]:
    """Return mean and standard uncertainty of the strains of a step over all points."""
    names = next((names for names in _STRAINS if all(name in step for name in names)), ())
    means = surface_means(step, names)
    return {name: mean for name, mean in means.items() if np.isfinite(mean[0])}


def _constants(data: ReportData) -> list[Entry]:
    """Return modulus and Poisson's ratio, or why they are not defined."""
    titles = ("modulus of elasticity", "Poisson's ratio")
    if data.section is None or FORCE.name not in data.dataset or "e_11" not in data.dataset:
        return [Entry(titles[0], None, _NEEDS)]
    try:
        found = elastic_constants(data.dataset)
    except DatasetError as error:
        return [Entry(titles[0], None, str(error))]
    over = f"{counted(found.steps, 'step')}, stress over {found.axial}, all measured points"
    values = (
        (found.modulus / _GIGA, found.sigma_modulus / _GIGA, " GPa"),
        (found.poisson_ratio, found.sigma_poisson_ratio, ""),
    )
    return [
        Entry(title, f"{uncertain_text(value, sigma)}{unit}" if np.isfinite(value) else None, over)
        if np.isfinite(value)
        else Entry(title, None, found.reason or over)
        for title, (value, sigma, unit) in zip(titles, values, strict=True)
    ]


def _measure(data: ReportData) -> Entry:
    measure = TENSORS[strain_measure_of(data.dataset)]
    plane = "image" if data.images_alone else "tangent plane of the surface"
    return Entry("strain measure", f"{measure.title}, {measure.definition}", f"in the {plane}; shear is tensor shear")


def _verdicts(data: ReportData) -> list[Entry]:
    dataset = data.dataset
    whole = sum(not error for error in dataset["error"].values)
    entries = [Entry("steps measured", f"{whole} of {counted(dataset.sizes['step'], 'step')}")]
    if not data.images_alone:
        known = data.metadata.calibration
        identifier = str(data.calibration.get("identifier", "")) or None
        entries.append(Entry("calibration", known.verdict or identifier, known.created[:10]))
        check = known.checks[-1] if known.checks else None
        entries.append(
            Entry("check of the calibration", None, "none was made")
            if check is None
            else Entry("check of the calibration", check.verdict, check.created[:10])
        )
    entries.append(Entry("independent check", confirmation_sentence(dataset) or None))
    measured = dataset["valid_fraction"].values[dataset["valid_fraction"].values > 0]
    share = f"{number_text(100 * float(measured.min()), 3)} % or more of the points" if measured.size else None
    return [*entries, Entry("measured surface", share)]
