"""The page of a campaign: one HTML file with a thumbnail and the figures of each recording."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fringedic.campaign.opening import open_group
from fringedic.campaign.run import Status
from fringedic.campaign.store import CampaignStore
from fringedic.campaign.unit import Receipt
from fringedic.errors import CampaignError
from fringedic.figures.thumbnails import thumbnail_png
from fringedic.report.campaign import status_sentences
from fringedic.report.embedding import base64_text
from fringedic.report.templates import render_page
from fringedic.results.quantities import number_text, people_unit

_MAPS = ("w", "displacement_x", "shape_z")  # the first that is measured is shown
COLUMNS = (
    "recording",
    "specimen",
    "group",
    "steps",
    "failed",
    "confirmed [%]",
    "largest force [N]",
    "largest strain [µstrain]",
    "its standard deviation",
    "noise of w [µm]",
)


GROUP_COLUMNS = (
    "group",
    "recordings",
    "largest force [N]",
    "spread of specimens",
    "largest strain [µstrain]",
    "spread of specimens",
    "uncertainty of one",
)


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
        groups=group_rows(status.done.values()),
        columns=COLUMNS,
        rows=[(_row(receipt), _picture(store, receipt.name)) for receipt in status.done.values()],
    )
    try:
        output.write_text(page, encoding="utf-8")
    except OSError as error:
        raise CampaignError(f"{output}: cannot be written: {error.strerror}; choose another --output") from error
    return output


def group_rows(receipts: Iterable[Receipt]) -> list[list[str]]:
    """Return `GROUP_COLUMNS` of each group with several recordings: the spread of its specimens beside the uncertainty.

    Parameters
    ----------
    receipts
        Of complete recordings.
    """
    groups: dict[str, list[Receipt]] = {}
    for receipt in receipts:
        groups.setdefault(receipt.labels["group"], []).append(receipt)
    rows = []
    for group, members in groups.items():
        known = [each.figures for each in members if each.figures["largest_strain"] is not None]
        if len(known) < 2:
            continue
        forces = np.array([each["largest_force"] for each in known], float)
        strains = 1e6 * np.array([each["largest_strain"] for each in known], float)
        sigmas = 1e6 * np.array([each["sigma_largest_strain"] for each in known], float)
        rows.append(
            [
                group or "-",
                str(len(known)),
                *map(number_text, (forces.mean(), forces.std(ddof=1))),
                *map(number_text, (strains.mean(), strains.std(ddof=1), np.sqrt(np.mean(sigmas**2)))),
            ]
        )
    return rows


def _row(receipt: Receipt) -> list[str]:
    figures, labels = receipt.figures, receipt.labels
    return [
        receipt.name,
        labels["specimen"] or figures["specimen"] or "-",
        labels["group"] or "-",
        str(figures["steps"]),
        str(figures["failed_steps"]),
        _number(figures["confirmed_fraction"], 1e-2),
        _number(figures["largest_force"], 1.0),
        _number(figures["largest_strain"], 1e-6),
        _number(figures["sigma_largest_strain"], 1e-6),
        _number(figures["noise_w"], 1e-6),
    ]


def _number(value: float | None, unit: float) -> str:
    return "-" if value is None else number_text(value / unit)


def _picture(store: CampaignStore, recording: str) -> dict[str, Any]:
    """Return the thumbnail of the last measured step, with its description."""
    with open_group(store, recording) as dataset:
        measured = np.flatnonzero(dataset["error"].values == "")
        names = [name for name in _MAPS if name in dataset]
        if not measured.size or not names:
            return {"png": "", "words": "nothing measured"}
        step = dataset.isel(step=int(measured[-1]))
        name, values = _first_measured(step, names)
    png, (low, high) = thumbnail_png(values)
    unit = people_unit(dataset[name])
    words = f"{name} of step {int(step['step'])}: {number_text(low / unit.factor)} to {number_text(high / unit.factor)}"
    return {"png": base64_text(png), "words": f"{words} {unit.text}"}


def _first_measured(step: xr.Dataset, names: list[str]) -> tuple[str, np.ndarray]:
    for name in names:
        values = step[name].values
        if np.isfinite(values).any():
            break
    return name, values
