"""The rig of a recording, for the check of a calibration that it is to be processed with."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, PositiveInt, ValidationError

from fringedic.errors import ErrorCode, RecordingError
from fringedic.frames.records import FrameRecord
from fringedic.patterns.pattern import PHASE_KINDS, ProjectedPattern
from fringedic.recording.frames import records
from fringedic.recording.reader import BagReader
from fringedic.recording.topics import IMAGE
from fringedic.rig.compatibility import RigSetup
from fringedic.rig.geometry import UNKNOWN_FIRST
from fringedic.steps.recorded_parameters import MODELS, RecordedParameters
from fringedic.steps.recorded_references import is_reference_known

EXPERIMENT = "experiment"  # node that records the metadata, with sign and tare of the force


class RecordedSizes(BaseModel):
    """Sizes of the rig among the recorded parameters of the experiment node; older recordings have none [px].

    Examples
    --------
    >>> RecordedSizes.of({"experiment": {"camera_first_column_px": 64, "camera_first_row_px": 32}}).camera_first
    (64, 32)
    """

    model_config = ConfigDict(frozen=True, strict=True)

    projector_width_px: PositiveInt | None = None
    projector_height_px: PositiveInt | None = None
    camera_first_column_px: int = UNKNOWN_FIRST[0]
    camera_first_row_px: int = UNKNOWN_FIRST[1]

    @classmethod
    def of(cls, rig: Mapping[str, Mapping[str, Any]]) -> Self:
        """Return the sizes in recorded parameters, by node.

        Raises
        ------
        RecordingError
            One of them is no number of pixels; the message names it.
        """
        try:
            return cls.model_validate(rig.get(EXPERIMENT, {}))
        except ValidationError as error:
            first = error.errors()[0]
            raise RecordingError(
                f"the recorded {first['loc'][0]} of the experiment node is {str(first['input'])[:40]!r}, which is no "
                "number of pixels; use another recording"
            ) from error

    @property
    def projector_size(self) -> tuple[int, int] | None:
        """(width, height) of the projector's image; None when not recorded."""
        width, height = self.projector_width_px, self.projector_height_px
        return None if width is None or height is None else (width, height)

    @property
    def camera_first(self) -> tuple[int, int]:
        """(column, row) of the sensor with which the images begin; -1 when not recorded."""
        return self.camera_first_column_px, self.camera_first_row_px


def recorded_setup(bag: BagReader) -> RigSetup:
    """Return the rig of a recording as far as it is known.

    Parameters
    ----------
    bag
        The recording.

    Returns
    -------
    RigSetup
        The size of the first image, where it begins on the sensor, the recorded size of the projector, and the patterns
        of the first fringe step; no patterns where the recorded parameters accept a relative phase.

    Raises
    ------
    RecordingError
        The recording is damaged, or a recorded size is none.
    """
    image = next(_messages(bag, IMAGE), None)
    parameters = RecordedParameters({})
    for message in _messages(bag, "node_parameters"):
        parameters.take(message)
    sizes = RecordedSizes.of(parameters.settings(None).rig)
    shown = _first_fringe_step(bag)
    return RigSetup(
        camera_size=None if image is None else (image.width, image.height),
        projector_size=sizes.projector_size if shown else None,
        camera_first=sizes.camera_first,
        sensor=next((each.sensor for each in records(bag)), None),
        patterns=shown if parameters.phase.relative_phase == "refuse" else (),
    )


def require_calibration(bag: BagReader) -> None:
    """Raise an error for a recording of fringes without the rig's calibration.

    Parameters
    ----------
    bag
        The recording.

    Raises
    ------
    RecordingError
        With the code NO_CALIBRATION: it contains fringes and no calibration. Without code: it is damaged.
    """
    if not bag.find_optional("calibration") and any(each.pattern.kind in PHASE_KINDS for each in records(bag)):
        raise RecordingError(
            f"{bag.path} contains no calibration of the rig, which fringes need: give one with --calibration FILE",
            code=ErrorCode.NO_CALIBRATION,
        )


def require_reference(bag: BagReader) -> None:
    """Raise an error for a recording in which the reference of the first frames is not known.

    Parameters
    ----------
    bag
        The recording.

    Raises
    ------
    RecordingError
        No reference step was announced before the first frame: the first file of the recording is missing.
    """
    if is_reference_known(bag):
        return
    raise RecordingError(
        f"{bag.path}: which step is the reference of the first frames is not recorded (experiment/reference); put "
        "all files of the recording into its folder, or give it: --reference STEP"
    )


def missing_settings(bag: BagReader, exposed: Iterable[FrameRecord]) -> list[str]:
    """Return the nodes whose settings a recording should contain and does not: it was split or filtered.

    Parameters
    ----------
    bag, exposed
        The recording and its exposure records.

    Raises
    ------
    RecordingError
        The recording is damaged.
    """
    fringes = any(each.pattern.kind in PHASE_KINDS for each in exposed)
    recorded = {each.node for each in _messages(bag, "node_parameters")}
    return [node for node in (*MODELS, EXPERIMENT) if node not in recorded and (fringes or node in ("dic", EXPERIMENT))]


def _first_fringe_step(bag: BagReader) -> list[ProjectedPattern]:
    fringes = (each for each in records(bag) if each.pattern.kind in PHASE_KINDS)
    steps = groupby(fringes, key=lambda each: (each.experiment, each.step))
    return next(([each.pattern for each in step] for _, step in steps), [])


def _messages(bag: BagReader, name: str) -> Iterator[Any]:
    return (message for _, message, _ in bag.messages(bag.find_optional(name).values()))
