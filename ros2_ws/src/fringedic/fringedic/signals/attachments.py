"""Attachments: signals of a file of another program beside a recording, on the clock of the rig.

The folder ``bag_attached`` beside the recording ``bag`` contains a copy of each file, and its description with the
SHA-256 of the file, its structure and its clock. The recording is not changed.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

from fringedic.errors import RecordingError
from fringedic.evidence.changes import noted
from fringedic.recording.bag_files import beside
from fringedic.recording.manifest import checksum, write_whole
from fringedic.recording.reader import BagReader
from fringedic.signals.alignment import Alignment, ClockFit, align_clocks
from fringedic.signals.exports.layout import RECOGNISED, ExportLayout, ExportOptions, recognise
from fringedic.signals.exports.reading import read_export
from fringedic.signals.exports.times import is_absolute
from fringedic.signals.messages import SIGNAL_TOPICS, signals_of
from fringedic.signals.signal import FORCE, POSITION, Signal
from fringedic.wording.causes import cause_of
from fringedic.wording.yaml_text import load_foreign_yaml

_DESCRIPTION = ".attachment.yaml"
PICTURE = ".clock.png"
GIVEN = "given"
_NAME = re.compile(r"[\w][\w .+-]{0,99}")
_LARGEST = 2_000_000_000  # byte of a file
_SHORTEST_S = 1e-9


class AttachedClock(BaseModel):
    """The clock of a file as its description contains it; see `ClockFit`.

    `by` is the signal that it was fitted to, or ``given``. A file without dates counts from the first message of the
    recording.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    by: str
    offset: float
    drift: float
    since: int
    sigma_offset: float
    sigma_drift: float
    correlation: float = 0.0

    @property
    def fit(self) -> ClockFit:
        """The clock, to be applied to signals."""
        return ClockFit(**self.model_dump(exclude={"by"}))


