"""Opening of the results of a campaign: a tree of datasets and a catalogue."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from fringedic.campaign.settings import store_address
from fringedic.campaign.store import BEGUN, FAILURES, PLAN, RECEIPTS, RECORDINGS, CampaignStore
from fringedic.datasets.checksums import open_checked
from fringedic.datasets.millimetres import with_millimetres
from fringedic.errors import CampaignError
from fringedic.wording.arguments import check_arguments
from fringedic.wording.arguments import path as file_path

if TYPE_CHECKING:
    import pandas as pd


@check_arguments(CampaignError, place=file_path)
def open_campaign(place: str | os.PathLike[str]) -> tuple[xr.DataTree, pd.DataFrame]:
    """Open the results of a campaign; maps are read when they are used.

    Parameters
    ----------
    place
        Folder of the campaign, its ``campaign.yaml``, or the address of its store (a folder, ``s3://...``).

    Returns
    -------
    tree : DataTree
        One dataset per complete recording of the plan under its name, as of `fringedic.open_experiment`:
        ``tree["plate-7"].dataset``.
    catalogue : DataFrame
        One row per complete recording under its name: labels, the figures of
        `fringedic.campaign.key_figures.key_figures`, software and key. SI units; NaN is not known.

    Raises
    ------
    CampaignError
        There is no campaign, its store cannot be read, or a receipt was damaged or removed.

    Examples
    --------
    >>> tree, catalogue = open_campaign("batch-7")  # doctest: +SKIP
    >>> catalogue.groupby("material").largest_strain.describe()  # doctest: +SKIP
    """
    store = CampaignStore(store_address(place))
    plan = store.read(PLAN)
    if plan is None:
        raise CampaignError(f"{store.address}: is no campaign: it has no {PLAN}; 'fringedic campaign run' makes one")
    units = {unit["name"]: unit for unit in plan["units"]}
    documents = store.documents(RECEIPTS)
    _require_receipts(store, sorted(units.keys() - documents.keys()))
    receipts = {
        name: {**receipt, "labels": units[name]["labels"]}  # the plan's, which may have been corrected since then
        for name, receipt in documents.items()
        if name in units and _is_planned(receipt, units[name])
    }
    tree = xr.DataTree.from_dict({name: open_group(store, name) for name in receipts}, name=plan["title"] or None)
    return tree, _catalogue(receipts)


def _require_receipts(store: CampaignStore, waiting: list[str]) -> None:
    """Refuse a store that has results of a recording without receipt, which no attempt leaves.

    Another worker may process the recording now: it writes its marker before the group, and removes it after the
    receipt or failure. In this order of reading one of them is found.
    """
    complete = store.complete_groups(waiting) if waiting else []
    for folder in (BEGUN, FAILURES, RECEIPTS):
        complete = [name for name in complete if store.read(f"{folder}/{name}.json") is None]
    if complete:
        raise CampaignError(
            f"{store.address}/{RECEIPTS}/{complete[0]}.json is missing or not complete, although the results of this "
            "recording are there: repeat 'fringedic campaign run', which makes it again"
        )


def open_group(store: CampaignStore, recording: str) -> xr.Dataset:
    """Open the dataset of one recording; its checksums are compared, those of maps when they are read.

    Raises
    ------
    DatasetError
        It is damaged.
    """
    place = f"{store.address}/{RECORDINGS}/{recording}"
    source = store.zarr_store(recording, read_only=True)
    return with_millimetres(open_checked(source, place, netcdf=False, consolidated=True))


def _is_planned(receipt: dict[str, Any], unit: dict[str, Any]) -> bool:
    """Return whether a receipt is that of a planned unit; the key of a recording that is being made is not known."""
    return not unit["fingerprint"] or receipt["key"] == unit["key"]


def _catalogue(receipts: dict[str, dict[str, object]]) -> pd.DataFrame:
    import pandas as pd  # not at the top: most tasks do not need it, and it takes long to load

    rows = {name: _row(receipt) for name, receipt in receipts.items()}
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("recording")


def _row(receipt: dict[str, object]) -> dict[str, object]:
    """Return the row of a recording: labels of the campaign replace what was recorded."""
    figures, labels, software = receipt["figures"], receipt["labels"], receipt["software"]
    assert isinstance(figures, dict)
    assert isinstance(labels, dict)
    assert isinstance(software, dict)
    entered = {name: value for name, value in labels.items() if value or name not in figures}
    known = {name: np.nan if value is None else value for name, value in figures.items()}
    origin = {"software": software["fringedic"], "commit": software["commit"], "key": receipt["key"]}
    return {**known, **entered, **origin}
