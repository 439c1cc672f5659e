"""Outliers among the images of a calibration, and the cause of each.

An image that contradicts the others spoils the fit of all. Each is left out in turn (jackknife): when the fit of the
others improves strongly without one image, and without no other, this image is the outlier. The change that reconciles
it with the fit of the others is the cause.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fringedic.calibration.findings import ImageProblem
from fringedic.calibration.fit import Prior, Solution, fit
from fringedic.calibration.geometry import predict
from fringedic.calibration.models import ModelFitter
from fringedic.calibration.placement import FEWEST_PLANES, angle_error, height_error
from fringedic.calibration.planes import PlaneBlocks
from fringedic.camera.findings import Finding
from fringedic.errors import FringedicError

# test_the_bad_image_is_named and test_calibration_report.py contain one faulty image of each kind.
_SUSPICIOUS = 3.0  # an outlier is searched when chi square per degree of freedom is larger
_AGREEMENT = 5.0  # blocks agree within so many of their standard deviations
_DECISIVE = 4.0  # chi square is so many times better without an outlier than without any other image
_FREE_ANGLE, _FREE_HEIGHT = math.radians(20), 0.05  # how far a misplaced plane is searched
_MOST = 0.85  # share of the blocks; blocks at the borders of wrong orders are mixtures
_MOSTLY = 0.05  # another position of the plane leaves at most this part of the residual
_SMALL_TURN = math.radians(0.01)
_SMALL_LIFT = 0.2  # a smaller lift, over the height that the turn causes at the edge, is only a turn
_RIPPLE = 4.0  # an unusual ripple exceeds that of the other images so many times
_LEAST_RIPPLE = 5e-4 * 2 * math.pi  # [rad]


@dataclass(frozen=True, eq=False)
class Outlier:
    """An image that contradicts the others.

    Attributes
    ----------
    plane
        Its index.
    others
        The fit of the others.
    """

    plane: int
    others: Solution


def find_problems(fitter: ModelFitter, planes: Sequence[int]) -> dict[int, Finding]:
    """Return the cause of the one image that spoils the fit, by its index; empty when there is none.

    Raises
    ------
    CalibrationError
        There is no start with or without any of the images.
    """
    whole: Solution | None = None
    failure: FringedicError | None = None
    try:
        whole = fitter.fit_roughly(planes)
    except FringedicError as error:
        failure = error
    if whole is not None and whole.reduced_chi_square < _SUSPICIOUS:
        return {}
    outlier = find_outlier(planes, fitter.fit_roughly, whole)
    if outlier is not None:
        return {outlier.plane: explain(outlier, fitter)}
    if failure is not None:
        raise failure
    return {}


def find_outlier(
    planes: Sequence[int], fit_without: Callable[[Sequence[int]], Solution], whole: Solution | None
) -> Outlier | None:
    """Return the image without which the others fit decisively better; None when there is none.

    Parameters
    ----------
    planes
        Indices of the planes.
    fit_without
        Fits a selection of planes; may raise an error of this library.
    whole
        The fit of all, None when there is none.
    """
    if len(planes) <= FEWEST_PLANES + 1:
        return None  # the others fit perfectly without any one image
    found: list[tuple[float, Outlier]] = []
    for plane in planes:
        try:
            solution = fit_without([each for each in planes if each != plane])
        except FringedicError:
            continue
        found.append((solution.reduced_chi_square, Outlier(plane, solution)))
    if not found:
        return None
    found.sort(key=lambda each: each[0])
    best, outlier = found[0]
    others = [each for each, _ in found[1:]]
    if whole is not None:
        others.append(whole.reduced_chi_square)
    return None if others and min(others) < _DECISIVE * best else outlier


def explain(outlier: Outlier, fitter: ModelFitter) -> Finding:
    """Return what is wrong with an image, given the fit of the others."""
    camera, placement, plane, values = fitter.camera, fitter.placement, outlier.plane, outlier.others.values
    own = fitter.observations.only([plane])
    difference = own.phases[0] - predict(camera, values, placement, own.planes, own.pixels)
    # Agreement is the RMS residual of the others, but no better than noise allows.
    agreement = max(_AGREEMENT, 2 * math.sqrt(outlier.others.reduced_chi_square))
    tolerance = agreement * float(np.median(fitter.observations.sigmas[outlier.plane]))
    orders = int(np.round(np.median(difference) / (2 * math.pi)))
    if orders and _rms(difference - 2 * math.pi * orders) < tolerance:
        return Finding(ImageProblem.WRONG_ORDER, values={"orders": orders})
    jumps = np.round(difference / (2 * math.pi))
    if np.any(jumps) and np.mean(np.abs(difference - 2 * math.pi * jumps) < 2 * tolerance) > _MOST:
        return Finding(ImageProblem.PARTLY_WRONG_ORDER, values={"share": float(np.mean(jumps != 0))})
    angle, height = angle_error(plane), height_error(plane)
    moved = fit(
        fitter.camera,
        fitter.placement,
        own,
        {**values, angle: 0.0, height: 0.0},
        (angle, height),
        {angle: Prior(0.0, _FREE_ANGLE), height: Prior(0.0, _FREE_HEIGHT)},
    )
    left = own.phases[0] - predict(camera, moved.values, placement, own.planes, own.pixels)
    if _rms(left) >= max(tolerance, _MOSTLY * _rms(difference)):
        return Finding(ImageProblem.NOT_THIS_PLANE)
    ripple = unusual_ripple(plane, fitter.planes.blocks)
    if ripple:
        return Finding(ImageProblem.MOVED_OR_FLICKER, values={"ripple": ripple})
    turn, lift = moved.values[angle], moved.values[height]
    stated = float(fitter.placement.angles[plane])
    angles = {"angle": stated + turn, "stated": stated}
    reach = 0.5 * fitter.camera.width * fitter.camera.pixel_size
    if abs(lift) < _SMALL_LIFT * abs(turn) * reach:
        return Finding(ImageProblem.OTHER_ANGLE, values=angles)
    if abs(turn) < _SMALL_TURN:
        return Finding(ImageProblem.OTHER_HEIGHT, values={"lift": lift})
    return Finding(ImageProblem.OTHER_PLACE, values={**angles, "lift": lift})


def unusual_ripple(plane: int, blocks: Sequence[PlaneBlocks]) -> float:
    """Return the ripple [rad] once or twice per fringe of an image if it is far above that of the others, else 0."""
    ripples = np.array([each.ripple[:2] for each in blocks])
    usual = np.nanmedian(np.delete(ripples, plane, axis=0), axis=0)
    found = np.any(ripples[plane] > np.maximum(_RIPPLE * usual, _LEAST_RIPPLE))
    return float(np.nanmax(ripples[plane])) if found else 0.0


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
