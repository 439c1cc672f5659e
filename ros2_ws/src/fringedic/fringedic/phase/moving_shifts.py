"""Choice of the shifts for a motion: number, direction and order of the shifted fringes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fringedic.errors import ErrorCode, PhaseError
from fringedic.phase.moving_model import LARGEST_CONDITION, Shown, condition_number
from fringedic.wording.arguments import check_arguments, number, several, whole

_TURN = 2 * np.pi
_TRIALS = 9  # of the drift over its range


@dataclass(frozen=True)
class ShiftPlan:
    """Shifts of the finest pitch for a motion.

    Attributes
    ----------
    order
        Shift k of each frame, from 1 to ``shifts``.
    shifts
        q: parts of a fringe.
    condition
        Largest condition number of the fit over the range of drifts.
    noise
        Standard deviation of the phase over that of the same number of frames at rest, at the worst drift.
    follows
        Whether the shifts follow the motion so closely that points are lost.
    """

    order: tuple[int, ...]
    shifts: int
    condition: float
    noise: float
    follows: bool


@check_arguments(
    PhaseError,
    drift=number(),
    frames=whole(low=5, high=200),
    uncertainty=number(low=0.0),
    shifts=several(whole(low=3, high=200)),
)
def plan_shifts(
    drift: float, frames: int, *, uncertainty: float = 0.0, shifts: Sequence[int] = (), reversible: bool = True
) -> ShiftPlan:
    """Return the shifts with which the phase of a moving surface is least noisy.

    A fringe that drifts by omega and is shifted by delta per frame advances by omega - delta in the frames of a
    material point. Where that is near 0 or near half a turn, phase and brightness cannot be told apart. Shifted against
    the motion, fringes are measured as well as at rest.

    Parameters
    ----------
    drift
        omega of the fringes at a material point [rad/frame] at the finest pitch: 2 pi / p times the speed in the image
        [px/frame], p the period of the fringes in the image [px], positive where the phase grows.
    frames
        Number of frames of the finest pitch.
    uncertainty
        Of the drift [rad/frame]: its range on either side.
    shifts
        Numbers q that are allowed; by default all of 3 or more that divide the number of frames.
    reversible
        Whether the fringes may be shifted the other way; otherwise the choice is among the numbers only.

    Raises
    ------
    PhaseError
        No number of shifts divides the number of frames.

    Examples
    --------
    A motion that shifts of 1/8 fringe would follow, 1.5 px/frame on fringes of 12 px:

    >>> plan = plan_shifts(2 * np.pi * 1.5 / 12, 8, shifts=[8])
    >>> plan.order, plan.follows
    ((7, 6, 5, 4, 3, 2, 1, 8), False)
    >>> plan_shifts(2 * np.pi * 1.5 / 12, 8, shifts=[8], reversible=False).follows
    True
    """
    allowed = [q for q in (shifts or range(3, frames + 1)) if frames % q == 0]
    if not allowed:
        raise PhaseError(
            f"{frames} frames are not whole cycles of {', '.join(map(str, shifts))} shifts: choose a number of shifts "
            "that divides the number of frames",
            code=ErrorCode.INVALID_SEQUENCE,
        )
    drifts = drift + uncertainty * np.linspace(-1, 1, _TRIALS if uncertainty else 1)
    plans = [_assess(direction, q, frames, drifts) for q in allowed for direction in ((1, -1) if reversible else (1,))]
    return min(plans, key=lambda plan: (plan.follows, round(plan.noise, 2), plan.condition))


@check_arguments(
    PhaseError,
    angles=several(number(), least=5),
    drift=number(),
    uncertainty=number(low=0.0),
)
def check_shifts(angles: Sequence[float], drift: float, *, uncertainty: float = 0.0) -> float:
    """Return the condition number of frames that will be projected on a moving surface, before they are.

    Parameters
    ----------
    angles
        Shift of each frame of the finest pitch [rad].
    drift, uncertainty
        See `plan_shifts`.

    Raises
    ------
    PhaseError
        The shifts follow the motion.

    Examples
    --------
    >>> against = [-2 * np.pi * k / 8 for k in range(8)]
    >>> check_shifts(against, 2 * np.pi * 1.5 / 12) < 2
    True
    """
    shown = Shown(np.arange(len(angles)) - (len(angles) - 1) / 2, np.asarray(angles, float))
    drifts = drift + uncertainty * np.linspace(-1, 1, _TRIALS if uncertainty else 1)
    condition = float(condition_number(shown, drifts).max())
    if condition > LARGEST_CONDITION:
        raise PhaseError(
            f"the shifts follow the motion of {drift / _TURN:.3g} fringes per frame (condition {condition:.0f} above "
            f"{LARGEST_CONDITION:.0f}): shift the fringes the other way, or by another part of a fringe",
            code=ErrorCode.INVALID_SEQUENCE,
        )
    return condition


def _assess(direction: int, shifts: int, frames: int, drifts: np.ndarray) -> ShiftPlan:
    order = tuple(direction * k % shifts or shifts for k in range(1, frames + 1))
    times = np.arange(frames) - (frames - 1) / 2
    shown = Shown(times, _TURN * np.array(order) / shifts)
    condition = float(condition_number(shown, drifts).max())
    noise = max(_noise(shown, each) for each in drifts)
    return ShiftPlan(order, shifts, condition, noise, condition > LARGEST_CONDITION)


def _noise(shown: Shown, drift: float) -> float:
    """Return the RMS deviation of the phase over all phases, over that of as many frames at rest."""
    psi = shown.angles - drift * shown.times
    variances = []
    for phase in np.linspace(0, _TURN, 16, endpoint=False):
        across = np.sin(psi - phase)
        design = np.stack([np.ones_like(psi), np.cos(psi - phase), across, shown.times * across], axis=1)
        variances.append(np.linalg.pinv(design.T @ design, rcond=1e-9, hermitian=True)[2, 2])
    return math.sqrt(float(np.mean(variances)) * len(psi) / 2)
