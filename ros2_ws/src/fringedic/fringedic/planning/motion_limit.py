"""The fastest motion that a planned rig can measure without a hold."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fringedic.configuration.forecast import FRAME_TIME
from fringedic.planning.plan_warnings import fringe_period
from fringedic.planning.planned_rig import PlannedRig


@dataclass(frozen=True)
class MotionLimit:
    """The fastest motion of the surface across the fringes, in the directions of `SequenceSettings.motion_range`.

    Attributes
    ----------
    per_frame
        From frame to frame [camera px].
    speed
        On the reference plane [m/s]; NaN where the exposure time is not known.
    frame_rate
        Expected frames per second [1/s]; NaN with the speed.
    contrast
        Part of the modulation that the blur by this motion leaves; NaN with the speed.
    condition
        Largest condition number of the fit of the phase up to this motion.
    """

    per_frame: float
    speed: float
    frame_rate: float
    contrast: float
    condition: float


def motion_limit(planned: PlannedRig) -> MotionLimit:
    """Return the fastest motion that the shifts of a stack in motion can follow.

    Parameters
    ----------
    planned
        The rig. Pattern, exposure and image of a frame are expected to take 22 ms beside exposure and settle time.

    Examples
    --------
    >>> from fringedic.configuration.rig_file import RigFile
    >>> virtual = {"preset": "plate", "size": "small"}
    >>> camera = {"source": "virtual", "exposure_ms": 10.0}
    >>> rig = {"camera": camera, "projector": {"source": "virtual"}, "virtual_rig": virtual}
    >>> limit = motion_limit(PlannedRig.of(RigFile.model_validate(rig)))
    >>> round(limit.per_frame, 2), limit.contrast > 0.99, limit.condition < 3
    (2.45, True, True)
    """
    fringes = planned.sequence.fastest_motion
    per_frame = fringes * fringe_period(planned)
    interval = FRAME_TIME + planned.exposure_time + planned.settle_time
    return MotionLimit(
        per_frame=per_frame,
        speed=per_frame * planned.model.pixel_size / interval,
        frame_rate=1 / interval,
        contrast=float(np.sinc(fringes * planned.exposure_time / interval)),
        condition=planned.sequence.moving_plan().condition,
    )
