"""One unit of work: a recording is processed into its group of the store, and its receipt is written last."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fringedic.campaign.key_figures import key_figures
from fringedic.campaign.opening import open_group
from fringedic.campaign.plan import Unit
from fringedic.campaign.recordings import fingerprint, summarise
from fringedic.campaign.software import differences, processor, software_identity, worker_name
from fringedic.campaign.store import (
    BEGUN,
    FAILURES,
    PARTS,
    RECEIPTS,
    RECORDINGS,
    CampaignStore,
    GroupStore,
    join_parts,
)
from fringedic.datasets.processing import PROCESSED_TOPICS, follow_into, process_into
from fringedic.errors import CampaignError, FringedicError
from fringedic.evaluation.elasticity import constants_of, strain_curve
from fringedic.recording.growing import PATIENCE_S, FollowError, GrowingRecording
from fringedic.recording.remote import local_copy
from fringedic.wording.causes import cause_of


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


def process_unit(unit: Unit) -> Receipt:
    """Process one recording; a unit that is complete already is not processed again.

    A recording with parts is joined from them; parts that are not complete yet are processed first. A recording that is
    being made is processed step by step until it is complete.

    The results are those of `fringedic.process_bag`, bit by bit on the same kind of processor. The function can be
    repeated at any time, also by several workers at once: all write the same objects.

    Parameters
    ----------
    unit
        From the plan of a campaign.

    Returns
    -------
    Receipt
        The new one, or that of the store.

    Raises
    ------
    CampaignError
        The store contains results of other settings, this computer has another version of the software than the plan,
        the recording is not the one that was planned, or the store cannot be read or written.
    FringedicError
        The recording cannot be processed; see `fringedic.process_bag`.
    """
    if unit.growing:
        return _follow(unit)
    store = CampaignStore(unit.store)
    done = read_receipt(store, unit)
    if done is not None:
        return done
    _require_software(unit)
    _require_recording(unit)
    begun = _begin(store, unit)
    group = GroupStore(store, unit.name)
    if unit.parts:
        for part in unit.parts:
            process_unit(part)
        join_parts(store, [part.name for part in unit.parts], group)
    else:
        with local_copy(unit.path, PROCESSED_TOPICS) as path:
            process_into(group, path, unit.settings)
    return _commit(unit, group, begun)


def _follow(unit: Unit) -> Receipt:
    """Process a recording while it is made, and return the receipt of the complete one.

    With a reference of the campaign, or in segments, it is processed when it is complete.
    """
    store, recording = CampaignStore(unit.store), GrowingRecording(Path(unit.path), patience_s=PATIENCE_S)
    if not recording.is_complete() and not unit.settings.references and unit.processing["segments"] == 1:
        _require_software(unit)
        recording.wait_for_writer()
        begun = _begin(store, unit)
        group = GroupStore(store, unit.name)
        with suppress(FollowError):
            follow_into(group, recording, unit.settings, lambda *_: begun.count_step())
            return _commit(unit.completed(summarise(unit.path)), group, begun)
        begun.remove()
    recording.wait()
    return process_unit(unit.completed(summarise(unit.path)))


@dataclass
class _Begun:
    """The marker of a unit that is being processed."""

    store: CampaignStore
    name: str
    key: str
    attempts: int
    started: float
    steps: int = 0

    def write(self) -> None:
        """Write the marker."""
        document = {"key": self.key, "attempts": self.attempts, "steps": self.steps, "worker": worker_name()}
        self.store.write(f"{BEGUN}/{self.name}.json", document)

    def remove(self) -> None:
        """Remove the marker."""
        self.store.remove(f"{BEGUN}/{self.name}.json")

    def count_step(self) -> None:
        """Enter one more step of a recording that is being made."""
        self.steps += 1
        self.write()


def _begin(store: CampaignStore, unit: Unit) -> _Begun:
    """Write that a unit is begun; a marker that is there already is that of an interrupted attempt."""
    earlier = store.read(f"{BEGUN}/{unit.name}.json")
    attempts = int(earlier["attempts"]) if earlier is not None and earlier["key"] == unit.settings_key else 0
    begun = _Begun(store, unit.name, unit.settings_key, attempts + 1, time.perf_counter())
    begun.write()
    return begun


def _commit(unit: Unit, group: GroupStore, begun: _Begun) -> Receipt:
    """Write the receipt of a recording whose group is complete."""
    store = CampaignStore(unit.store)
    _require_recording(unit)
    with open_group(store, unit.name) as dataset:
        curve = strain_curve(dataset, unit.elasticity.region)
        constants = constants_of(curve, unit.elasticity.strain, unit.elasticity.force_sigma_newton)
        figures = key_figures(dataset, constants)
    receipt = Receipt(
        name=unit.name,
        key=unit.key,
        software=unit.software,
        fingerprint={name: list(parts) for name, parts in unit.fingerprint.items()},
        labels=unit.labels,
        digest=group.digest,
        objects=group.objects,
        size=group.size,
        figures=figures,
        curve={str(name): _known(values.values) for name, values in curve.data_vars.items()},
        seconds=time.perf_counter() - begun.started,
        worker=worker_name(),
        processor=processor(),
        input_size=unit.size,
        attempts=begun.attempts,
    )
    store.write(_receipt_name(unit), asdict(receipt))
    begun.remove()
    for part in unit.parts:
        store.remove(_receipt_name(part))
        store.remove(f"{RECORDINGS}/{part.name}")
    return receipt


def _receipt_name(unit: Unit) -> str:
    return f"{RECEIPTS if unit.part is None else PARTS}/{unit.name}.json"


def attempt(unit: Unit) -> Receipt | Failure:
    """Process one recording; a failure is recorded in the store, and returned instead of being raised."""
    try:
        return process_unit(unit)
    except FringedicError as error:
        reason = str(error)
    except OSError as error:
        reason = f"{error.filename or unit.path}: {cause_of(error)}; make room or check the rights"
    except Exception as error:  # a fault of one recording must not end a campaign of a thousand
        reason = f"{unit.path}: {type(error).__name__}: {error}; report this as a fault of fringedic"
    return record_failure(unit, reason)


def record_failure(unit: Unit, reason: str) -> Failure:
    """Write why a unit could not be processed, and return it; the failure of a part becomes that of its recording."""
    failure = Failure(unit.name, unit.key, " ".join(reason.split())[:500])
    if unit.part is not None:
        return failure
    store = CampaignStore(unit.store)
    with suppress(CampaignError):  # a full disk has no room for the reason either
        store.write(f"{FAILURES}/{unit.name}.json", asdict(failure))
        store.remove(f"{BEGUN}/{unit.name}.json")
    return failure


def read_receipt(store: CampaignStore, unit: Unit) -> Receipt | None:
    """Return the receipt of a unit; None if it is not complete.

    Raises
    ------
    CampaignError
        The store contains results of other settings.
    """
    document = store.read(_receipt_name(unit))
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


def _known(values: np.ndarray) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


def _require_software(unit: Unit) -> None:
    here = software_identity()
    if here != unit.software:
        raise CampaignError(
            f"{worker_name()} has {differences(here, unit.software)}: install the software of the plan there, or plan "
            "again with 'fringedic campaign plan'"
        )


def _require_recording(unit: Unit) -> None:
    if fingerprint(unit.path) != unit.fingerprint:
        raise CampaignError(
            f"{unit.path}: has changed since it was planned; wait until it is complete, plan again, and repeat it with "
            "'fringedic campaign retry'"
        )
