"""Finds the recordings of a campaign and reads their summaries: index, first image and first exposure record."""

from __future__ import annotations

import glob
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fringedic.campaign.settings import Campaign, Labels, RecordingEntry
from fringedic.errors import CampaignError, RecordingError
from fringedic.frames.messages import image_array
from fringedic.recording.bag_files import METADATA, find_files, recording_of
from fringedic.recording.growing import GrowingRecording
from fringedic.recording.mcap_file import index_bytes
from fringedic.recording.reader import BagReader
from fringedic.recording.remote import RemoteRecording, find_remote, is_remote
from fringedic.recording.topics import EXPOSURE, IMAGE
from fringedic.sensors.recorded import registration_of
from fringedic.signals import attachment_digests
from fringedic.wording.path_names import recording_names


@dataclass(frozen=True)
class Found:
    """A recording of a campaign: its name in the store, its place, and the entry that names it.

    Attributes
    ----------
    name, path
        Of the recording, or of an entry that names none.
    entry
        Of the file of the campaign.
    missing
        Why there is nothing to process; empty for a recording.
    """

    name: str
    path: str
    entry: RecordingEntry
    missing: str = ""

    @property
    def labels(self) -> dict[str, str]:
        """Labels of the catalogue."""
        return self.entry.model_dump(include=set(Labels.model_fields))


@dataclass(frozen=True)
class Summary:
    """What the summary of a recording contains.

    Attributes
    ----------
    fingerprint
        Size [byte] and CRC-32 of the index of each file, by its name: another recording has another one. Empty for one
        that is being made.
    size
        Of all files [byte].
    frames
        Images; of a recording that is being made those of its first step, 0 before it.
    frames_per_step
        Images of the first step.
    image_shape, image_type
        (row, column) and NumPy type of the first image.
    calibrated
        Whether it contains the calibration of its rig.
    sensors
        Names of its sensors, if it contains several and none was chosen; then frames and images are those of one.
    registration
        Text of the registration beside a recording of several sensors; empty without one.
    """

    fingerprint: dict[str, tuple[int, int]]
    size: int
    frames: int
    frames_per_step: int
    image_shape: tuple[int, int]
    image_type: str
    calibrated: bool
    sensors: tuple[str, ...] = ()
    registration: str = ""

    @property
    def steps(self) -> int:
        """Estimated number of steps: exact if all have as many frames as the first one; 0 while it is made."""
        if not self.fingerprint:
            return 0
        return max(1, round(self.frames / max(1, self.frames_per_step)))


def find_recordings(campaign: Campaign) -> list[Found]:
    """Return the recordings of a campaign, sorted by their names in the store; entries without one say why.

    Raises
    ------
    CampaignError
        A recording is named twice.
    """
    entries: dict[str, RecordingEntry] = {}
    missing: dict[str, str] = {}
    for entry in campaign.content.recordings:
        matching = _matching(entry.path, campaign.folder)
        excluded = {pattern: set(_matching(pattern, campaign.folder)) for pattern in entry.exclude}
        found = [path for path in matching if not any(path in left_out for left_out in excluded.values())]
        refused = [
            (pattern, "leaves out none of the entry's recordings ('exclude')")
            for pattern, left_out in excluded.items()
            if matching and left_out.isdisjoint(matching)
        ]
        if not found:
            cause = "'exclude' leaves out all recordings" if matching else "there is no recording"
            refused.append((entry.path, cause))
        for pattern, cause in refused:
            place = pattern if is_remote(pattern) else str(campaign.folder / pattern)
            missing[place] = f"{place}: {cause}; correct the entry in the file of the campaign"
            found.append(place)
        for path in found:
            if path in entries:
                raise CampaignError(
                    f"{path}: is named by two entries of the campaign; remove it from one of them, or add it to the "
                    "'exclude' of one"
                )
            entries[path] = entry
    names = recording_names(entries)
    every = (Found(names[path], path, entry, missing.get(path, "")) for path, entry in entries.items())
    return sorted(every, key=lambda each: each.name)


def _matching(pattern: str, folder: Path) -> list[str]:
    """Return the recordings that a pattern matches, also inside folders."""
    if is_remote(pattern):
        return find_remote(pattern)
    matches = (Path(each) for each in glob.glob(str(folder / pattern), recursive=True))
    # ".." is not the end of a name, and one recording has one path
    places = (match.resolve() if ".." in match.parts else match.absolute() for match in matches)
    return sorted({str(found) for place in places for found in _inside(place)})


