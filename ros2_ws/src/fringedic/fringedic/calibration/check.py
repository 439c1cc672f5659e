"""Self-test of a rig: whether it still holds its calibration.

A flat plate is measured as flat only when camera and projector are where they were during the calibration; the position
of the plate does not matter. Flatness does not depend on the scale, which a known distance checks: two marks on the
plate, or the plate lifted by a known height.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
import xarray as xr

from fringedic.calibration.findings import CheckProblem, CheckWarning
from fringedic.calibration.fit_results import GOOD
from fringedic.calibration.planes import PlaneBlocks, reduce_plane, response_ripple
from fringedic.camera.findings import Finding
from fringedic.errors import CalibrationError, ImageError
from fringedic.patterns.pattern import Orientation
from fringedic.rig.model import RigModel
from fringedic.wording.arguments import array, check_arguments, dataset, number, of_type, optional, several

SCALE_TOLERANCE = 2e-3  # relative error of a known distance up to which the scale holds; a gauge block is far better
_OLD = 30 * 86400.0  # [s]
_SIGMAS = 3.0  # a distance may deviate by so many standard deviations of its noise
_SEEN = 2.0  # times the noise of block means: a significant change, whether it matters or not


class CheckVerdict(StrEnum):
    """Whether a rig holds its calibration."""

    HOLDS = "holds"
    HOLDS_WITH_CHANGE = "holds with change"  # a change is significant, and below the noise of a pixel
    FAILS = "fails"


@dataclass(frozen=True, eq=False)
class RigCheck:
    """Result of a check of the rig.

    Attributes
    ----------
    flatness, flatness_noise
        Root mean square distance of the block means from the best plane, and its expectation for noise alone [m].
    noise
        Predicted noise of a pixel [m].
    tilt_x, tilt_y
        Slopes of the plate dz/dy and dz/dx as angles [rad].
    height
        z of the plate below the camera [m].
    distance, expected
        The known distance as measured and as given [m]; NaN when none was given.
    response
        Largest amplitude of the phase's ripple at three times the fringes' frequency and more, due to the response of
        projector and camera [rad].
    drift
        Root mean square change of the plate since an earlier measurement, without noise [m]; NaN without one.
    age
        Age of the calibration [s]; NaN when unknown.
    residual_map
        ``residual`` [m] of block means from the best plane (row, column).
    """

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

    @property
    def problems(self) -> tuple[Finding, ...]:
        """Why the rig does not hold its calibration; empty when it does."""
        found = []
        if self.flatness > GOOD * self.noise:
            found.append(Finding(CheckProblem.BENT))
        noise = self.flatness_noise / math.sqrt(self.residual_map["residual"].count())
        if abs(self.scale_error) > SCALE_TOLERANCE * abs(self.expected) + _SIGMAS * noise:
            found.append(Finding(CheckProblem.SCALE))
        return tuple(found)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """What should be better, as codes; `fringedic.calibration.sentences` makes sentences of them."""
        found = []
        if self.age > _OLD:
            found.append(Finding(CheckWarning.OLD))
        if self.drift > self.noise:
            found.append(Finding(CheckWarning.DRIFT))
        if math.isnan(self.expected):
            found.append(Finding(CheckWarning.SCALE_NOT_CHECKED))
        return tuple(found)

    @property
    def verdict(self) -> CheckVerdict:
        """Whether the calibration can still be used."""
        if self.problems:
            return CheckVerdict.FAILS
        changed = self.flatness > _SEEN * self.flatness_noise
        return CheckVerdict.HOLDS_WITH_CHANGE if changed else CheckVerdict.HOLDS

    @property
    def holds(self) -> bool:
        """Whether the calibration can still be used."""
        return self.verdict is not CheckVerdict.FAILS

    @property
    def scale_error(self) -> float:
        """Error of the known distance [m]; NaN when none was given."""
        return self.distance - self.expected

    @property
    def distance_sigma(self) -> float:
        """Standard deviation of the known distance [m], from the scatter of the blocks of both planes about a plane."""
        blocks = int(self.residual_map["residual"].count())
        return math.sqrt(2 / blocks) * max(self.flatness, self.flatness_noise)


def _phase_map(value: Any) -> Any:
    return (dataset("phase", "sigma") if isinstance(value, xr.Dataset) else array(2))(value)


@check_arguments(
    CalibrationError,
    rig=of_type(RigModel),
    phase=array(2),
    sigma=optional(array(2)),
    pitch=number(1e-3, 1e5),
    marks=optional(several(several(number(), length=2), length=2)),
    distance=optional(number()),
    lifted=optional(_phase_map),
    earlier=optional(_phase_map),
)
def check_rig(  # noqa: PLR0913 - the public function: every keyword is one thing that a user may have measured
    rig: RigModel,
    phase: np.ndarray | xr.DataArray,
    sigma: np.ndarray | xr.DataArray | None = None,
    *,
    pitch: float,
    orientation: Orientation = Orientation.VERTICAL,
    marks: tuple[tuple[float, float], tuple[float, float]] | None = None,
    distance: float | None = None,
    lifted: np.ndarray | xr.DataArray | xr.Dataset | None = None,
    earlier: np.ndarray | xr.DataArray | xr.Dataset | None = None,
    age: float = math.nan,
) -> RigCheck:
    """Check a rig by a flat plate and, if given, a known distance.

    Parameters
    ----------
    rig
        The calibration in use.
    phase, sigma
        Absolute phase of a flat plate anywhere in the calibrated volume, and its standard deviation [rad], shape
        (row, column), NaN where not measured.
    pitch, orientation
        Of the fringes [projector px].
    marks
        (column, row) of two marks on the plate [px of the image].
    distance
        Known distance [m]: of the marks, or by which the plate was lifted along its normal for `lifted`.
    lifted
        Phase of the same plate lifted by `distance` [rad]; a dataset with ``phase`` and its own ``sigma``, or the
        phase alone, which has the sigma of the plate then.
    earlier
        Phase of the plate at the same position some time before, as for `lifted`: gives the drift, for example of a
        projector that warms up.
    age
        Of the calibration [s].

    Returns
    -------
    RigCheck
        ``holds`` is False when the rig has to be calibrated again; ``problems`` says why.

    Raises
    ------
    CalibrationError
        A distance without marks or lifted plate, or the other way round; or too little of the image is measured.
    ImageError
        Maps of different sizes.

    Examples
    --------
    A plate at z = 1 mm, and the same plate lifted by 5 mm:

    >>> import numpy as np
    >>> import fringedic
    >>> from fringedic.calibration import check_rig
    >>> from fringedic.virtual_rig import VirtualRig
    >>> rig = fringedic.RigModel(**VirtualRig.from_preset("plate", size="tiny").optics())
    >>> column, row = np.meshgrid(np.arange(rig.camera_width), np.arange(rig.camera_height))
    >>> noise = np.random.default_rng(0).normal(0.0, 0.01, column.shape)
    >>> def plate(z):
    ...     ray = rig.ray_matrix @ np.stack([column.ravel(), row.ravel(), np.ones(column.size)])
    ...     x, y, _ = ray * (z - rig.camera_distance) / ray[2]
    ...     return rig.phase(x, y, z, pitch=10.0).reshape(column.shape) + noise
    >>> check = check_rig(rig, plate(1e-3), pitch=10.0, lifted=plate(6e-3), distance=5e-3)
    >>> check.holds, round(1e3 * check.distance, 2)
    (True, 5.0)
    """
    if (distance is None) != (marks is None and lifted is None) or (marks is not None and lifted is not None):
        raise CalibrationError("a known distance needs either two marks or the phase of the lifted plate")
    for name, other in (("lifted", lifted), ("earlier", earlier), ("sigma", sigma)):
        image = other.phase if isinstance(other, xr.Dataset) else other
        if image is not None and np.shape(image) != np.shape(phase):
            raise ImageError(f"{name}: shape {np.shape(image)} for a phase of {np.shape(phase)}")
    fringes = _Fringes(rig, pitch, orientation)

    def measure(plate: np.ndarray | xr.DataArray | xr.Dataset, name: str) -> _Plate:
        if isinstance(plate, xr.Dataset):
            return fringes.measure(reduce_plane(plate.phase, plate.sigma, name))
        return fringes.measure(reduce_plane(plate, sigma, name))

    plate = measure(phase, "the flat plate")
    measured = math.nan
    if marks is not None:
        seen = [_on_plane(rig, plate.plane, mark) for mark in marks]
        measured = float(np.linalg.norm(seen[1] - seen[0]))
    elif lifted is not None:
        measured = plate.distance_to(measure(lifted, "the lifted plate"))
    drift = math.nan
    if earlier is not None:
        drift = plate.drift_since(measure(earlier, "the earlier plate"))
    blocks, residual = plate.blocks, plate.residual
    return RigCheck(
        flatness=math.sqrt(float(np.nanmean(residual**2))),
        flatness_noise=math.sqrt(float(np.nanmean(plate.noise**2))),
        noise=blocks.noise * float(np.nanmean(plate.noise / blocks.sigma)),
        tilt_x=math.atan(plate.plane[2]),
        tilt_y=math.atan(plate.plane[1]),
        height=float(plate.plane[0]),
        distance=measured,
        expected=math.nan if distance is None else distance,
        response=response_ripple(blocks.ripple),
        drift=drift,
        age=age,
        residual_map=xr.Dataset(
            {"residual": (("row", "column"), residual, {"units": "m", "long_name": "distance from the best plane"})},
            coords={"row": blocks.row, "column": blocks.column},
        ),
    )


@dataclass(frozen=True, eq=False)
class _Plate:
    """A measured plate: points (3, n, m) and noise of z (n, m) of its blocks [m], and z = a + b x + c y."""

    blocks: PlaneBlocks
    points: np.ndarray
    noise: np.ndarray
    plane: np.ndarray

    @property
    def upright(self) -> float:
        """Length of the normal (-b, -c, 1)."""
        return math.sqrt(1 + self.plane[1] ** 2 + self.plane[2] ** 2)

    @property
    def residual(self) -> np.ndarray:
        """Distance of the blocks from the plane along its normal [m], (n, m)."""
        height = self.plane[0] + self.plane[1] * self.points[0] + self.plane[2] * self.points[1]
        residual: np.ndarray = (self.points[2] - height) / self.upright
        return residual

    def distance_to(self, other: _Plate) -> float:
        """Return by how much another plate is above this one, along the normal in the middle of this one [m]."""
        middle = np.array([np.nanmean(self.points[0]), np.nanmean(self.points[1])])
        heights = [each[0] + each[1:] @ middle for each in (other.plane, self.plane)]
        return float(heights[0] - heights[1]) / self.upright

    def drift_since(self, earlier: _Plate) -> float:
        """Return the RMS change of z since an earlier measurement, without noise [m]."""
        change = float(np.nanmean((self.points[2] - earlier.points[2]) ** 2))
        return math.sqrt(max(change - 2 * float(np.nanmean(self.noise**2)), 0.0))


@dataclass(frozen=True, eq=False)
class _Fringes:
    """The rig and the fringes that a plate is measured with."""

    rig: RigModel
    pitch: float
    orientation: Orientation

    def measure(self, blocks: PlaneBlocks) -> _Plate:
        """Reconstruct the blocks of a plate and fit its plane."""
        shape = self.rig.reconstruct(blocks.as_phase_map(), self.pitch, blocks.sigma, self.orientation)
        points, noise = np.stack([shape[name].to_numpy() for name in "xyz"]), shape["noise_z"].to_numpy()
        known = np.isfinite(points[2]) & np.isfinite(noise) & (noise > 0)
        if np.count_nonzero(known) < 3:
            raise CalibrationError(
                "the phase of the plate has no height with this calibration and pitch: is it that of this rig?"
            )
        x, y, z = points[:, known]
        weight = 1 / noise[known]
        matrix = np.stack([np.ones_like(x), x, y], axis=1)
        plane: np.ndarray = np.linalg.lstsq(matrix * weight[:, None], z * weight, rcond=None)[0]
        return _Plate(blocks, points, noise, plane)


def _on_plane(rig: RigModel, plane: np.ndarray, pixel: tuple[float, float]) -> np.ndarray:
    """Return the point (3,) in which the line of sight of a pixel meets the plate [m]."""
    column, row = np.array([pixel[0]]), np.array([pixel[1]])
    if rig.camera_distortion is not None:
        column, row = rig.camera_distortion.ideal(column, row)
    ray = rig.ray_matrix @ (column[0], row[0], 1.0)
    along = (plane[0] - rig.camera_distance) / (ray[2] - plane[1] * ray[0] - plane[2] * ray[1])
    result: np.ndarray = along * ray + (0.0, 0.0, rig.camera_distance)
    return result
