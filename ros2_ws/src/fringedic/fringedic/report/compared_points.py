"""What the pages of comparisons point by point share: the table and the maps."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fringedic.datasets.quantities import people_unit
from fringedic.figures.maps import maps_figure
from fringedic.figures.panels import Panel
from fringedic.report.templates import base64_png, chart_script, render_page, write_page
from fringedic.wording.numbers import number_text

_DRAWN = ("u", "v", "w", "e_11", "e_22", "displacement_x", "displacement_y")
_MOST_DRAWN = 4
_LONGEST = 80  # characters of an entry


class ComparedTable(NamedTuple):
    """Statistics in the table of a comparison, after step, quantity and points.

    Attributes
    ----------
    lengths
        Title of the column by the name of a statistic in the unit of its quantity.
    ratios
        Title of the column, and factor, by the name of a statistic without unit.
    """

    lengths: Mapping[str, str]
    ratios: Mapping[str, tuple[str, float]]

    @property
    def columns(self) -> list[str]:
        """Titles of all columns."""
        return ["step", "quantity", "points", *self.lengths.values(), *(title for title, _ in self.ratios.values())]

    def row(self, found: xr.Dataset, variable: xr.DataArray) -> list[str]:
        """Return the cells of one quantity, which `variable` gives its unit, at one step."""
        unit = people_unit(variable)
        lengths = (float(found[name]) / unit.factor for name in self.lengths)
        return [
            str(int(found["step"])),
            str(found["quantity"].item()),
            str(int(found["points"])),
            *(number_text(length) + (f" {unit.text}" if np.isfinite(length) else "") for length in lengths),
            *(number_text(factor * float(found[name])) for name, (_, factor) in self.ratios.items()),
        ]


def write_compared(
    template: str,
    output: Path,
    found: xr.Dataset,
    maps: xr.Dataset,
    table: ComparedTable,
    panels_of: Callable[[str], tuple[Panel, ...]],
    **content: Any,
) -> Path:
    """Write the page of a comparison.

    Parameters
    ----------
    template, output
        Of the page.
    found
        Statistics over (step, quantity).
    maps
        Of one step, with the quantities themselves, which give the units.
    table, panels_of
        What is shown of the statistics, and of the maps of a quantity.
    content
        What only this template names.
    """
    step = int(maps["step"])
    drawn = [name for name in _DRAWN if name in maps][:_MOST_DRAWN]
    page = render_page(
        template,
        columns=table.columns,
        rows=[
            table.row(found.sel(step=number, quantity=name), maps[name])
            for number in found["step"].values
            for name in found["quantity"].values.tolist()
        ],
        shown=step,
        pictures={name: base64_png(maps_figure(maps, panels_of(name), title=f"step {step}, {name}")) for name in drawn},
        script=chart_script(),
        **content,
    )
    return write_page(page, output)


def experiment_title(dataset: xr.Dataset) -> str:
    """Return the name of an experiment and its recording."""
    return f"{dataset.attrs.get('experiment', 'experiment')} ({dataset.attrs.get('source', 'no recording')})"


def entry_text(value: object) -> str:
    """Return a setting as a text of limited length."""
    text = "-" if value is None else str(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
