"""Start of a calibration without starting values: the six-parameter model from linear least squares.

On a plane z = t x through the rotation axis the six-parameter model (Molimard, Boyer, Zahouani, eq. 10, with corrected
signs; Breque et al. 2004) reads, X being the position on the reference plane that a pixel looks at, measured from the
axis,

    phi - phi0 = A X / (1 + B X),   A = K (hp - t d) / L^2,   B = t / h0 - (d + t hp) / L^2,   L^2 = d^2 + hp^2,

so that A and B are linear in t = tan(angle) and give K, hp, d and h0 in closed form. On planes z = c

    (phi - phi0)(X = 0) = -c K d / (L^2 - c hp),   B = -(1 - c / h0) d / (L^2 - c hp).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fringedic.calibration.placement import FEWEST_PLANES, SMALLEST_MOVE, SMALLEST_TURN, Placement
from fringedic.calibration.planes import PlaneBlocks
from fringedic.errors import CalibrationError


@dataclass(frozen=True)
class SixParameters:
    """The six parameters of the closed form (Molimard; Breque).

    Attributes
    ----------
    camera_distance, projector_distance, base
        h0, hp and d [m].
    sensitivity
        K = 2 pi f_p / P_t [rad].
    phase_offset
        phi0 [rad], the phase on the rotation axis.
    axis_position
        x0 [m], the rotation axis's position across the fringes, from the camera's principal point.
    """

    camera_distance: float
    projector_distance: float
    base: float
    sensitivity: float
    phase_offset: float
    axis_position: float


def closed_form(
    planes: Sequence[PlaneBlocks], across: np.ndarray, along: np.ndarray, placement: Placement
) -> SixParameters:
    """Return the six parameters without any starting value.

    Parameters
    ----------
    planes
        Phase maps.
    across, along
        Positions on the reference plane that the blocks look at, across the fringes and along them [m], (n, m).
    placement
        Of the planes: at least three angles at one height, or three heights at one angle.

    Raises
    ------
    CalibrationError
        Too few angles or heights; K, hp and h0 come out negative, because angles or heights have the wrong sign; or the
        phase runs against the coordinates, or is that of no plane.
    """
    angles, heights = placement.angles, placement.heights
    turned = _at_one(heights, SMALLEST_MOVE)
    if _distinct(angles[turned], SMALLEST_TURN) >= FEWEST_PLANES:
        chosen = [planes[i] for i in turned]
        found = _from_angles([_rational(plane, across, along) for plane in chosen], np.tan(angles[turned]), across)
    else:
        lifted = _at_one(angles, SMALLEST_TURN)
        if _distinct(heights[lifted], SMALLEST_MOVE) < FEWEST_PLANES:
            raise CalibrationError(
                f"give at least {FEWEST_PLANES} angles at the same height, or {FEWEST_PLANES} heights at the same angle"
            )
        found = _from_heights([_rational(planes[i], across, along) for i in lifted], heights[lifted])
    values = (found.camera_distance, found.projector_distance, found.base, found.sensitivity)
    words = (
        f"h0 = {1e3 * found.camera_distance:.4g} mm, hp = {1e3 * found.projector_distance:.4g} mm, "
        f"d = {1e3 * found.base:.4g} mm, K = {found.sensitivity:.4g}"
    )
    if not np.all(np.isfinite(values)):
        raise CalibrationError(f"the phase maps are not those of a plane that turns: {words}")
    signs = found.camera_distance > 0, found.projector_distance > 0, found.sensitivity > 0
    if not all(signs):
        raise CalibrationError(_SIGN_ERRORS.get(signs, _OTHER_SIGNS).format(words))
    return found


def _at_one(values: np.ndarray, apart: float) -> np.ndarray:
    """Return the indices of the largest group of equal values."""
    equal = np.abs(values[:, None] - values) <= apart
    result: np.ndarray = np.flatnonzero(equal[np.argmax(equal.sum(axis=1))])
    return result


def _distinct(values: np.ndarray, apart: float) -> int:
    return 1 + int(np.sum(np.diff(np.sort(values)) > apart))


def _rational(plane: PlaneBlocks, across: np.ndarray, along: np.ndarray) -> tuple[float, float, float]:
    """Return (A0, A1, B) of ``phi = (A0 + A1 X) / (1 + B X)`` on the line along = 0, X in units of metre."""
    known = np.isfinite(plane.phase)
    phi, x, y = plane.phase[known], across[known], along[known]
    scale = max(np.abs(x).max(), np.abs(y).max())
    x, y = x / scale, y / scale
    matrix = np.stack([np.ones_like(x), x, y, -x * phi, -y * phi], axis=1)
    solution = np.linalg.lstsq(matrix / plane.sigma[known][:, None], phi / plane.sigma[known], rcond=None)[0]
    return float(solution[0]), float(solution[1] / scale), float(solution[3] / scale)


def _from_angles(
    rational: Sequence[tuple[float, float, float]], slope: np.ndarray, across: np.ndarray
) -> SixParameters:
    a0, a1, b = np.array(rational).T[:, :, None]
    # All planes have the same phase on their common line, the axis, and where the phase does not depend on z. The
    # latter is outside the view of a useful rig; the axis is nearer to the middle.
    candidates = np.linspace(1.5 * across.min(), 1.5 * across.max(), 6001)
    phases = (a0 + a1 * candidates) / (1 + b * candidates)
    variance = phases.var(axis=0)
    least = 1 + np.flatnonzero((variance[1:-1] < variance[:-2]) & (variance[1:-1] <= variance[2:]))
    middle = 0.5 * (across.min() + across.max())
    best = int(least[np.argmin(np.abs(candidates[least] - middle))] if len(least) else np.argmin(variance))
    axis, offset = float(candidates[best]), float(phases[:, best].mean())
    growth = ((a1 - offset * b) / (1 + b * axis))[:, 0]
    bend = (b / (1 + b * axis))[:, 0]
    a_slope, a_level = np.polyfit(slope, growth, 1)
    b_slope, b_level = np.polyfit(slope, bend, 1)
    ratio = -a_level / a_slope  # hp / d
    base = -1 / (b_level * (1 + ratio**2))
    projector = ratio * base
    squared = base**2 + projector**2
    return SixParameters(
        camera_distance=float(1 / (b_slope + projector / squared)),
        projector_distance=float(projector),
        base=float(base),
        sensitivity=float(a_level * squared / projector),
        phase_offset=offset,
        axis_position=axis,
    )


def _from_heights(rational: Sequence[tuple[float, float, float]], height: np.ndarray) -> SixParameters:
    phase, _, bend = np.array(rational).T
    # phi (1 - c v) = phi0 - c (u + phi0 v) with u = K d / L^2, v = hp / L^2
    matrix = np.stack([np.ones_like(height), -height, height * phase], axis=1)
    offset, mixed, v = np.linalg.lstsq(matrix, phase, rcond=None)[0]
    u = mixed - offset * v
    # B (1 - c v) = -w + c w / h0 with w = d / L^2
    line, level = np.polyfit(height, bend * (1 - height * v), 1)
    w = -level
    squared = 1 / (v**2 + w**2)
    return SixParameters(
        camera_distance=float(w / line),
        projector_distance=float(v * squared),
        base=float(w * squared),
        sensitivity=float(u / w),
        phase_offset=float(offset),
        axis_position=0.0,
    )


# By the signs of h0, hp and K.
_SIGN_ERRORS = {
    (False, False, False): "the angles have the wrong sign ({}): a positive angle raises the side of +x, right in the "
    "image (that of +y, up in the image, with horizontal fringes), towards the camera",
    (True, True, False): "the phase falls where it should grow ({}): the fringe frames are in reverse order, or the "
    "projector shows a mirrored image",
    **dict.fromkeys(
        ((True, False, True), (False, True, True), (False, False, True)),
        "the camera's image is mirrored, or both the fringes and the angles run the wrong way ({})",
    ),
}
_OTHER_SIGNS = "the phase maps do not belong to a plane at these angles ({}): wrong angles, fringe orders or patterns"
