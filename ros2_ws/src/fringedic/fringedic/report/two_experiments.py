"""The page of a comparison of two experiments."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from fringedic.errors import DatasetError
from fringedic.figures.charts import comparison_charts
from fringedic.figures.maps import maps_figure
from fringedic.figures.panels import Panel
from fringedic.report.embedding import base64_png, chart_html, chart_script
from fringedic.report.templates import render_page, require_new, write_page
from fringedic.results.quantities import number_text, people_unit
from fringedic.results.two_experiments import compare_experiments, difference_maps, differing_attributes

COLUMNS = (
    "step",
    "quantity",
    "points",
    "mean of A",
    "mean of B",
    "RMS of B - A",
    "its uncertainty",
    "RMS over sigma",
    "within 2 sigma [%]",
)
DRAWN = ("u", "v", "w", "e_11", "e_22", "displacement_x", "displacement_y")
"""Maps that are drawn, as far as they are measured."""
_MOSTDRAWN = 4
_LONGEST = 80  # characters of an entry


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
    step = _last_compared(found)
    maps = difference_maps(one, other, step)
    drawn = [name for name in DRAWN if name in maps][:_MOSTDRAWN]
    page = render_page(
        "two_experiments.html.j2",
        titles=[experiment_title(each) for each in (one, other)],
        sentences=comparison_sentences(found),
        columns=COLUMNS,
        rows=[
            _row(found.sel(step=number, quantity=name), one[name])
            for number in found["step"].values
            for name in found["quantity"].values.tolist()
        ],
        differences=[(name, *map(entry_text, values)) for name, *values in differing_attributes(one, other)],
        shown=step,
        pictures={name: base64_png(maps_figure(maps, _panels(name), title=f"step {step}, {name}")) for name in drawn},
        charts=[chart_html(chart) for chart in comparison_charts(found, ("A", "B"))],
        script=chart_script(),
    )
    return write_page(page, output)


def comparison_sentences(found: xr.Dataset) -> list[str]:
    """Return one sentence for each quantity of the last compared step.

    Parameters
    ----------
    found
        From `compare_experiments`.
    """
    last = found.sel(step=_last_compared(found))
    return [
        f"{name}: {100 * float(each['within_2_sigma']):.1f} % of {int(each['points'])} points differ by less than "
        f"2 sigma (95 % expected of independent noise), RMS over sigma {float(each['normalized_rms']):.2f}"
        for name in last["quantity"].values.tolist()
        if int((each := last.sel(quantity=name))["points"])
    ]


def _last_compared(found: xr.Dataset) -> int:
    compared = found["step"].values[(found["points"].values > 0).any(axis=1)]
    if not compared.size:
        raise DatasetError("no point is measured in both experiments: their specimens are at other places in the image")
    return int(compared[-1])


def experiment_title(dataset: xr.Dataset) -> str:
    """Return the name of an experiment and its recording."""
    return f"{dataset.attrs.get('experiment', 'experiment')} ({dataset.attrs.get('source', 'no recording')})"


def _row(found: xr.Dataset, variable: xr.DataArray) -> list[str]:
    unit = people_unit(variable)
    lengths = (float(found[name]) / unit.factor for name in ("mean_one", "mean_other", "rms_difference", "rms_sigma"))
    share = 100 * float(found["within_2_sigma"])
    return [
        str(int(found["step"])),
        str(found["quantity"].item()),
        str(int(found["points"])),
        *(number_text(length) + (f" {unit.text}" if np.isfinite(length) else "") for length in lengths),
        number_text(float(found["normalized_rms"])),
        number_text(share),
    ]


def entry_text(value: object) -> str:
    """Return a setting as a text of limited length."""
    text = "-" if value is None else str(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."


def _panels(name: str) -> tuple[Panel, ...]:
    return (
        Panel(name, f"A: {name}"),
        Panel(f"other_{name}", f"B: {name}"),
        Panel(f"difference_{name}", "B minus A", symmetric=True),
        Panel(f"normalized_{name}", "difference over its uncertainty", symmetric=True),
    )
