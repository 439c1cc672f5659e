"""The page of a comparison of two experiments."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from fringedic.evaluation.sentences import NOT_IN_BOTH, comparison_sentences, last_compared
from fringedic.evaluation.two_experiments import compare_experiments, difference_maps, differing_attributes
from fringedic.figures.charts import comparison_charts
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
        "mean_one": "mean of A",
        "mean_other": "mean of B",
        "rms_difference": "RMS of B - A",
        "rms_sigma": "its uncertainty",
    },
    ratios={"normalized_rms": ("RMS over sigma", 1.0), "within_2_sigma": ("within 2 sigma [%]", 100.0)},
)


def write_comparison(one: xr.Dataset, other: xr.Dataset, output: Path, *, overwrite: bool = False) -> Path:
    """Write the page of two experiments: differences over their uncertainty, curves, and what differs in the settings.

    Parameters
    ----------
    one, other
        From `fringedic.open_experiment`.
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
    found = compare_experiments(one, other)
    return write_compared(
        "two_experiments.html.j2",
        output,
        found,
        difference_maps(one, other, last_compared(found, NOT_IN_BOTH)),
        _TABLE,
        _panels,
        titles=[experiment_title(each) for each in (one, other)],
        sentences=comparison_sentences(found),
        differences=[(name, *map(entry_text, values)) for name, *values in differing_attributes(one, other)],
        charts=[chart_html(chart) for chart in comparison_charts(found, ("A", "B"))],
    )


def _panels(name: str) -> tuple[Panel, ...]:
    return (
        Panel(name, f"A: {name}"),
        Panel(f"other_{name}", f"B: {name}"),
        Panel(f"difference_{name}", "B minus A", symmetric=True),
        Panel(f"normalized_{name}", "difference over its uncertainty", symmetric=True),
    )