def _inside(path: Path) -> Iterator[Path]:
    if path.suffix == ".mcap":
        yield path
    if not path.is_dir():
        return
    recording = recording_of(path)
    if recording != path or (path / METADATA).exists() or any(path.glob("*.mcap")):
        yield recording
        return
    for inner in sorted(path.iterdir()):
        if inner.is_dir():
            yield from _inside(inner)


def fingerprint(path: str) -> dict[str, tuple[int, int]]:
    """Return size and CRC-32 of the index of each file of a recording, and CRC-32 of each attachment.

    Raises
    ------
    RecordingError
        There is no such recording, or a file has no index because its recording was cut off.
    """
    if is_remote(path):
        return {file.name: (file.size, zlib.crc32(file.index)) for file in RemoteRecording(path).files}
    found = {}
    for file in find_files(Path(path)).present:
        index = index_bytes(file)
        if index is None:
            raise RecordingError(
                f"{path}: {file.name} has no index because it is still recorded or was cut off; 'fringedic campaign "
                f"run --follow' processes it while it is recorded, 'fringedic recover {path}' writes a complete one"
            )
        found[file.name] = (file.stat().st_size, zlib.crc32(index))
    for name, digest in attachment_digests(path).items():
        found[f"attached {name}"] = (0, zlib.crc32(digest.encode()))
    return found


def summarise(path: str, sensor: str | None = None) -> Summary:
    """Return the summary of a recording; of its messages the first image and the first exposure record are read.

    Parameters
    ----------
    path, sensor
        The recording, and the name of the sensor, if it contains several.

    Raises
    ------
    RecordingError
        There is no such recording, it is damaged or cut off, has no images or exposure records, or is in an object
        store, contains several sensors and none is chosen.
    """
    if is_remote(path):
        with RemoteRecording(path).copied((IMAGE, EXPOSURE), first=True) as nearby:
            return _summary(path, nearby, sensor)
    return _summary(path, Path(path), sensor)


def _summary(path: str, nearby: Path, sensor: str | None) -> Summary:
    identity, reader = fingerprint(str(nearby)), BagReader(nearby, sensor=sensor)
    several = () if sensor is not None or is_remote(path) else tuple(sorted(reader.sensors))
    if len(several) < 2:
        return _summary_of_sensor(path, reader, identity)
    each = [_summary_of_sensor(path, BagReader(nearby, sensor=name), identity) for name in several]
    largest = max(each, key=lambda one: one.image_shape[0] * one.image_shape[1])
    beside = registration_of(path)
    text = "" if beside is None else beside.read_text("utf-8", errors="replace")
    return replace(largest, calibrated=all(one.calibrated for one in each), sensors=several, registration=text)


def _summary_of_sensor(path: str, reader: BagReader, identity: dict[str, tuple[int, int]]) -> Summary:
    if reader.lost:
        raise RecordingError(f"{path}: {reader.lost}; 'fringedic recover {path}' writes a complete one")
    names = reader.find(IMAGE, EXPOSURE)
    image = _first(reader, names[IMAGE])
    pixels = image_array(image)
    return Summary(
        fingerprint=identity,
        size=sum(size for size, _ in identity.values()),
        frames=reader.counts[names[IMAGE]],
        frames_per_step=int(_first(reader, names[EXPOSURE]).count),
        image_shape=(pixels.shape[0], pixels.shape[1]),
        image_type=np.dtype(pixels.dtype).name,
        calibrated=bool(reader.find_optional("calibration")),
    )


def is_growing(path: str) -> bool:
    """Return whether a recording is being made, or was cut off; objects of an object store are always complete."""
    return not is_remote(path) and not GrowingRecording(Path(path)).is_complete()


def summarise_growing(path: str) -> Summary:
    """Return what is known of a recording that is being made."""
    recording = GrowingRecording(Path(path))
    image, exposure = recording.first(IMAGE), recording.first(EXPOSURE)
    pixels = np.empty((0, 0), np.uint8) if image is None or exposure is None else image_array(image)
    return Summary(
        fingerprint={},
        size=recording.size,
        frames=int(exposure.count) if pixels.size else 0,
        frames_per_step=int(exposure.count) if pixels.size else 0,
        image_shape=(pixels.shape[0], pixels.shape[1]),
        image_type=np.dtype(pixels.dtype).name,
        calibrated=not pixels.size or recording.first("calibration") is not None,
    )


def _first(reader: BagReader, topic: str) -> Any:
    _, message, _ = next(reader.messages([topic]))
    return message
