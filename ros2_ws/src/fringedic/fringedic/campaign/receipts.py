"""What the store says about a unit: its receipt, or why it failed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from fringedic.campaign.plan import Unit
from fringedic.campaign.software import worker_name
from fringedic.campaign.store import PARTS, RECEIPTS, CampaignStore
from fringedic.errors import CampaignError


@dataclass(frozen=True)
class Receipt:
    """The commit marker of a recording: all objects of its group are written.

    Attributes
    ----------
    name, key
        Of the unit.
    software, fingerprint, labels
        Of the unit.
    digest, objects, size
        SHA-256 over all objects of the group, their number and their size [byte].
    figures
        Of `key_figures`.
    curve
        Of `fringedic.evaluation.strain_curve`: values over the steps by their names; None where not known.
    seconds, worker, processor
        Duration, and where it was processed.
    input_size
        Of the recording [byte].
    attempts
        How often it was begun: more than once after an interruption.
    """

    name: str
    key: str
    software: dict[str, str]
    fingerprint: dict[str, Any]
    labels: dict[str, str]
    digest: str
    objects: int
    size: int
    figures: dict[str, Any]
    curve: dict[str, list[float | None]]
    seconds: float
    worker: str
    processor: str
    input_size: int
    attempts: int = 1


@dataclass(frozen=True)
class Failure:
    """A recording that could not be processed, with the reason as one sentence."""

    name: str
    key: str
    reason: str
    worker: str = field(default_factory=worker_name)


def receipt_name(unit: Unit) -> str:
    """Return the object of the receipt of a unit."""
    return f"{RECEIPTS if unit.part is None else PARTS}/{unit.name}.json"


def read_receipt(store: CampaignStore, unit: Unit) -> Receipt | None:
    """Return the receipt of a unit; None if it is not complete.

    Raises
    ------
    CampaignError
        The store contains results of other settings.
    """
    document = store.read(receipt_name(unit))
    if document is None:
        return None
    if document["key"] != unit.key:
        raise other_results(store.address, [unit.name])
    return Receipt(**document)


def other_results(address: str, names: list[str]) -> CampaignError:
    """Return the error of a store whose results have another key than the plan."""
    shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    return CampaignError(
        f"the store {address} contains results of other settings, recordings or software for {shown}: give another "
        "store in the file of the campaign, or compute them again with 'fringedic campaign run --recompute'"
    )
