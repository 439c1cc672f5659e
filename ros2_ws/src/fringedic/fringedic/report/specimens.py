"""The page of a comparison of several specimens."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import xarray as xr

from fringedic.evaluation.elasticity import elastic_constants, strain_curve
from fringedic.evaluation.sentences import NOT_OF_ALL, last_compared, specimen_sentences
from fringedic.evaluation.specimens import compare_specimens, specimen_maps
from fringedic.evaluation.two_experiments import differing_attributes
from fringedic.figures.charts import SpecimenCurve, interrupt, reference_changes, specimen_charts
from fringedic.figures.panels import Panel
from fringedic.report.compared_points import (
    ComparedTable,
    entry_text,
    experiment_title,
    write_compared,
)
from fringedic.report.templates import chart_html, require_new

_TABLE = ComparedTable(
    lengths={
        "mean": "mean",
        "spread_of_means": "spread of means",
        "spread": "spread at a point",
        "uncertainty": "uncertainty of one",
    },
    ratios={"spread_over_uncertainty": ("spread over uncertainty", 1.0)},
)
_OF_EACH = ("experiment", "source")  # attributes that differ between specimens anyway


def write_specimens(experiments: Mapping[str, xr.Dataset], output: Path, *, overwrite: bool = False) -> Path:
    """Write the page of several specimens: mean, spread between them beside the measurement uncertainty, and curves.

    Parameters
    ----------
    experiments
        By the names of the specimens, from `fringedic.open_experiment`.
    output
        HTML file.
    overwrite
        Replace an existing file.

    Raises
    ------
    DatasetError
        The file exists or cannot be written, or the experiments have nothing in common.
    FringedicError
        A package of the extra ``report`` is not installed.
    """
    require_new(output, overwrite)
    group = list(experiments.values())
    found = compare_specimens(group)
    values: dict[str, list[str]] = {}
    for other in group[1:]:
        for name, one, another in differing_attributes(group[0], other):
            if name not in _OF_EACH:
                known = values.setdefault(name, [entry_text(one)])
                known += [text for text in [entry_text(another)] if text not in known]
    return write_compared(
        "specimens.html.j2",
        output,
        found,
        specimen_maps(group, last_compared(found, NOT_OF_ALL)),
        _TABLE,
        _panels,
        titles={name: experiment_title(each) for name, each in experiments.items()},
        sentences=specimen_sentences(found),
        differences=[(name, "; ".join(texts)) for name, texts in values.items()],
        charts=[chart_html(chart) for chart in specimen_charts("Load over strain", _curves(experiments))],
    )


def specimen_curve(curve: Mapping[str, np.ndarray], axial: str) -> SpecimenCurve:
    """Return stress, or force, over axial strain, interrupted where the reference step changes.

    Parameters
    ----------
    curve
        Values of `fringedic.evaluation.strain_curve` by their names.
    axial
        Name of the strain along the load.
    """
    label, load = ("stress [MPa]", curve["stress"] / 1e6) if "stress" in curve else ("force [N]", curve["force"])
    strain, sigma = curve[axial], curve[f"sigma_{axial}"]
    if "reference_step" in curve:
        breaks = reference_changes(curve["reference_step"])
        strain, sigma, load = (interrupt(values, breaks) for values in (strain, sigma, load))
    return SpecimenCurve(strain, sigma, load, label)


def _curves(experiments: Mapping[str, xr.Dataset]) -> dict[str, SpecimenCurve]:
    """Return the curves of the specimens whose strain and force are known."""
    curves = {}
    for name, dataset in experiments.items():
        if {"e_11", "e_22", "force"} <= set(dataset.data_vars):
            curve = strain_curve(dataset)
            values = {str(key): each.values for key, each in curve.data_vars.items()}
            curves[name] = specimen_curve(values, elastic_constants(dataset).axial)
    return curves


def _panels(name: str) -> tuple[Panel, ...]:
    return (
        Panel(name, f"mean of the specimens: {name}"),
        Panel(f"spread_{name}", "standard deviation between them"),
        Panel(f"uncertainty_{name}", "uncertainty of one measurement"),
        Panel(f"ratio_{name}", "spread over uncertainty"),
    )
