"""The page of a comparison of two experiments."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from fringedic.evaluation.two_experiments import compare_experiments, difference_maps, differing_attributes
from fringedic.figures.charts import comparison_charts
from fringedic.figures.panels import Panel
from fringedic.report.compared_points import (
    ComparedTable,
    entry_text,
    experiment_title,
    last_compared,
    reference_sentences,
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
_NOWHERE = "no point is measured in both experiments: their specimens are at other places in the image"


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
        difference_maps(one, other, last_compared(found, _NOWHERE)),
        _TABLE,
        _panels,
        titles=[experiment_title(each) for each in (one, other)],
        sentences=comparison_sentences(found),
        differences=[(name, *map(entry_text, values)) for name, *values in differing_attributes(one, other)],
        charts=[chart_html(chart) for chart in comparison_charts(found, ("A", "B"))],
    )


def comparison_sentences(found: xr.Dataset) -> list[str]:
    """Return one sentence for each quantity of the last compared step, before them one on different reference steps.

    Parameters
    ----------
    found
        From `compare_experiments`.
    """
    last = found.sel(step=last_compared(found, _NOWHERE))
    return reference_sentences(found) + [
        f"{name}: {100 * float(each['within_2_sigma']):.1f} % of {int(each['points'])} points differ by less than "
        f"2 sigma (95 % expected of independent noise), RMS over sigma {float(each['normalized_rms']):.2f}"
        for name in last["quantity"].values.tolist()
        if int((each := last.sel(quantity=name))["points"])
    ]


def _panels(name: str) -> tuple[Panel, ...]:
    return (
        Panel(name, f"A: {name}"),
        Panel(f"other_{name}", f"B: {name}"),
        Panel(f"difference_{name}", "B minus A", symmetric=True),
        Panel(f"normalized_{name}", "difference over its uncertainty", symmetric=True),
    )
