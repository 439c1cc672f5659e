"""Which image is the bad one, and what is wrong with it.

An image that contradicts the others spoils the fit of all. Each is left out in turn: when the fit of the others becomes
many times better without one image, and without no other, this is the one. How it can be reconciled with the fit of the
others tells what happened to it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fringedic.calibration.fit import Observations, Prior, Solution, fit
from fringedic.calibration.geometry import Camera, Placement, angle_error, height_error, predict
from fringedic.calibration.planes import FEWEST_PLANES, PlaneBlocks
from fringedic.errors import FringedicError

_DECISIVE = 4.0  # times better chi square without one image than without any other
_FREE_ANGLE, _FREE_HEIGHT = math.radians(20), 0.05  # how far a misplaced plane is looked for
_MOST = 0.85  # share of the blocks; those at the borders of wrong orders are mixtures
_MOSTLY = 0.05  # part of the residual that another place of the plane may leave
_SMALL_TURN = math.radians(0.01)
_RIPPLE = 4.0  # times that of the other images
_LEAST_RIPPLE = 5e-4 * 2 * math.pi  # [rad]


@dataclass(frozen=True)
class Suspect:
    """An image that does not fit the others.

    Attributes
    ----------
    plane
        Its index.
    problem
        What is wrong with it, in words.
    solution
        The fit of the others.
    """

    plane: int
    problem: str
    solution: Solution


def find_suspect(
    fitted: Sequence[int], fit_without: Callable[[Sequence[int]], Solution], whole: Solution | None
) -> tuple[int, Solution] | None:
    """Return the image without which the others fit decisively better, and their fit; None when there is none.

    Parameters
    ----------
    fitted
        Indices of the planes.
    fit_without
        Fits a selection of planes; may raise an error of this library.
    whole
        The fit of all, None when there is none.
    """
    if len(fitted) <= FEWEST_PLANES + 1:
        return None  # without one image the others explain themselves
    found: list[tuple[float, int, Solution]] = []
    for plane in fitted:
        try:
            solution = fit_without([each for each in fitted if each != plane])
        except FringedicError:
            continue
        found.append((solution.chi_square / solution.freedom, plane, solution))
    found.sort(key=lambda each: each[0])
    if not found:
        return None
    best = found[0]
    others = [each[0] for each in found[1:]]
    if whole is not None:
        others.append(whole.chi_square / whole.freedom)
    if others and min(others) < _DECISIVE * best[0]:
        return None
    return best[1], best[2]


def explain(
    plane: int,
    solution: Solution,
    camera: Camera,
    placement: Placement,
    observations: Observations,
    blocks: Sequence[PlaneBlocks],
    tolerance: float,
) -> str:
    """Return what is wrong with an image, given the fit of the others.

    Parameters
    ----------
    tolerance
        Root mean square residual [rad] that counts as agreement.
    """
    own = observations.only([plane])
    measured = own.phases[0]
    difference = measured - predict(camera, solution.values, placement, own.planes, own.pixels)
    orders = int(np.round(np.median(difference) / (2 * math.pi)))
    if orders and _rms(difference - 2 * math.pi * orders) < tolerance:
        return f"its fringe order is wrong by {orders:+d} everywhere: measure it again with all pitches"
    jumps = np.round(difference / (2 * math.pi))
    if np.any(jumps) and np.mean(np.abs(difference - 2 * math.pi * jumps) < 2 * tolerance) > _MOST:
        return (
            f"the fringe order is wrong on {100 * np.mean(jumps != 0):.0f} % of it: "
            "check light, shadows and the coarse pitches"
        )
    moved = fit(
        camera,
        placement,
        own,
        {**solution.values, angle_error(plane): 0.0, height_error(plane): 0.0},
        (angle_error(plane), height_error(plane)),
        {angle_error(plane): Prior(0.0, _FREE_ANGLE), height_error(plane): Prior(0.0, _FREE_HEIGHT)},
    )
    left = measured - predict(camera, moved.values, placement, own.planes, own.pixels)
    if _rms(left) < max(tolerance, _MOSTLY * _rms(difference)):
        size = unusual_ripple(plane, blocks) / (2 * math.pi)
        if size:
            return (
                f"its phase ripples with the fringes by {size:.4f} fringe, the others do not: the plane moved, or the "
                "light changed, while its frames were taken; measure it again"
            )
        return _misplaced(plane, moved.values, placement, own, camera)
    return (
        "its phase is not that of the plane at any angle: the projector showed a wrong pattern, frames are out of "
        "order, or something else stood in front of the camera; measure it again"
    )


def unusual_ripple(plane: int, blocks: Sequence[PlaneBlocks]) -> float:
    """Return the ripple [rad] once or twice per fringe of an image if it is far above that of the others, or 0."""
    ripples = np.array([each.ripple[:2] for each in blocks])
    usual = np.nanmedian(np.delete(ripples, plane, axis=0), axis=0)
    found = np.any(ripples[plane] > np.maximum(_RIPPLE * usual, _LEAST_RIPPLE))
    return float(np.nanmax(ripples[plane])) if found else 0.0


def _misplaced(plane: int, values: Mapping[str, float], placement: Placement, own: Observations, camera: Camera) -> str:
    turn, lift = values[angle_error(plane)], values[height_error(plane)]
    angle = math.degrees(placement.angles[plane])
    reach = 0.5 * camera.width * camera.pixel_size
    if abs(lift) < 0.2 * abs(turn) * reach:
        # moved in the very middle of its frames it looks like one that stands still halfway
        return (
            f"the plane stands at {angle + math.degrees(turn):.2f} degree, not at {angle:g}: correct the angle, or "
            "measure it again if the plane may have turned while its frames were taken"
        )
    if abs(turn) < _SMALL_TURN:
        return f"the plane stands {1e3 * lift:+.3f} mm away from where it should: was it pushed or clamped anew?"
    return (
        f"the plane stands at {angle + math.degrees(turn):.2f} degree, not at {angle:g}, and {1e3 * lift:+.3f} mm "
        "away: was it pushed or clamped anew?"
    )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
