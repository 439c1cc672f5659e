"""Sentences and tables about campaigns."""

from __future__ import annotations

from fringedic.campaign import Failure, Receipt, group_statistics
from fringedic.campaign.page import group_rows
from fringedic.campaign.sentences import CampaignProgress


def receipt(name: str, group: str, strain: float | None) -> Receipt:
    figures = {"steps": 6, "failed_steps": 1, "largest_force": 100.0, "largest_strain": strain}
    figures |= {"modulus": None, "poisson_ratio": None}
    return Receipt(
        name=name,
        key="",
        software={},
        fingerprint={},
        labels={"group": group},
        digest="",
        objects=1,
        size=1,
        curve={},
        figures={**figures, "sigma_largest_strain": 3e-5},
        seconds=4.0,
        worker="computer:1",
        processor="any",
        input_size=2_000_000,
    )


def test_groups_show_the_spread_of_their_specimens_beside_the_uncertainty() -> None:
    receipts = [receipt("a", "one", 1e-3), receipt("b", "one", 3e-3), receipt("c", "two", 1e-3)]
    rows = group_rows(group_statistics([*receipts, receipt("d", "one", None)]))
    assert rows == [
        ["one", "largest strain [µstrain]", "2", "2000", "1414", "30", "1414"],
        ["one", "largest force [N]", "3", "100", "0", "-", "-"],
    ]
    (strain, _) = group_statistics([receipt("a", "", 1e-3), receipt("b", "", 1.02e-3)])
    assert strain.between_specimens == 0  # the measurement explains the spread


def test_progress_states_rates_failures_and_the_remaining_time() -> None:
    progress = CampaignProgress([])
    said = progress.sentence(receipt("a", "", 1e-3), 4.0)
    assert said == "1 of 0: a: 6 steps, 1 failed, 4.0 s; 1.5 steps/s, 0.5 MB/s, 0 s left"
    assert progress.sentence(Failure("b", "", "b: is damaged"), 5.0) == "2 of 0: b failed: b: is damaged"
