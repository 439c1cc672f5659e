"""The page of a campaign: one HTML file with a thumbnail and the figures of each recording."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fringedic.campaign.groups import GroupStatistic, group_statistics
from fringedic.campaign.opening import open_group
from fringedic.campaign.receipts import Receipt
from fringedic.campaign.run import Status
from fringedic.campaign.sentences import status_sentences
from fringedic.campaign.store import CampaignStore
from fringedic.datasets.quantities import people_unit
from fringedic.errors import CampaignError
from fringedic.figures.charts import SpecimenCurve, specimen_charts
from fringedic.figures.thumbnails import thumbnail_png
from fringedic.report.specimens import specimen_curve
from fringedic.report.templates import base64_text, chart_html, chart_script, render_page
from fringedic.wording.causes import cause_of
from fringedic.wording.numbers import number_text

if TYPE_CHECKING:
    import plotly.graph_objects as go

_MAPS = ("w", "displacement_x", "shape_z")  # the first that is measured is shown
COLUMNS = (
    "recording",
    "specimen",
    "group",
    "steps",
    "failed",
    "relative to step",
    "confirmed [%]",
    "largest force [N]",
    "largest strain [µstrain]",
    "its standard deviation",
    "noise of w [µm]",
    "modulus [GPa]",
    "Poisson's ratio",
)
GROUP_COLUMNS = (
    "group",
    "figure",
    "recordings",
    "mean",
    "spread of specimens",
    "uncertainty of one",
    "between specimens",
)
_FIGURES = {
    "modulus": ("modulus [GPa]", 1e9),
    "poisson_ratio": ("Poisson's ratio", 1.0),
    "largest_strain": ("largest strain [µstrain]", 1e-6),
    "largest_force": ("largest force [N]", 1.0),
}


def write_campaign_page(store: CampaignStore, status: Status, output: Path) -> Path:
    """Write the page of a campaign; an earlier one is replaced.

    Parameters
    ----------
    store, status
        Of the campaign.
    output
        HTML file.

    Raises
    ------
    CampaignError
        The file cannot be written, or the store cannot be read.
    FringedicError
        A package of the extra ``report`` is not installed.
    """
    page = render_page(
        "campaign.html.j2",
        title=status.plan.title or store.address,
        store=store.address,
        sentences=status_sentences(status),
        group_columns=GROUP_COLUMNS,
        groups=group_rows(group_statistics(status.done.values())),
        charts=[chart_html(chart) for chart in _charts(status.done.values())],
        script=chart_script(),
        columns=COLUMNS,
        rows=[(_row(receipt), _picture(store, receipt.name)) for receipt in status.done.values()],
    )
    try:
        output.write_text(page, encoding="utf-8")
    except OSError as error:
        raise CampaignError(f"{output}: cannot be written: {cause_of(error)}; choose another --output") from error
    return output


def group_rows(statistics: Iterable[GroupStatistic]) -> list[list[str]]:
    """Return `GROUP_COLUMNS` of statistics of groups in the units of people."""
    rows = []
    for each in statistics:
        name, unit = _FIGURES[each.figure]
        values = (each.mean, each.spread, each.uncertainty, each.between_specimens)
        numbers = [number_text(value / unit) for value in values]
        rows.append([each.group or "-", name, str(each.recordings), *numbers])
    return rows


def _charts(receipts: Iterable[Receipt]) -> Iterator[go.Figure]:
    """Yield the curves of each group."""
    groups: dict[str, dict[str, SpecimenCurve]] = {}
    for receipt in receipts:
        curve = {name: np.array(values, float) for name, values in receipt.curve.items()}
        known = specimen_curve(curve, receipt.figures["axial_strain"])
        groups.setdefault(receipt.labels["group"], {})[receipt.name] = known
    for group, curves in groups.items():
        yield from specimen_charts(group or "Recordings without a group", curves)


def _row(receipt: Receipt) -> list[str]:
    figures, labels = receipt.figures, receipt.labels
    return [
        receipt.name,
        labels["specimen"] or figures["specimen"] or "-",
        labels["group"] or "-",
        str(figures["steps"]),
        str(figures["failed_steps"]),
        _reference(figures),
        _number(figures["confirmed_fraction"], 1e-2),
        _number(figures["largest_force"], 1.0),
        _number(figures["largest_strain"], 1e-6),
        _number(figures["sigma_largest_strain"], 1e-6),
        _number(figures["noise_w"], 1e-6),
        _with_uncertainty(figures, "modulus"),
        _with_uncertainty(figures, "poisson_ratio"),
    ]


def _reference(figures: dict[str, Any]) -> str:
    """Return the reference step of the strains, and in brackets all of the recording where there are several."""
    reference, every = figures["reference_step"], figures["reference_steps"]
    if reference is None:
        return "-"
    return str(reference) if every == str(reference) else f"{reference} (of {every})"


def _number(value: float | None, unit: float) -> str:
    return "-" if value is None else number_text(value / unit)


def _with_uncertainty(figures: dict[str, Any], name: str) -> str:
    value, sigma, unit = figures[name], figures[f"sigma_{name}"], _FIGURES[name][1]
    return "-" if value is None else f"{_number(value, unit)} ± {number_text(float(f'{sigma / unit:.2g}'))}"


def _picture(store: CampaignStore, recording: str) -> dict[str, Any]:
    """Return the thumbnail of the last measured step, with its description."""
    with open_group(store, recording) as dataset:
        measured = np.flatnonzero(dataset["error"].values == "")
        names = [name for name in _MAPS if name in dataset]
        if not measured.size or not names:
            return {"png": "", "words": "nothing measured"}
        step = dataset.isel(step=int(measured[-1]))
        for name in names:
            values = step[name].values
            if np.isfinite(values).any():
                break
    png, (low, high) = thumbnail_png(values)
    unit = people_unit(dataset[name])
    words = f"{name} of step {int(step['step'])}: {number_text(low / unit.factor)} to {number_text(high / unit.factor)}"
    return {"png": base64_text(png), "words": f"{words} {unit.text}"}
