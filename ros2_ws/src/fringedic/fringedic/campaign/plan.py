"""The plan of a campaign: one unit of work per recording, made from the summaries alone."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

from fringedic.campaign.settings import Campaign, Elasticity
from fringedic.errors import FringedicError
from fringedic.provenance import software_identity
from fringedic.wording.causes import cause_of

if TYPE_CHECKING:
    from fringedic.campaign.recordings import Found, Summary
    from fringedic.datasets.processing import ProcessingSettings

_SHARED = ("software", "store")  # by all units
_LIBRARIES = 0.45e9  # [byte] of a worker before it processes anything
_IMAGES = 3  # stacks of a step's frames in memory at the same time
_MAPS = 150  # float32 images of a step in memory at the same time: 124 measured by benchmarks/campaign.py
_MAPS_OF_A_KEPT_STEP = 5  # of a step that can become the reference


@dataclass(frozen=True)
class Unit:
    """The unit of work of a campaign: one recording from its frames to its datasets.

    Attributes
    ----------
    name
        Of the recording, and of its group in the store.
    path
        The recording.
    store
        Address of the store.
    key
        Hash of settings, software and fingerprint: results of another key are others.
    processing
        Settings as of `Campaign.processing`.
    software
        Of `software_identity`.
    fingerprint
        Of `Summary`; empty for a recording that is being made.
    labels
        Of the catalogue.
    steps
        Estimated number of steps; 0 for a recording that is being made.
    size
        Of the recording [byte].
    memory
        Predicted need of memory [byte]; 0 before the first step of a recording is written.
    part
        Number of the part of the recording, from 0; None for the whole recording.
    """

    name: str
    path: str
    store: str
    key: str
    processing: dict[str, Any]
    software: dict[str, str]
    fingerprint: dict[str, tuple[int, int]]
    labels: dict[str, str]
    steps: int
    size: int
    memory: float
    part: int | None = None

    @property
    def growing(self) -> bool:
        """Whether the recording is being made, so that its steps are processed one by one."""
        return not self.fingerprint

    @property
    def settings_key(self) -> str:
        """Hash of settings and software, which is the same before and after a recording is complete."""
        return _hash([self.processing, self.software])

    def completed(self, summary: Summary) -> Unit:
        """Return the unit of the recording when it is complete."""
        return replace(
            self,
            key=_hash([self.processing, self.software, summary.fingerprint]),
            fingerprint=summary.fingerprint,
            steps=summary.steps,
            size=summary.size,
            memory=predicted_memory(summary, self.processing["overrides"]),
        )

    @property
    def parts(self) -> list[Unit]:
        """Units of the parts of the recording, which can be processed beside each other before it; none without them.

        The parts follow from the settings, never from the number of workers.
        """
        count = self.processing["segments"]
        if count == 1 or self.part is not None:
            return []
        return [replace(self, name=f"{self.name}~{part}", part=part) for part in range(count)]

    @property
    def settings(self) -> ProcessingSettings:
        """What the recording is processed with."""
        from fringedic.datasets.processing import ProcessingSettings  # not at the top: a state computes nothing
        from fringedic.rig.model import RigModel

        calibration, reference = self.processing["calibration"], self.processing["reference"]
        return ProcessingSettings(
            overrides=self.processing["overrides"],
            references=() if reference is None else (reference,),
            calibration=RigModel.from_text(calibration) if calibration else None,
            sensor=self.processing.get("sensor"),
            segment=None if self.part is None else (self.part, self.processing["segments"]),
        )

    @property
    def elasticity(self) -> Elasticity:
        """What its elastic constants are computed from."""
        return Elasticity(**self.processing["elasticity"])


@dataclass(frozen=True)
class Plan:
    """Units of a campaign, and what is refused.

    Attributes
    ----------
    title, store
        Title of the campaign, and the address of its store.
    units
        Units of work in the order of their names.
    refused
        Recordings that cannot be processed, each with the reason as one sentence.
    unusual_shapes
        Shape (row, column) of the images of recordings whose images have another one than most.
    """

    title: str
    store: str
    units: tuple[Unit, ...] = ()
    refused: dict[str, str] = field(default_factory=dict)
    unusual_shapes: dict[str, tuple[int, int]] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Number of recordings, those that are refused included."""
        return len(self.units) + len(self.refused)

    def to_document(self) -> dict[str, Any]:
        """Return the plan as JSON values; what units share is there once."""
        document = asdict(self)
        processing: list[dict[str, Any]] = []
        for unit in document["units"]:
            if unit["processing"] not in processing:
                processing.append(unit["processing"])
            unit["processing"] = processing.index(unit["processing"])
            for name in _SHARED:
                document[name] = unit.pop(name)
        return {**document, "processing": processing}

    @classmethod
    def from_document(cls, document: dict[str, Any]) -> Plan:
        """Return what `to_document` returned."""
        shared = {name: document[name] for name in _SHARED if name in document}
        processing = document["processing"]
        units = tuple(
            Unit(
                **{
                    **shared,
                    **each,
                    "fingerprint": _tuples(each["fingerprint"]),
                    # plans of earlier versions have one for all units
                    "processing": processing[each["processing"]] if "processing" in each else processing,
                }
            )
            for each in document["units"]
        )
        own = {each.name: document[each.name] for each in fields(cls) if each.name in document}
        shapes = {name: (rows, columns) for name, (rows, columns) in document["unusual_shapes"].items()}
        return cls(**{**own, "units": units, "unusual_shapes": shapes})


