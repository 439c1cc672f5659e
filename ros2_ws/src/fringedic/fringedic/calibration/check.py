"""Self-test: does the rig still hold its calibration?

A flat plate comes out flat only when camera and projector stand as they did; where it lies does not matter. A known
distance checks the scale, which flatness does not see: two marks on the plate, or the plate lifted by a known height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from fringedic.calibration.judgement import GOOD
from fringedic.calibration.planes import PlaneBlocks, reduce_plane, response_ripple
from fringedic.errors import CalibrationPlanesError, ShapeMismatchError
from fringedic.rig import RigModel
from fringedic.sequence import Orientation

SCALE_TOLERANCE = 2e-3  # relative error of a known distance up to which the scale holds
_OLD = 30 * 86400.0  # [s]
_SIGMAS = 3.0
_SEEN = 2.0  # times the noise of block means: a change that is there, whether it matters or not


@dataclass(frozen=True)
class RigCheck:
    """What a check of the rig found.

    Attributes
    ----------
    holds, verdict
        Whether the calibration can still be used, and the answer in words.
    flatness, flatness_noise
        Root mean square distance of the block means from the best plane, and what noise alone would give [m].
    noise
        Predicted noise of a pixel [m].
    tilt_x, tilt_y
        Slopes of the plate dz/dy and dz/dx as angles [rad].
    height
        z of the plate below the camera [m].
    distance, expected
        The known distance as measured and as given [m]; NaN when none was given.
    response
        Largest amplitude of the phase's ripple at three times the fringes' frequency and more, which the response of
        projector and camera leaves [rad].
    drift
        Root mean square change of the plate against an earlier measurement, without noise [m]; NaN without one.
    age
        Age of the calibration [s]; NaN when not known.
    residual_map
        ``residual`` [m] of block means from the best plane (row, column).
    warnings
        Sentences.
    """

    holds: bool
    verdict: str
    flatness: float
    flatness_noise: float
    noise: float
    tilt_x: float
    tilt_y: float
    height: float
    distance: float
    expected: float
    response: float
    drift: float
    age: float
    residual_map: xr.Dataset
    warnings: tuple[str, ...]


def check_rig(
    rig: RigModel,
    phase: np.ndarray | xr.DataArray,
    sigma: np.ndarray | xr.DataArray | None = None,
    *,
    pitch: float,
    orientation: Orientation = Orientation.VERTICAL,
    marks: tuple[tuple[float, float], tuple[float, float]] | None = None,
    distance: float | None = None,
    lifted: np.ndarray | xr.DataArray | None = None,
    earlier: np.ndarray | xr.DataArray | None = None,
    age: float = math.nan,
) -> RigCheck:
    """Check a rig by a flat plate and, if given, a known distance.

    Parameters
    ----------
    rig
        The calibration in use.
    phase, sigma
        Absolute phase of a flat plate anywhere in the calibrated volume, and its standard deviation [rad].
    pitch, orientation
        Of the fringes [projector px].
    marks
        (column, row) of two marks on the plate [px of the image].
    distance
        Known distance [m]: of the marks, or by which the plate was lifted along its normal for `lifted`.
    lifted
        Phase of the same plate lifted by `distance` [rad].
    earlier
        Phase of the plate at the same place some time before: tells the drift, such as that of a warming projector.
    age
        Of the calibration [s].

    Raises
    ------
    CalibrationPlanesError
        A distance without marks or lifted plate, or the other way round.
    CalibrationPhaseError
        Too little of the image is measured.
    ShapeMismatchError
        Maps of different sizes.
    """
    if (distance is None) != (marks is None and lifted is None) or (marks is not None and lifted is not None):
        raise CalibrationPlanesError("a known distance needs either two marks or the phase of the lifted plate")
    for name, other in (("lifted", lifted), ("earlier", earlier), ("sigma", sigma)):
        if other is not None and np.shape(other) != np.shape(phase):
            raise ShapeMismatchError(f"{name}: shape {np.shape(other)} for a phase of {np.shape(phase)}")
    blocks = reduce_plane(phase, sigma, "the flat plate")
    points, noise = _points(rig, blocks, pitch, orientation)
    plane = _best_plane(points, noise)
    upright = math.sqrt(1 + plane[1] ** 2 + plane[2] ** 2)
    residual = (points[2] - _height(plane, points)) / upright
    slope = float(np.nanmean(noise / blocks.sigma))
    measured = math.nan
    if marks is not None:
        seen = [_on_plane(rig, plane, mark) for mark in marks]
        measured = float(np.linalg.norm(seen[1] - seen[0]))
    elif lifted is not None:
        above, above_noise = _points(rig, reduce_plane(lifted, sigma, "the lifted plate"), pitch, orientation)
        middle = np.array([np.nanmean(points[0]), np.nanmean(points[1])])
        heights = [each[0] + each[1:] @ middle for each in (_best_plane(above, above_noise), plane)]
        measured = float(heights[0] - heights[1]) / upright
    drift = math.nan
    if earlier is not None:
        before, _ = _points(rig, reduce_plane(earlier, sigma, "the earlier plate"), pitch, orientation)
        square = float(np.nanmean((points[2] - before[2]) ** 2)) - 2 * float(np.nanmean(noise**2))
        drift = math.sqrt(max(square, 0.0))
    found = RigCheck(
        holds=False,
        verdict="",
        flatness=math.sqrt(float(np.nanmean(residual**2))),
        flatness_noise=math.sqrt(float(np.nanmean(noise**2))),
        noise=blocks.noise * slope,
        tilt_x=math.atan(plane[2]),
        tilt_y=math.atan(plane[1]),
        height=float(plane[0]),
        distance=measured,
        expected=math.nan if distance is None else distance,
        response=response_ripple(blocks.ripple),
        drift=drift,
        age=age,
        residual_map=xr.Dataset(
            {"residual": (("row", "column"), residual, {"units": "m", "long_name": "distance from the best plane"})},
            coords={"row": blocks.row, "column": blocks.column},
        ),
        warnings=(),
    )
    return _judged(found)


def _points(
    rig: RigModel, blocks: PlaneBlocks, pitch: float, orientation: Orientation
) -> tuple[np.ndarray, np.ndarray]:
    """Return x, y, z of the blocks (3, n, m) and the noise of z (n, m) [m]."""
    phase = xr.DataArray(blocks.phase, dims=("row", "column"), coords={"row": blocks.row, "column": blocks.column})
    shape = rig.reconstruct(phase, pitch, blocks.sigma, orientation)
    return np.stack([shape[name].to_numpy() for name in "xyz"]), shape["noise_z"].to_numpy()


def _best_plane(points: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Return (a, b, c) of z = a + b x + c y."""
    known = np.isfinite(points[2])
    x, y, z = points[:, known]
    weight = 1 / noise[known]
    matrix = np.stack([np.ones_like(x), x, y], axis=1)
    result: np.ndarray = np.linalg.lstsq(matrix * weight[:, None], z * weight, rcond=None)[0]
    return result


