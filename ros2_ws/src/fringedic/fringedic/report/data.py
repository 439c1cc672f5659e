"""The data of an experiment's report: its dataset, and what the frames of its recording show."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr

from fringedic.datasets.attributes import image_size, recorded_metadata
from fringedic.frames.messages import image_array
from fringedic.frames.records import FrameRecord, stamp_of
from fringedic.metadata import Metadata
from fringedic.patterns.pattern import PatternKind, moving_frames
from fringedic.recording.frames import records, with_losses
from fringedic.recording.reader import BagReader
from fringedic.rig_setup.advice import Advice
from fringedic.steps.recorded_parameters import present_parameters


@dataclass(frozen=True)
class ReportData:
    """Everything that a report is written from.

    Attributes
    ----------
    dataset
        The experiment, from `fringedic.open_experiment`.
    exposures
        From the recording, None without one.
    advice
        Figures of the texture from images at rest, None without them.
    """

    dataset: xr.Dataset
    exposures: Exposures | None
    advice: Advice | None

    def attribute(self, name: str) -> Any:
        """Return an attribute of the dataset, unpacked from JSON; an empty dict if it is missing."""
        return json.loads(self.dataset.attrs.get(name, "{}"))

    @cached_property
    def metadata(self) -> Metadata:
        """Specimen, hardware, calibration and noise floor as entered and recorded."""
        return recorded_metadata(self.dataset)

    @cached_property
    def calibration(self) -> dict[str, Any]:
        """Parameters of the rig's model in SI units; empty without a calibration."""
        return dict(self.attribute("calibration"))

    @cached_property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """Parameters of the processing nodes at the last step, by node."""
        recorded = self.attribute("parameters")
        return dict(recorded[-1]["parameters"]) if recorded else {}

    @cached_property
    def camera(self) -> dict[str, Any]:
        """Parameters of the camera node."""
        return present_parameters("camera", self.attribute("rig").get("camera", {}))

    @property
    def section(self) -> float | None:
        """Area that carries the force [m²], None if it is not known."""
        square_millimetres = self.metadata.specimen.section_mm2
        return None if square_millimetres is None else 1e-6 * square_millimetres

    @property
    def images_alone(self) -> bool:
        """Whether the dataset is that of a series of images without a rig."""
        return "image" in self.dataset

    @property
    def image_size(self) -> tuple[int, int] | None:
        """Width and height of the camera's images [px], None if they are not known."""
        return image_size(self.dataset)

    @property
    def pixel_size(self) -> float | None:
        """Size of a pixel on the specimen [m], None without a scale."""
        size = self.calibration.get("pixel_size", self.dataset.attrs.get("pixel_size"))
        return None if size is None else float(size)

    @property
    def simulated(self) -> bool:
        """Whether a virtual rig replaced camera and projector."""
        return self.camera.get("source") == "virtual"

    def length(self, pixels: float) -> str:
        """Return a length on the surface in brackets, for a text that follows pixels; empty without a scale."""
        return "" if self.pixel_size is None else f" ({1e3 * self.pixel_size * pixels:.3g} mm)"


PHASE_TEXTURE = "phase/texture"


@dataclass(frozen=True)
class Exposures:
    """The exposures of an experiment.

    Attributes
    ----------
    frames
        Frames of one step.
    exposure_time
        Median [s].
    frame_rate
        Within a step [1/s], from the median distance of the stamps.
    dropped
        Frames that the camera lost.
    pitches, shifts
        Fringe pitches, coarse to fine [projector px], and frames of each.
    orientation
        Direction of the fringes: ``vertical`` or ``horizontal``.
    moving
        Numbers of the steps that were measured in motion.
    """

    frames: int
    exposure_time: float
    frame_rate: float
    dropped: int
    pitches: tuple[float, ...]
    shifts: tuple[int, ...]
    orientation: str
    moving: tuple[int, ...] = ()


def read_exposures(recording: BagReader, experiment: str) -> Exposures | None:
    """Return the exposures of an experiment, None if the recording contains none."""
    steps: defaultdict[int, list[FrameRecord]] = defaultdict(list)
    dropped = 0
    for record, lost in with_losses(records(recording, experiment)):
        dropped += lost if steps else 0  # those before the first frame belong to no step
        steps[record.step].append(record)
    if not steps:
        return None
    exposed = [record for step in steps.values() for record in step]
    longest = max(steps.values(), key=len)
    fringes = Counter(record.pattern.pitch for record in longest if record.pattern.kind == PatternKind.FRINGES)
    pitches = tuple(sorted(fringes, reverse=True))
    return Exposures(
        frames=len(longest),
        exposure_time=float(np.median([record.exposure_time for record in exposed])),
        frame_rate=_frame_rate(steps.values()),
        dropped=dropped,
        pitches=pitches,
        shifts=tuple(fringes[pitch] for pitch in pitches),
        orientation=longest[0].pattern.orientation.name.lower(),
        moving=tuple(step for step, frames in steps.items() if moving_frames([each.pattern for each in frames])),
    )


def _frame_rate(steps: Iterable[Sequence[FrameRecord]]) -> float:
    """Return the frames per second within a step, NaN for steps of one frame."""
    distances = [np.diff([record.stamp for record in step]) for step in steps if len(step) > 1]
    return 1e9 / float(np.median(np.concatenate(distances))) if distances else float("nan")


def read_textures(recording: BagReader, stamps: Sequence[int]) -> list[np.ndarray]:
    """Return the recorded textures with these stamps [ns] in their order; empty unless all are recorded."""
    found = {}
    for _, message, _ in recording.messages(recording.find_optional(PHASE_TEXTURE).values()):
        if stamp_of(message) in stamps:
            found[stamp_of(message)] = image_array(message)
    return [found[stamp] for stamp in stamps] if len(found) == len(set(stamps)) else []
