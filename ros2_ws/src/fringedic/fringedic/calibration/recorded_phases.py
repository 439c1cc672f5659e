"""Phase maps that the nodes of a rig recorded, for measurements on planes and artefacts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import xarray as xr

from fringedic.errors import RecordingError
from fringedic.frames.messages import image_array
from fringedic.frames.records import stamp_of
from fringedic.recording.reader import BagReader


def recorded_phases(bag: Path, stamps: Sequence[int]) -> list[xr.Dataset]:
    """Return the phase map of each stamp with its own sigma.

    Raises
    ------
    RecordingError
        The recording has no map of a stamp.
    """
    reader = BagReader(bag)
    names = {full: name for name, full in reader.find("phase/map", "phase/sigma").items()}
    images = {(names[topic], stamp_of(each)): image_array(each) for topic, each, _ in reader.messages(names)}
    over = ("row", "column")
    for number, stamp in enumerate(stamps, start=1):
        for name in ("phase/map", "phase/sigma"):
            if (name, stamp) not in images:
                raise RecordingError(f"{bag} has no message of {name} of plane {number}: measure the planes again")
    return [
        xr.Dataset({"phase": (over, images["phase/map", stamp]), "sigma": (over, images["phase/sigma", stamp])})
        for stamp in stamps
    ]
