"""A step before and with the settings of an evaluation: figures and pictures."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from fringedic.datasets.quantities import people_unit
from fringedic.evaluation.named import compared_means
from fringedic.evaluation.step_maps import with_principal_strains
from fringedic.figures.maps import Scale, maps_figure, scale_between
from fringedic.figures.panels import panel_of
from fringedic.report.templates import write_errors_named
from fringedic.wording.numbers import number_text, uncertain_text

PREVIEW = "preview.json"
_SHOWN = ("e_22", "e_11", "w", "v", "displacement_y")  # maps of the pictures; of a step without a strain, others


@dataclass(frozen=True)
class ComparedRow:
    """Mean of a map over all points, with its standard uncertainty, before and with the settings."""

    quantity: str
    unit: str
    before: str
    after: str


def preview_rows(before: xr.Dataset, after: xr.Dataset) -> list[ComparedRow]:
    """Return one row for each map that both have, and the measured points."""
    points = [float(100 * each["valid_fraction"]) for each in (before, after)]
    rows = [ComparedRow("measured points", "%", *(number_text(each) for each in points))]
    for name, both in compared_means(before, after).items():
        unit = people_unit(before[name], max(abs(mean) for mean, _ in both))
        texts = (uncertain_text(mean / unit.factor, sigma / unit.factor) for mean, sigma in both)
        rows.append(ComparedRow(f"mean {name}", unit.text, *texts))
    return rows


def write_preview(before: xr.Dataset, after: xr.Dataset, folder: Path) -> None:
    """Write the pictures ``before.png`` and ``after.png`` of the same maps, and the rows as ``preview.json``.

    Raises
    ------
    DatasetError
        The folder cannot be written.
    """
    both = [with_principal_strains(each) for each in (before, after)]
    names = [name for name in _SHOWN if all(name in each and np.isfinite(each[name].values).any() for each in both)][:2]
    with write_errors_named(folder / PREVIEW):
        folder.mkdir(parents=True, exist_ok=True)
        panels, scales = tuple(map(panel_of, names)), {name: _common_scale(both, name) for name in names}
        for file, title, each in zip(("before", "after"), ("before", "with the settings"), both, strict=True):
            if names:
                figure = maps_figure(each, panels, title=f"step {int(each.step)}: {title}", scales=scales)
                figure.savefig(folder / f"{file}.png")
        rows = [asdict(row) for row in preview_rows(before, after)]
        (folder / PREVIEW).write_text(json.dumps({"rows": rows, "pictures": bool(names)}), "utf-8")


def _common_scale(both: Sequence[xr.Dataset], name: str) -> Scale:
    """Return one colour scale for a map before and with the settings."""
    ends = [np.nanpercentile(each[name].values, (0.5, 99.5)) for each in both]
    return scale_between(both[0][name], float(min(end[0] for end in ends)), float(max(end[1] for end in ends)))
