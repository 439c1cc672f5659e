"""Statistics of the specimens of a group: their spread beside the uncertainty of one measurement."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from fringedic.campaign.receipts import Receipt

COMPARED = ("modulus", "poisson_ratio", "largest_strain", "largest_force")
"""Figures of the catalogue that are compared between the specimens of a group."""


@dataclass(frozen=True)
class GroupStatistic:
    """One figure over the specimens of a group.

    Attributes
    ----------
    group, figure
        Name of the group and of the figure in the catalogue.
    recordings
        Number of recordings with this figure.
    mean, spread
        Mean and standard deviation over the recordings, in SI units.
    uncertainty
        Root mean square of the stated standard uncertainties; NaN if there are none.
    """

    group: str
    figure: str
    recordings: int
    mean: float
    spread: float
    uncertainty: float

    @property
    def between_specimens(self) -> float:
        """Standard deviation between the specimens without that of the measurement; NaN without an uncertainty."""
        return math.sqrt(max(0.0, self.spread**2 - self.uncertainty**2)) if self.uncertainty >= 0 else math.nan


def group_statistics(receipts: Iterable[Receipt]) -> list[GroupStatistic]:
    """Return the statistics of the groups with several recordings.

    Parameters
    ----------
    receipts
        Of complete recordings.

    Returns
    -------
    list
        Of each group the `COMPARED` figures that at least two of its recordings have.
    """
    groups: dict[str, list[Receipt]] = {}
    for receipt in receipts:
        groups.setdefault(receipt.labels["group"], []).append(receipt)
    return [each for group, members in groups.items() for each in _statistics(group, members)]


def _statistics(group: str, members: list[Receipt]) -> Iterator[GroupStatistic]:
    for figure in COMPARED:
        known = [each.figures for each in members if each.figures[figure] is not None]
        if len(known) < 2:
            continue
        values = np.array([each[figure] for each in known], float)
        sigmas = np.array([each.get(f"sigma_{figure}") for each in known], float)
        yield GroupStatistic(
            group=group,
            figure=figure,
            recordings=len(known),
            mean=float(values.mean()),
            spread=float(values.std(ddof=1)),
            uncertainty=float(np.sqrt(np.mean(sigmas**2))),
        )
