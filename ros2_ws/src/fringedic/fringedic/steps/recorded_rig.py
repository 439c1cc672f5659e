"""The rig of a recording, for the check of a calibration that it is to be processed with."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import groupby
from typing import Any

from fringedic.errors import ErrorCode, RecordingError
from fringedic.patterns.pattern import PHASE_KINDS, ProjectedPattern
from fringedic.recording.frames import IMAGE, records
from fringedic.recording.reader import BagReader
from fringedic.rig.compatibility import RigSetup
from fringedic.steps.recorded_parameters import RecordedParameters


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
        The recording is damaged.
    """
    image = next(_messages(bag, IMAGE), None)
    parameters = RecordedParameters({})
    for message in _messages(bag, "node_parameters"):
        parameters.take(message)
    experiment = parameters.settings(None).rig.get("experiment", {})
    width, height = (experiment.get(f"projector_{name}_px") for name in ("width", "height"))
    shown = _first_fringe_step(bag)
    return RigSetup(
        camera_size=None if image is None else (image.width, image.height),
        projector_size=(width, height) if shown and width and height else None,
        camera_first=recorded_first(experiment),
        patterns=shown if parameters.phase.relative_phase == "refuse" else (),
    )


def recorded_first(experiment: Mapping[str, Any]) -> tuple[int, int]:
    """Return the (column, row) of the sensor with which the images begin [px].

    Parameters
    ----------
    experiment
        Recorded parameters of the experiment node.

    Returns
    -------
    tuple
        -1 when they are not known, as in older recordings.

    Examples
    --------
    >>> recorded_first({"camera_first_column_px": 64, "camera_first_row_px": 32}), recorded_first({})
    ((64, 32), (-1, -1))
    """
    column, row = (experiment.get(f"camera_first_{name}_px", -1) for name in ("column", "row"))
    return column, row


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


def _first_fringe_step(bag: BagReader) -> list[ProjectedPattern]:
    fringes = (each for each in records(bag) if each.pattern.kind in PHASE_KINDS)
    steps = groupby(fringes, key=lambda each: (each.experiment, each.step))
    return next(([each.pattern for each in step] for _, step in steps), [])


def _messages(bag: BagReader, name: str) -> Iterator[Any]:
    return (message for _, message, _ in bag.messages(bag.find_optional(name).values()))
