"""Datasets that an earlier version wrote, in the form of the present one; the only place that reads the old one."""

from __future__ import annotations

import json
import re

import xarray as xr

from fringedic.datasets.quantities import METADATA_ATTRIBUTE, MISSING_PARTS
from fringedic.frames.sensor import SENSOR
from fringedic.metadata import translate_metadata
from fringedic.signals import FORCE, POSITION

_PARTS = re.compile(r"(?:^|; )([^;]+) beside it, later parts of the same run, are not read")  # in the damage


def translate(dataset: xr.Dataset) -> None:
    """Give an opened dataset the attributes that an earlier version wrote in another form.

    Parameters
    ----------
    dataset
        Its attributes and those of its signals are changed.

    Examples
    --------
    >>> damage = "bag_0.mcap: not closed; bag-1, bag-2 beside it, later parts of the same run, are not read"
    >>> dataset = xr.Dataset(attrs={"damage": damage})
    >>> translate(dataset)
    >>> dataset.attrs["missing_parts"], dataset.attrs["sensor"]
    ('["bag-1", "bag-2"]', 'sensor')
    """
    for channel in (FORCE, POSITION):
        if channel.name in dataset.data_vars:
            for name in ("quantity", "positive", "source"):
                dataset[channel.name].attrs.setdefault(name, getattr(channel, name))
    attributes = dataset.attrs
    attributes.setdefault("sensor", SENSOR)
    if METADATA_ATTRIBUTE in attributes:
        attributes[METADATA_ATTRIBUTE] = json.dumps(translate_metadata(json.loads(attributes[METADATA_ATTRIBUTE])))
    named = _PARTS.search(str(attributes.get("damage", "")))
    if named and MISSING_PARTS not in attributes:
        attributes[MISSING_PARTS] = json.dumps(named[1].split(", "))
