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
from fringedic.calibration.fit import Observations, Prior, Solution, fit
from fringedic.calibration.geometry import predict
from fringedic.calibration.models import ModelFitter
from fringedic.calibration.placement import FEWEST_PLANES, angle_error, height_error
from fringedic.calibration.planes import PlaneBlocks
from fringedic.camera.findings import Finding
from fringedic.errors import FringedicError

# test_the_bad_image_is_named and test_calibration_report.py contain one faulty image of each kind.
_SUSPICIOUS = 3.0  # chi square per degree of freedom above which an outlier is searched
_AGREEMENT = 5.0  # standard deviations of a block
_DECISIVE = 4.0  # times better chi square without one image than without any other
_FREE_ANGLE, _FREE_HEIGHT = math.radians(20), 0.05  # how far a misplaced plane is searched
_MOST = 0.85  # share of the blocks; blocks at the borders of wrong orders are mixtures
_MOSTLY = 0.05  # part of the residual that another position of the plane may leave
_SMALL_TURN = math.radians(0.01)
_SMALL_LIFT = 0.2  # of the height that the turn causes at the edge of the image
_RIPPLE = 4.0  # times that of the other images
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
    tolerance = _tolerance(outlier, fitter)
    wrong_order = _wrong_order(difference, tolerance)
    if wrong_order is not None:
        return wrong_order
    moved = _place_freely(outlier, fitter, own)
    left = own.phases[0] - predict(camera, moved.values, placement, own.planes, own.pixels)
    if _rms(left) >= max(tolerance, _MOSTLY * _rms(difference)):
        return Finding(ImageProblem.NOT_THIS_PLANE)
    ripple = unusual_ripple(plane, fitter.planes.blocks)
    if ripple:
        return Finding(ImageProblem.MOVED_OR_FLICKER, values={"ripple": ripple})
    return _misplaced(plane, moved, fitter)


def unusual_ripple(plane: int, blocks: Sequence[PlaneBlocks]) -> float:
    """Return the ripple [rad] once or twice per fringe of an image if it is far above that of the others, else 0."""
    ripples = np.array([each.ripple[:2] for each in blocks])
    usual = np.nanmedian(np.delete(ripples, plane, axis=0), axis=0)
    found = np.any(ripples[plane] > np.maximum(_RIPPLE * usual, _LEAST_RIPPLE))
    return float(np.nanmax(ripples[plane])) if found else 0.0


def _tolerance(outlier: Outlier, fitter: ModelFitter) -> float:
    """Return the RMS residual [rad] that counts as agreement: that of the others, but no better than noise allows."""
    agreement = max(_AGREEMENT, 2 * math.sqrt(outlier.others.reduced_chi_square))
    return agreement * float(np.median(fitter.observations.sigmas[outlier.plane]))


def _wrong_order(difference: np.ndarray, tolerance: float) -> Finding | None:
    """Return whether whole fringes explain a difference of phases [rad], everywhere or in a part of the image."""
    orders = int(np.round(np.median(difference) / (2 * math.pi)))
    if orders and _rms(difference - 2 * math.pi * orders) < tolerance:
        return Finding(ImageProblem.WRONG_ORDER, values={"orders": orders})
    jumps = np.round(difference / (2 * math.pi))
    if np.any(jumps) and np.mean(np.abs(difference - 2 * math.pi * jumps) < 2 * tolerance) > _MOST:
        return Finding(ImageProblem.PARTLY_WRONG_ORDER, values={"share": float(np.mean(jumps != 0))})
    return None


def _place_freely(outlier: Outlier, fitter: ModelFitter, own: Observations) -> Solution:
    """Fit angle and height of the image to the rig of the others."""
    turn, lift = angle_error(outlier.plane), height_error(outlier.plane)
    return fit(
        fitter.camera,
        fitter.placement,
        own,
        {**outlier.others.values, turn: 0.0, lift: 0.0},
        (turn, lift),
        {turn: Prior(0.0, _FREE_ANGLE), lift: Prior(0.0, _FREE_HEIGHT)},
    )


def _misplaced(plane: int, moved: Solution, fitter: ModelFitter) -> Finding:
    turn, lift = moved.values[angle_error(plane)], moved.values[height_error(plane)]
    stated = float(fitter.placement.angles[plane])
    angles = {"angle": stated + turn, "stated": stated}
    reach = 0.5 * fitter.camera.width * fitter.camera.pixel_size
    if abs(lift) < _SMALL_LIFT * abs(turn) * reach:
        return Finding(ImageProblem.OTHER_ANGLE, values=angles)
    if abs(turn) < _SMALL_TURN:
        return Finding(ImageProblem.OTHER_HEIGHT, values={"lift": lift})
    return Finding(ImageProblem.OTHER_PLACE, values={**angles, "lift": lift})


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
