"""Motion of a specimen in the image while the crosshead moves, as known before the test."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fringedic.configuration.forecast import frame_interval
from fringedic.configuration.rig_file import RigFile

_SIDES = 21  # points along each side of the field
_STEP = 1e-5  # [m] along y, for the derivative of the phase


@dataclass(frozen=True)
class CrossheadMotion:
    """Motion from frame to frame of a point that moves with the crosshead, along y of the rig.

    Attributes
    ----------
    fringes
        Across the finest fringes, the largest of the field [fringes].
    pixels
        In the image [px].
    in_stack
        During all frames of a stack, part of the height of the image.
    """

    fringes: float
    pixels: float
    in_stack: float


def crosshead_motion(rig: RigFile, speed: float) -> CrossheadMotion | None:
    """Return the motion in the image at a speed of the crosshead; None where calibration or exposure are not known.

    Parameters
    ----------
    rig
        With a sequence for a surface in motion.
    speed
        [m/s].

    Examples
    --------
    Vertical fringes on a specimen that is pulled along them, 160x120 px:

    >>> virtual = {"preset": "plate", "size": "tiny"}
    >>> rig = RigFile.model_validate({"camera": {"source": "virtual"}, "projector": {"source": "virtual"},
    ...                               "virtual_rig": virtual, "calibration": "virtual_rig"})
    >>> motion = crosshead_motion(rig, 1e-3)
    >>> round(motion.fringes, 2), round(motion.pixels, 2)
    (0.0, 0.21)
    """
    model, interval = rig.rig_model, frame_interval(rig)
    patterns = rig.moving_patterns()
    if model is None or not patterns or math.isnan(interval):
        return None
    half_width, half_height = (model.pixel_size * each / 2 for each in (model.camera_width, model.camera_height))
    x, y = np.meshgrid(np.linspace(-half_width, half_width, _SIDES), np.linspace(-half_height, half_height, _SIDES))
    finest = patterns[-1]
    ahead, behind = (model.phase(x, y + step, 0.0, finest.pitch, finest.orientation) for step in (_STEP, -_STEP))
    along = float(np.abs(ahead - behind).max()) / (2 * _STEP)  # [rad/m]
    way = speed * interval
    return CrossheadMotion(
        fringes=along * way / (2 * math.pi),
        pixels=way / model.pixel_size,
        in_stack=len(patterns) * way / (2 * half_height),
    )