class Attachment(BaseModel):
    """Description of an attached file.

    Attributes
    ----------
    version
        Of the description.
    source, sha256
        Name of the file, and SHA-256 of its content.
    layout, clock
        Its structure and its clock.
    sigmas
        Standard uncertainties of its signals in their units, by their names, as they were given.
    instead
        Whether its signals replace recorded ones of the same name.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    version: Literal[1] = 1
    source: str
    sha256: str
    layout: ExportLayout
    clock: AttachedClock
    sigmas: dict[str, float] = {}
    instead: bool = False


@dataclass(frozen=True)
class Attached:
    """An attachment and what was found while it was made.

    Attributes
    ----------
    name
        Of the attachment.
    attachment
        Its description.
    alignment
        Fit of the clock; None if it was given.
    signals
        Its signals on the clock of the rig.
    refused
        Signals that both have and that did not fix the clock, with the reason.
    """

    name: str
    attachment: Attachment
    alignment: Alignment | None
    signals: Mapping[str, Signal]
    refused: Mapping[str, str] = field(default_factory=dict)


def attachment_folder(recording: str | os.PathLike[str]) -> Path:
    """Return the folder with the attachments of a recording, which need not exist.

    Examples
    --------
    >>> attachment_folder("/recordings/plate-7/bag").as_posix()
    '/recordings/plate-7/bag_attached'
    """
    return beside(Path(recording), "_attached")


def attachment_names(recording: str | os.PathLike[str]) -> list[str]:
    """Return the names of the attachments of a recording."""
    folder = attachment_folder(recording)
    return sorted(path.name.removesuffix(_DESCRIPTION) for path in folder.glob(f"*{_DESCRIPTION}"))


def attachment_digests(recording: str | os.PathLike[str]) -> dict[str, str]:
    """Return the SHA-256 of the descriptions of the attachments of a recording, which contain those of the files."""
    folder = attachment_folder(recording)
    return {name: checksum(folder / f"{name}{_DESCRIPTION}") for name in attachment_names(recording)}


def read_attachment(recording: str | os.PathLike[str], name: str) -> Attached:
    """Read an attachment, with its signals on the clock of the rig.

    Raises
    ------
    RecordingError
        There is none of this name, or its file was changed.
    """
    folder = attachment_folder(recording)
    try:
        content = load_foreign_yaml((folder / f"{name}{_DESCRIPTION}").read_text("utf-8"))
        attachment = Attachment.model_validate(content)
        data = (folder / name).read_bytes()
    except (OSError, UnicodeDecodeError, yaml.YAMLError, ValidationError) as error:
        cause = cause_of(error) if not isinstance(error, ValidationError) else "its description is damaged"
        present = ", ".join(attachment_names(recording)) or "none"
        raise RecordingError(
            f"{folder / name}: cannot be read: {cause}; the recording has the attachments {present}; attach the file "
            "again, or remove it (fringedic attach --remove)"
        ) from error
    if hashlib.sha256(data).hexdigest() != attachment.sha256:
        raise RecordingError(
            f"{folder / name}: was changed since it was attached; attach the original file again (--overwrite)"
        )
    signals = _signals(data, attachment.layout, name, _origin(recording))
    signals = {each: _with_sigma(signal, attachment) for each, signal in signals.items()}
    return Attached(name, attachment, None, signals)


def _signals(data: bytes, layout: ExportLayout, name: str, origin: int) -> dict[str, Signal]:
    """Return the signals on the clock of the file; one without dates counts from the begin of the recording."""
    signals = read_export(data, layout, _source_of(name))
    first = next(iter(signals.values())).stamps
    if is_absolute(first):
        return signals
    return {each: replace(signal, stamps=signal.stamps + origin) for each, signal in signals.items()}


def _source_of(name: str) -> str:
    return re.sub(r"\W+", "_", Path(name).stem).strip("_") or "file"


def _origin(recording: str | os.PathLike[str]) -> int:
    """Return the log time of the first message of a recording [ns]."""
    return BagReader(Path(recording), sensor=_any_sensor(recording)).start_time


def _any_sensor(recording: str | os.PathLike[str]) -> str | None:
    """Return a sensor of a recording: the signals of the rig belong to each of them."""
    return next(iter(BagReader(Path(recording)).sensors), None)


def _with_sigma(signal: Signal, attachment: Attachment) -> Signal:
    """Return a signal on the clock of the rig; the uncertainty of the clock adds to that of its values."""
    known = attachment.sigmas.get(signal.channel.name, np.nan)
    fit = attachment.clock.fit
    measured = np.isfinite(signal.values)
    stamps, values = signal.stamps[measured], signal.values[measured]
    slope = np.zeros(values.size)
    if values.size > 1:
        slope = np.gradient(values) / np.maximum(np.gradient(1e-9 * (stamps - stamps[0])), _SHORTEST_S)
    sigmas = np.full(signal.values.size, np.nan)
    sigmas[measured] = np.hypot(known, slope * fit.sigma_at(stamps))
    return fit.applied_to(replace(signal, sigmas=sigmas))


def with_attachments(recorded: Mapping[str, Signal], recording: str | os.PathLike[str]) -> dict[str, Signal]:
    """Return the signals of a recording with those of its attachments.

    Attachments of parts of one file, such as those before and after a jump of its clock, are joined. A signal whose
    name is taken by one with samples is called ``name_source``, unless its attachment replaces recorded signals.

    Raises
    ------
    RecordingError
        An attachment cannot be read or was changed.
    """
    parts: dict[tuple[str, str], list[Signal]] = {}
    instead: set[tuple[str, str]] = set()
    for each in attachment_names(recording):
        attached = read_attachment(recording, each)
        for name, signal in attached.signals.items():
            key = attached.attachment.sha256, name
            parts.setdefault(key, []).append(signal)
            instead |= {key} if attached.attachment.instead else set()
    signals = dict(recorded)
    for key, found in parts.items():
        joined = _joined(found)
        name = key[1]
        while name in signals and signals[name].stamps.size and key not in instead:
            name += f"_{joined.channel.source}"
        signals[name] = replace(joined, channel=joined.channel._replace(name=name))
    return signals


def _joined(parts: list[Signal]) -> Signal:
    """Return the samples of parts in the order of their stamps, with the channel of the first part."""
    stamps, values, sigmas = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("stamps", "values", "sigmas")
    )
    order = np.argsort(stamps, kind="stable")
    return Signal(parts[0].channel, stamps[order], values[order], sigmas[order])


def attach(  # noqa: PLR0913 (options of a public function, all by keyword)
    recording: str | os.PathLike[str],
    file: str | os.PathLike[str],
    *,
    name: str | None = None,
    options: ExportOptions = RECOGNISED,
    by: str | None = None,
    offset: tuple[float, float] | None = None,
    sigmas: Mapping[str, float] | None = None,
    instead: bool = False,
    overwrite: bool = False,
) -> Attached:
    """Attach the export of a testing machine or a logger to a recording.

    The clock of the file is fitted with each signal that both have; the one with the smallest uncertainty counts. A
    copy of the file and its description are written beside the recording, which stays as it is; the log of a run
    contains the change.

    Parameters
    ----------
    recording
        The recording.
    file
        The export.
    name
        Name of the attachment, that of the file by default.
    options
        What is told of the structure of the file.
    by
        Name of the signal that fixes the clock; all that both have by default.
    offset
        Clock of the file minus that of the rig, and its standard uncertainty [s], instead of a fit. A file without
        dates counts from the first message of the recording.
    sigmas
        Standard uncertainties of signals in SI units, by their names.
    instead
        The signals replace recorded ones of the same name, such as the force of the load frame.
    overwrite
        Replace an attachment of this name.

    Returns
    -------
    Attached
        With the fit of the clock.

    Raises
    ------
    RecordingError
        The file cannot be read; its clock cannot be fixed or jumped; or an attachment of this name exists.

    Examples
    --------
    >>> attach("recordings/plate-7/bag", "machine.csv", offset=(0.0, 0.1)).signals  # doctest: +SKIP
    """
    path, chosen = Path(file), name or Path(file).name
    if not _NAME.fullmatch(chosen) or chosen.endswith(_DESCRIPTION):
        raise RecordingError(
            f"{chosen}: is no name of an attachment; give one of letters and digits (--name machine.csv)"
        )
    folder = attachment_folder(recording)
    if (folder / f"{chosen}{_DESCRIPTION}").exists() and not overwrite:
        raise RecordingError(f"{folder / chosen}: exists already; replace it with --overwrite, or give another --name")
    data = _content(path)
    try:
        layout = recognise(data, options)
        signals = _signals(data, layout, chosen, _origin(recording))
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from error
    unknown = set(sigmas or {}) - signals.keys()
    if unknown:
        raise RecordingError(f"--sigma {min(unknown)}: the file has only {', '.join(signals)}")
    recorded = recorded_signals(recording)
    refused: dict[str, str] = {}
    if offset is not None:
        since = int(next(iter(signals.values())).stamps[0])
        clock, alignment = (
            AttachedClock(by=GIVEN, offset=offset[0], drift=0.0, since=since, sigma_offset=offset[1], sigma_drift=0.0),
            None,
        )
    else:
        used, alignment, refused = _best_alignment(path, recorded, signals, by)
        clock = AttachedClock(by=used, **asdict(alignment.clock))
    attachment = Attachment(
        source=path.name,
        sha256=hashlib.sha256(data).hexdigest(),
        layout=layout,
        clock=clock,
        sigmas=dict(sigmas or {}),
        instead=instead,
    )
    details = {"attachments": {chosen: attachment.model_dump(mode="json", exclude={"layout"})}}
    with noted(folder, "attach", details=details):
        folder.mkdir(exist_ok=True)
        (folder / f"{chosen}{PICTURE}").unlink(missing_ok=True)
        write_whole(folder / chosen, data)
        content = yaml.safe_dump(attachment.model_dump(mode="json"), sort_keys=False, allow_unicode=True)
        write_whole(folder / f"{chosen}{_DESCRIPTION}", content)
    return replace(read_attachment(recording, chosen), alignment=alignment, refused=refused)


def remove_attachment(recording: str | os.PathLike[str], name: str) -> None:
    """Remove an attachment; the log of a run contains the change.

    Raises
    ------
    RecordingError
        There is none of this name.
    """
    folder = attachment_folder(recording)
    if name not in attachment_names(recording):
        present = ", ".join(attachment_names(recording)) or "none"
        raise RecordingError(f"{folder}: has no attachment '{name}', only {present}")
    with noted(folder, "remove attachment", details={"removed": name}):
        for ending in ("", PICTURE, _DESCRIPTION):
            (folder / f"{name}{ending}").unlink(missing_ok=True)
        if not any(folder.iterdir()):
            folder.rmdir()


def recorded_signals(recording: str | os.PathLike[str]) -> dict[str, Signal]:
    """Return the signals of a recording by their names."""
    reader = BagReader(Path(recording), sensor=_any_sensor(recording))
    names = reader.find_optional(*SIGNAL_TOPICS)

    def messages() -> Iterator[tuple[str, object]]:
        for topic in SIGNAL_TOPICS:
            for _, message, _ in reader.messages([names[topic]] if topic in names else []):
                yield topic, message

    return signals_of(messages())


def _content(path: Path) -> bytes:
    try:
        if path.stat().st_size > _LARGEST:
            raise RecordingError(f"{path}: is larger than 2 GB; export fewer channels, or part of the time")
        return path.read_bytes()
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {cause_of(error)}") from error


def _best_alignment(
    path: Path, recorded: Mapping[str, Signal], signals: Mapping[str, Signal], by: str | None
) -> tuple[str, Alignment, dict[str, str]]:
    """Return the fit with the smallest uncertainty, the signal that it used, and those that fix no clock."""
    common = [
        name
        for name in dict.fromkeys([FORCE.name, POSITION.name, *signals])
        if name in signals
        and name in recorded
        and recorded[name].stamps.size
        and recorded[name].channel.unit == signals[name].channel.unit
    ]
    wanted = common if by is None else [name for name in common if name == by]
    if not wanted:
        have = _names(name for name, each in recorded.items() if each.stamps.size)
        missing = "that both have" if by is None else f"'{by}' in both"
        raise RecordingError(
            f"{path}: no signal {missing} can fix its clock; the recording has {have}, the file {_names(signals)}; "
            "name a column (--columns Load=force), or give the offset (--offset)"
        )
    found: dict[str, Alignment] = {}
    refused: dict[str, str] = {}
    for name in wanted:
        try:
            found[name] = align_clocks(recorded[name], signals[name])
        except RecordingError as error:
            refused[name] = str(error)
    if not found:
        raise RecordingError(f"{path}: {'; '.join(refused.values())}")
    used = min(found, key=lambda name: found[name].clock.sigma_offset)
    return used, found[used], refused


def _names(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"