def _height(plane: np.ndarray, points: np.ndarray) -> np.ndarray:
    result: np.ndarray = plane[0] + plane[1] * points[0] + plane[2] * points[1]
    return result


def _on_plane(rig: RigModel, plane: np.ndarray, pixel: tuple[float, float]) -> np.ndarray:
    """Return where the line of sight of a pixel meets the plate [m]."""
    column, row = np.array([pixel[0]]), np.array([pixel[1]])
    if rig.camera_distortion is not None:
        column, row = rig.camera_distortion.ideal(column, row)
    ray = rig.ray_matrix @ (column[0], row[0], 1.0)
    along = (plane[0] - rig.camera_distance) / (ray[2] - plane[1] * ray[0] - plane[2] * ray[1])
    result: np.ndarray = along * ray + (0.0, 0.0, rig.camera_distance)
    return result


def _judged(found: RigCheck) -> RigCheck:
    """Return the check with its verdict."""
    noise = f"the noise of a pixel is {1e6 * found.noise:.2g} µm"
    flat = f"the plate comes out flat to {1e6 * found.flatness:.2g} µm ({noise})"
    warnings = []
    if found.age > _OLD:
        warnings.append(f"The calibration is {found.age / 86400:.0f} days old.")
    if found.drift > found.noise:
        warnings.append(
            f"The plate seems to have moved by {1e6 * found.drift:.2g} µm since it was measured before: wait until "
            "projector and camera are warm."
        )
    if math.isnan(found.expected):
        warnings.append("No known distance was measured: the scale is not checked.")
    problems = []
    if found.flatness > GOOD * found.noise:
        problems.append(
            f"a flat plate comes out bent by {1e6 * found.flatness:.2g} µm ({noise}): camera, projector or lens has "
            "moved since the calibration, or the plate is not flat"
        )
    error = found.distance - found.expected
    if abs(error) > SCALE_TOLERANCE * abs(found.expected) + _SIGMAS * found.flatness_noise / math.sqrt(
        found.residual_map["residual"].count()
    ):
        problems.append(
            f"a distance of {1e3 * found.expected:.4g} mm is measured as {1e3 * found.distance:.4g} mm "
            f"({100 * error / found.expected:+.2f} %): the scale or the geometry has changed"
        )
    scale = ""
    if not math.isnan(found.expected):
        scale = f"; {1e3 * found.expected:.4g} mm are measured as {1e3 * found.distance:.5g} mm"
    if problems:
        verdict = f"The rig does not hold its calibration: {'; and '.join(problems)}. Calibrate again."
    elif found.flatness > _SEEN * found.flatness_noise:
        verdict = f"The rig holds its calibration, but a change is seen: {flat}{scale}."
    else:
        verdict = f"The rig holds its calibration: {flat}{scale}."
    return replace(found, holds=not problems, verdict=verdict, warnings=tuple(warnings))
