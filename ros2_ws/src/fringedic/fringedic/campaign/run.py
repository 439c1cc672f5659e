"""Running a campaign: which units are left, and their outcomes."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fringedic.campaign.plan import Plan, Unit, make_plan
from fringedic.campaign.receipts import Failure, Receipt, other_results
from fringedic.campaign.settings import Campaign
from fringedic.campaign.store import BEGUN, FAILURES, PARTS, PLAN, RECEIPTS, RECORDINGS, CampaignStore
from fringedic.errors import CampaignError
from fringedic.provenance import software_identity


@dataclass(frozen=True)
class Status:
    """State of a campaign by its receipts and failures alone.

    Attributes
    ----------
    plan
        The plan.
    done
        Receipts by the names of their recordings, with the labels of the plan.
    failed
        Failures by the names of their recordings.
    begun
        Of each recording that a worker processes, or was processing when it died, by its name: ``worker``, ``attempts``
        and, while the recording is made, the ``steps`` that are measured.
    unplanned
        Names of complete recordings in the store that the plan does not contain.
    """

    plan: Plan
    done: dict[str, Receipt]
    failed: dict[str, Failure]
    begun: dict[str, dict[str, Any]] = field(default_factory=dict)
    unplanned: list[str] = field(default_factory=list)

    @property
    def waiting(self) -> list[Unit]:
        """Units that are neither complete nor failed."""
        return [unit for unit in self.plan.units if unit.name not in self.done and unit.name not in self.failed]

    def share(self, number: int, count: int) -> list[Unit]:
        """Return the waiting units of one of several parts of the plan, for arrays of jobs.

        The parts are those of the plan, so that jobs that start at different times have different units.

        Parameters
        ----------
        number, count
            Of the part, from 1, and of all parts.
        """
        part = {unit.name for unit in self.plan.units[number - 1 :: count]}
        return [unit for unit in self.waiting if unit.name in part]

    @property
    def complete(self) -> bool:
        """Whether every recording of the campaign is processed."""
        return len(self.done) == len(self.plan.units) and not self.plan.refused


def read_plan(store: CampaignStore) -> Plan:
    """Return the plan of a store.

    Raises
    ------
    CampaignError
        There is none.
    """
    document = store.read(PLAN)
    if document is None:
        raise CampaignError(f"{store.address}: has no plan; 'fringedic campaign plan' makes one")
    return Plan.from_document(document)


def status_of(store: CampaignStore, plan: Plan) -> Status:
    """Return the state of a campaign.

    Raises
    ------
    CampaignError
        The store contains results of another plan, or cannot be read.
    """
    units = {unit.name: unit for unit in plan.units}
    receipts, failures = store.documents(RECEIPTS), store.documents(FAILURES)
    growing = {unit.name for unit in plan.units if unit.growing}  # their receipts have the keys of complete recordings
    other = [
        name
        for name, receipt in receipts.items()
        if name in units.keys() - growing and receipt["key"] != units[name].key
    ]
    if other:
        raise other_results(store.address, other)
    done = {
        name: Receipt(**{**receipt, "labels": units[name].labels})
        for name, receipt in receipts.items()
        if name in units
    }
    failed = {
        name: Failure(**failure)
        for name, failure in failures.items()
        if name in units.keys() - done.keys() and failure["key"] == units[name].key
    }
    begun = {name: each for name, each in store.documents(BEGUN).items() if name in units.keys() - done.keys()}
    return Status(plan, done, failed, begun, sorted(receipts.keys() - units.keys()))


def damaged(store: CampaignStore, status: Status) -> list[str]:
    """Return the names of the complete recordings whose objects are not those of their receipts; all are read."""
    return [name for name, receipt in status.done.items() if store.digest(name) != receipt.digest]


def update_plan(campaign: Campaign, *, recompute: bool = False, follow: bool = False) -> Plan:
    """Make the plan of a campaign and write it to the store.

    Parameters
    ----------
    campaign
        From `load_campaign`.
    recompute
        Remove results of other settings, recordings or software instead of refusing them.
    follow
        Plan recordings that are being made, too.

    Raises
    ------
    CampaignError
        The store contains results of other settings, recordings or software.
    """
    from fringedic.campaign.recordings import find_recordings  # not at the top: a state needs no recording

    store = CampaignStore(campaign.store)
    plan = make_plan(campaign, find_recordings(campaign), follow=follow)
    if recompute:
        _remove_other(store, plan)
    growing = {unit.name for unit in plan.units if unit.growing}
    if old := sorted(growing & store.documents(RECEIPTS).keys()):
        raise other_results(store.address, old)
    status_of(store, plan)
    store.write(PLAN, plan.to_document())
    return plan


def current_plan(campaign: Campaign, *, recompute: bool = False, follow: bool = False) -> Plan:
    """Return the plan of the store if it is that of the campaign and of this software, otherwise a new one.

    With recordings that are being made (`follow`) it is always a new one.
    """
    store = CampaignStore(campaign.store)
    document: dict[str, Any] | None = None if recompute or follow else store.read(PLAN)
    if document is not None:
        plan = Plan.from_document(document)
        if _fits(plan, campaign):
            return plan
    return update_plan(campaign, recompute=recompute, follow=follow)


def forget_failures(store: CampaignStore) -> None:
    """Remove the records of failures, so that their recordings are processed again."""
    store.remove(FAILURES)


def _fits(plan: Plan, campaign: Campaign) -> bool:
    """Return whether a plan has the recordings, labels and settings of a campaign, and the software of this computer.

    A recording that was continued since then is another one; those in an object store are not looked at again.
    """
    from fringedic.campaign.recordings import find_recordings
    from fringedic.recording.bag_files import recorded_bytes
    from fringedic.recording.remote import is_remote

    named = {each.name: (each.path, each.labels, campaign.processing(each.entry)) for each in find_recordings(campaign)}
    planned = {unit.name: (unit.path, unit.labels, unit.processing) for unit in plan.units}
    units = plan.units
    return (
        named.keys() == planned.keys() | plan.refused.keys()
        and planned.items() <= named.items()
        and bool(units)
        and all(is_remote(unit.path) or recorded_bytes(Path(unit.path)) == unit.size for unit in units)
        and units[0].software == software_identity()
        and not any(unit.growing for unit in units)
        and plan.title == campaign.content.title
    )


def _remove_other(store: CampaignStore, plan: Plan) -> None:
    """Remove results that are not those of the plan, the receipt first."""
    keys = {unit.name: unit.key for unit in plan.units}
    for name, receipt in store.documents(RECEIPTS).items():
        if receipt["key"] != keys.get(name):
            store.remove(f"{RECEIPTS}/{name}.json")
            store.remove(f"{RECORDINGS}/{name}")
    for name, receipt in store.documents(PARTS).items():
        if receipt["key"] not in keys.values():
            store.remove(f"{PARTS}/{name}.json")
            store.remove(f"{RECORDINGS}/{name}")
