"""One unit of work: a recording is processed into its group of the store, and its receipt is written last."""

from __future__ import annotations

import time
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fringedic.campaign.group_store import GroupStore, join_parts
from fringedic.campaign.key_figures import key_figures
from fringedic.campaign.opening import open_group
from fringedic.campaign.plan import Unit
from fringedic.campaign.receipts import Failure, Receipt, read_receipt, receipt_name
from fringedic.campaign.recordings import fingerprint, summarise
from fringedic.campaign.software import worker_name
from fringedic.campaign.store import BEGUN, FAILURES, RECORDINGS, CampaignStore
from fringedic.datasets.copying import copy_into
from fringedic.datasets.opening import open_experiment
from fringedic.datasets.processing import PROCESSED_TOPICS, follow_into, process_into
from fringedic.errors import CampaignError, FringedicError
from fringedic.evaluation.elasticity import constants_of, strain_curve
from fringedic.provenance import differences, processor, software_identity
from fringedic.recording.growing import PATIENCE_S, FollowError, GrowingRecording
from fringedic.recording.remote import local_copy
from fringedic.wording.causes import cause_of


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
    elif unit.processing.get("sensors"):
        _join(unit, group)
    else:
        with local_copy(unit.path, PROCESSED_TOPICS) as path:
            process_into(group, path, unit.settings)
    return _commit(unit, group, begun)


def _join(unit: Unit, group: GroupStore) -> None:
    """Process each sensor of a recording, and write their joined surface."""
    from fringedic.sensors.files import registration_from_text  # not at the top: recordings of one sensor need none
    from fringedic.sensors.join import join_sensors

    registration = registration_from_text(unit.processing["registration"], f"registration of {unit.path}")
    with TemporaryDirectory(prefix="fringedic-sensors-") as folder, ExitStack() as opened:
        datasets = {}
        for sensor in unit.processing["sensors"]:
            file = Path(folder) / f"{sensor}.nc"
            process_into(file, unit.path, replace(unit.settings, sensor=sensor))
            datasets[sensor] = opened.enter_context(open_experiment(file))
        copy_into(group, join_sensors(datasets, registration))


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
            return _commit(unit.completed(summarise(unit.path, unit.settings.sensor)), group, begun)
        begun.remove()
    recording.wait()
    return process_unit(unit.completed(summarise(unit.path, unit.settings.sensor)))


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
        curve = strain_curve(dataset, unit.elasticity.region, load=unit.elasticity.load)
        constants = constants_of(curve, unit.elasticity.strain, unit.elasticity.force_sigma_newton)
        figures = key_figures(dataset, constants, load=unit.elasticity.load)
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
    store.write(receipt_name(unit), asdict(receipt))
    begun.remove()
    for part in unit.parts:
        store.remove(receipt_name(part))
        store.remove(f"{RECORDINGS}/{part.name}")
    return receipt


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