def make_plan(campaign: Campaign, recordings: Iterable[Found], *, follow: bool = False) -> Plan:
    """Make the plan of a campaign; recordings that cannot be processed are listed with the reason.

    Parameters
    ----------
    campaign
        From `fringedic.campaign.settings.load_campaign`.
    recordings
        From `fringedic.campaign.recordings.find_recordings`.
    follow
        Plan recordings without an index as such that are being made, instead of refusing them.
    """
    return plan_of(campaign, ((each, _summary_or_reason(each, campaign, follow)) for each in recordings))


def plan_of(campaign: Campaign, summaries: Iterable[tuple[Found, Summary | str]]) -> Plan:
    """Make the plan of a campaign from the summaries of its recordings, or the reasons why they are refused."""
    software = software_identity()
    units: list[Unit] = []
    refused: dict[str, str] = {}
    shapes: dict[str, tuple[int, int]] = {}
    for found, summary in summaries:
        if isinstance(summary, str):
            refused[found.name] = summary
            continue
        if summary.frames:
            shapes[found.name] = summary.image_shape
        processing = campaign.processing(found.entry)
        if summary.sensors:
            registration = campaign.registration or summary.registration
            processing |= {"sensors": list(summary.sensors), "registration": registration}
        units.append(
            Unit(
                name=found.name,
                path=found.path,
                store=campaign.store,
                key=_hash([processing, software, summary.fingerprint]),
                processing=processing,
                software=software,
                fingerprint=summary.fingerprint,
                labels=found.labels,
                steps=summary.steps,
                size=summary.size,
                memory=predicted_memory(summary, processing["overrides"]) if summary.frames else 0.0,
            )
        )
    usual = Counter(shapes.values()).most_common(1)
    return Plan(
        title=campaign.content.title,
        store=campaign.store,
        units=tuple(units),
        refused=refused,
        unusual_shapes={name: shape for name, shape in shapes.items() if shape != usual[0][0]},
    )


def predicted_memory(summary: Summary, overrides: Mapping[str, Any] | None = None) -> float:
    """Return the memory that a worker needs for a recording [byte], at a spacing of one pixel.

    Its largest parts are the float32 images of a step (maps, their derivatives and the reference), and those of the
    kept steps.

    Parameters
    ----------
    summary
        Of the recording.
    overrides
        Parameters that replace the recorded ones, of which ``kept_steps`` counts.
    """
    from fringedic.steps.parameters import DicParameters

    usual = DicParameters().kept_steps
    kept: list[int] = [(overrides or {}).get(f"{node}.kept_steps", usual) for node in ("dic", "coupling")]
    maps = _MAPS + _MAPS_OF_A_KEPT_STEP * min(max(kept), summary.steps)
    pixels = summary.image_shape[0] * summary.image_shape[1]
    itemsize = 2 if summary.image_type == "uint16" else 1
    return _LIBRARIES + pixels * (4 * maps + _IMAGES * itemsize * summary.frames_per_step)


def _summary_or_reason(found: Found, campaign: Campaign, follow: bool) -> Summary | str:
    from fringedic.campaign.recordings import is_growing, summarise, summarise_growing

    if found.missing:
        return found.missing
    try:
        growing = follow and is_growing(found.path)
        summary = summarise_growing(found.path) if growing else summarise(found.path, campaign.content.sensor)
    except FringedicError as error:
        return str(error)
    except OSError as error:
        return f"{found.path}: cannot be read: {cause_of(error)}"
    given = found.entry.calibration or campaign.content.calibration
    if summary.sensors:
        reason = _reason_against_joining(campaign, summary, bool(given))
        if reason:
            return f"{found.path}: contains the sensors {', '.join(summary.sensors)}: {reason}"
    if not summary.calibrated and not given and summary.frames_per_step > 1:
        return (
            f"{found.path}: contains no calibration of the rig, which fringes need; give one as 'calibration' in the "
            "file of the campaign"
        )
    return summary


def _reason_against_joining(campaign: Campaign, summary: Summary, calibration: bool) -> str:
    """Return why the sensors of a recording cannot be joined, and what to do; empty if they can."""
    if not (campaign.registration or summary.registration):
        return (
            "write one as 'sensor' in the file of the campaign, or as 'registration' the file of 'fringedic register', "
            "which joins them"
        )
    if calibration:
        return "'calibration' is that of one; leave it out, or write one of them as 'sensor'"
    if campaign.content.segments > 1:
        return "the parts of a recording cannot be joined; leave 'segments' out, or write one of them as 'sensor'"
    return ""


def _tuples(fingerprint: dict[str, list[int]]) -> dict[str, tuple[int, int]]:
    return {name: (size, crc) for name, (size, crc) in fingerprint.items()}


def _hash(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
