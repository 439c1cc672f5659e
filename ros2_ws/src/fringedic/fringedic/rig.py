"""The rig's geometry: pin-hole camera and pin-hole projector, and the surface that a phase map stands for.

Rig frame, right-handed: z = 0 is the reference plane, z towards the camera, x to the right of the image, y up in the
image. The camera's pin-hole is at (0, 0, h0), the projector's at (d, y, hp). A fringe of phase phi leaves the projector
as a surface (a plane without distortion); the point seen by a pixel is where its line of sight meets that surface.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import yaml
from numba import njit, prange
from numpy.typing import ArrayLike

from fringedic.camera.distortion import DistortionMap
from fringedic.errors import InvalidCalibrationError, InvalidDistortionError, ShapeMismatchError
from fringedic.rig_uncertainty import GRID, HEIGHT_POWERS, check_names, variance_map
from fringedic.sequence import Orientation

_NO_VARIANCES = (np.empty((0, 0, 3, HEIGHT_POWERS)), 1.0)
_NO_FIELD = np.empty((2, 0, 0), np.float32)
_NO_FIELD.setflags(write=False)  # like the field of a lens: another type would be compiled for
_NEWTON_STEPS = 6  # from the undistorted plane; two or three are taken
_NEWTON_ENDS = 1e-7  # relative size of the last step: the next would be its square


@dataclass(frozen=True)
class RigModel:
    """Pin-hole model of camera and projector, the content of the message ``fringedic_msgs/RigCalibration`` (SI).

    Attributes
    ----------
    camera_width, camera_height
        Size of the camera's image [px].
    camera_distance
        h0, height of the camera's pin-hole above the reference plane [m].
    pixel_size
        gamma, length on the reference plane per row at the principal point [m].
    pixel_aspect
        tau, rows over columns: a column is gamma / tau wide.
    principal_column, principal_row
        The ideal pixel that sees the origin when the camera is not tilted [px].
    camera_tilt_x, camera_tilt_y
        Rotation of the camera about x and y [rad]: directions are turned by Rx Ry.
    camera_distortion
        From the pixels of the image to ideal pixels; None when the camera is as good as ideal.
    projector_width, projector_height
        Size of the projector's image [px].
    projector_position
        (d, y, hp) of the projector's pin-hole [m].
    projector_rotation
        (yaw, pitch, roll) [rad] about the projector's own up, right and backward axes, in this order, against the
        attitude that looks at the origin with its columns growing towards +x.
    projector_focal_length
        F [projector px].
    projector_principal_column, projector_principal_row
        Where the projector's optical axis leaves its image [px].
    projector_k1
        Radial distortion: normalised coordinates are stretched by 1 + k1 (m^2 + n^2).
    identifier, model, source
        Name of this calibration, "paper" or "general", and where it comes from.
    parameter_names, covariance
        Fitted parameters, names out of `fringedic.rig_uncertainty.PARAMETERS`, and their covariance, row-major (SI and
        px); empty when unknown.

    Raises
    ------
    InvalidCalibrationError
        When a parameter has no meaning.
    """

    camera_width: int
    camera_height: int
    camera_distance: float
    pixel_size: float
    pixel_aspect: float
    principal_column: float
    principal_row: float
    projector_width: int
    projector_height: int
    projector_position: tuple[float, float, float]
    projector_focal_length: float
    projector_principal_column: float
    projector_principal_row: float
    camera_tilt_x: float = 0.0
    camera_tilt_y: float = 0.0
    camera_distortion: DistortionMap | None = None
    projector_rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    projector_k1: float = 0.0
    identifier: str = ""
    model: str = "general"
    source: str = ""
    parameter_names: tuple[str, ...] = ()
    covariance: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name in _TUPLES:
            object.__setattr__(self, name, tuple(getattr(self, name)))
        for name in _NUMBERS:
            if not np.all(np.isfinite(getattr(self, name))):
                raise InvalidCalibrationError(f"{name} is {getattr(self, name)}: it has to be a finite number")
        for name in _POSITIVE:
            if getattr(self, name) <= 0:
                raise InvalidCalibrationError(f"{name} is {getattr(self, name)}: it has to be above 0")
        if self.projector_position[2] <= 0:
            raise InvalidCalibrationError(
                f"projector_position is {self.projector_position}: the projector has to be above the reference plane"
            )
        if self.model not in ("paper", "general"):
            raise InvalidCalibrationError(f"model is '{self.model}': use 'paper' or 'general'")
        if len(self.covariance) != len(self.parameter_names) ** 2:
            raise InvalidCalibrationError(
                f"covariance has {len(self.covariance)} numbers for {len(self.parameter_names)} parameters"
            )
        check_names(self.parameter_names)
        distortion = self.camera_distortion
        if distortion is not None and (distortion.width, distortion.height) != (self.camera_width, self.camera_height):
            raise InvalidCalibrationError(
                f"camera_distortion is that of {distortion.width} x {distortion.height} px, the camera has "
                f"{self.camera_width} x {self.camera_height}"
            )

    @property
    def ray_matrix(self) -> np.ndarray:
        """Matrix (3, 3) from an ideal (column, row, 1) to the direction of its line of sight in the rig frame."""
        column = self.pixel_size / self.pixel_aspect / self.camera_distance
        row = self.pixel_size / self.camera_distance
        untilted = np.array(
            [
                [column, 0.0, -column * self.principal_column],
                [0.0, -row, row * self.principal_row],
                [0.0, 0.0, -1.0],
            ]
        )
        return _rotation_x(self.camera_tilt_x) @ _rotation_y(self.camera_tilt_y) @ untilted

    @property
    def projector_axes(self) -> np.ndarray:
        """Rotation matrix (3, 3): its columns are the projector's right, up and backward axes in the rig frame."""
        forward = -np.array(self.projector_position) / np.linalg.norm(self.projector_position)
        right = np.cross(forward, (0.0, 1.0, 0.0))
        right /= np.linalg.norm(right)
        attitude = np.stack([right, np.cross(right, forward), -forward], axis=1)
        yaw, pitch, roll = self.projector_rotation
        return attitude @ _rotation_y(yaw) @ _rotation_x(pitch) @ _rotation_z(roll)

    def phase(
        self, x: ArrayLike, y: ArrayLike, z: ArrayLike, pitch: float, orientation: Orientation = Orientation.VERTICAL
    ) -> np.ndarray:
        """Return the phase [rad] of fringes of `pitch` [projector px] on the points (x, y, z) [m]."""
        points = np.stack(np.broadcast_arrays(x, y, z), axis=-1).astype(float)
        right, up, backward = np.moveaxis((points - self.projector_position) @ self.projector_axes, -1, 0)
        m, n = -right / backward, -up / backward
        stretch = 1 + self.projector_k1 * (m**2 + n**2)
        along = m if orientation == Orientation.VERTICAL else n
        scale, axis = self._fringes(pitch, orientation)
        return (along * stretch - axis) / scale

    def reconstruct(
        self,
        phase: np.ndarray | xr.DataArray,
        pitch: float,
        sigma_phase: np.ndarray | xr.DataArray | None = None,
        orientation: Orientation = Orientation.VERTICAL,
    ) -> xr.Dataset:
        """Return the surface that a phase map stands for: the corrected eq. 10, for any attitude of the projector.

        Parameters
        ----------
        phase
            Absolute phase [rad], shape (row, column). The coordinates ``row`` and ``column`` of a DataArray tell which
            pixels these are; without, the image begins at pixel (0, 0).
        pitch
            Pitch that the phase belongs to [projector px].
        sigma_phase
            Standard deviation of the phase [rad], the same shape; without, the sigmas of the result are NaN.
        orientation
            Direction of the fringes.

        Returns
        -------
        Dataset
            ``x``, ``y``, ``z`` and their standard deviations ``sigma_x``, ``sigma_y``, ``sigma_z`` [m] from the noise
            of the phase and the covariance of the calibration, |dX/dphi|^2 sigma_phi^2 + J Sigma_p J^T; ``noise_z``
            [m], the part of sigma_z that is the phase's noise; ``dz_dphi`` along the line of sight [m/rad]. All have
            the phase's float type and are NaN where the phase is NaN. The attributes ``camera_distance`` [m] and
            ``ray_matrix`` (row-major) tell the lines of sight of ideal pixels, ``calibration_identifier`` whose they
            are. Errors of the calibration are nearly the
            same for neighbouring pixels; for displacements see `fringedic.rig_uncertainty.displacement_variance`.

        Raises
        ------
        ShapeMismatchError
            When the phase is no image or sigma has another shape.
        """
        image = np.asarray(phase)
        if image.ndim != 2:
            raise ShapeMismatchError(f"phase of shape {image.shape}: an image (row, column) is needed")
        if image.dtype != np.float32:
            image = image.astype(float)
        sigma = np.full((1, 1), np.nan, image.dtype) if sigma_phase is None else np.asarray(sigma_phase, image.dtype)
        if sigma_phase is not None and sigma.shape != image.shape:
            raise ShapeMismatchError(f"sigma of shape {sigma.shape} for a phase of shape {image.shape}")
        row, column = pixel_positions(phase, image.shape)
        # the projector's axes in the order: across the fringes, along them, backward
        axes = self.projector_axes.T[[0, 1, 2] if orientation == Orientation.VERTICAL else [1, 0, 2]]
        ray_matrix = self.ray_matrix
        scale, axis = self._fringes(pitch, orientation)
        distortion = self.camera_distortion
        variances, height = variance_map(self, orientation) if self.covariance else _NO_VARIANCES
        result = np.empty((8, *image.shape), image.dtype)
        _reconstruct(
            np.ascontiguousarray(image),
            np.broadcast_to(sigma, image.shape),
            row,
            column,
            _NO_FIELD if distortion is None else distortion.field(row, column),
            ray_matrix,
            axes @ ray_matrix,
            axes @ (np.array([0.0, 0.0, self.camera_distance]) - self.projector_position),
            self.camera_distance,
            scale,
            axis,
            self.projector_k1,
            variances,
            height,
            np.clip(row / (self.camera_height - 1), 0, 1) * GRID,
            np.searchsorted(column, np.linspace(0, self.camera_width - 1, GRID + 1)[1:-1]),
            (np.clip(column / (self.camera_width - 1), 0, 1) * GRID).astype(image.dtype),
            result,
        )
        names = ("x", "y", "z", "sigma_x", "sigma_y", "sigma_z", "noise_z")
        units = dict.fromkeys(names, "m") | {"dz_dphi": "m/rad"}
        return xr.Dataset(
            {
                name: (("row", "column"), values, {"units": unit})
                for (name, unit), values in zip(units.items(), result, strict=True)
            },
            coords={"row": row, "column": column},
            attrs={
                "camera_distance": self.camera_distance,
                "ray_matrix": ray_matrix.ravel().tolist(),
                "calibration_identifier": self.identifier,
            },
        )

    def paper_model(self, pitch: float) -> PaperModel:
        """Return the paper's closed form of this rig for vertical fringes of `pitch` [projector px].

        Raises
        ------
        InvalidCalibrationError
            When the rig has an attitude, a distortion or a principal point that the closed form cannot express.
        """
        centred = self.projector_principal_column == (self.projector_width - 1) / 2
        beyond = (self.camera_tilt_x, self.camera_tilt_y, self.projector_k1, self.projector_position[1])
        if not centred or any(beyond) or any(self.projector_rotation):
            raise InvalidCalibrationError(
                "the paper's model knows no camera tilt, projector rotation, y position, distortion or shifted "
                "principal column: use reconstruct"
            )
        return PaperModel(
            self.camera_distance,
            self.projector_position[2],
            self.projector_position[0],
            2 * math.pi * self.projector_focal_length / pitch,
        )

    def to_yaml(self, path: str | Path) -> None:
        """Write the model for people: mm, degree and pixels, with the unit in every name."""
        distortion = self.camera_distortion
        content = {
            "identifier": self.identifier,
            "model": self.model,
            "source": self.source,
            **{
                group: {key: _to_people(getattr(self, name), factor) for key, (name, factor) in entries.items()}
                for group, entries in _YAML.items()
            },
            **({} if distortion is None else {"camera_distortion": distortion.to_dict()}),
            "covariance_si": {"parameters": list(self.parameter_names), "values": list(self.covariance)},
        }
        Path(path).write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")

    @classmethod
    def from_yaml(cls, path: str | Path) -> RigModel:
        """Read a model that `to_yaml` wrote.

        Raises
        ------
        InvalidCalibrationError
            When the file is no such model, or a parameter is missing or has no meaning.
        """
        try:
            content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
            values: dict[str, Any] = {
                name: _from_people(content[group][key], factor)
                for group, entries in _YAML.items()
                for key, (name, factor) in entries.items()
            }
            covariance = content.get("covariance_si", {"parameters": [], "values": []})
            distortion = content.get("camera_distortion")
            return cls(
                **values,
                camera_distortion=None if distortion is None else DistortionMap.from_dict(distortion),
                identifier=content["identifier"],
                model=content["model"],
                source=content["source"],
                parameter_names=tuple(covariance["parameters"]),
                covariance=tuple(covariance["values"]),
            )
        except (InvalidCalibrationError, InvalidDistortionError) as error:
            raise InvalidCalibrationError(f"{path}: {error}") from None
        except KeyError as error:
            raise InvalidCalibrationError(f"{path}: {error.args[0]} is missing") from None
        except (yaml.YAMLError, TypeError, AttributeError) as error:
            raise InvalidCalibrationError(f"{path} is not the calibration of a rig: {error}") from None

    def message_fields(self) -> dict[str, Any]:
        """Return the fields of ``fringedic_msgs/RigCalibration`` as plain numbers and lists, all but its header.

        Without a distortion its fields are left out, at their defaults.
        """
        names = [each.name for each in fields(self) if each.name != "camera_distortion"]
        values = {name: getattr(self, name) for name in names}
        content = {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}
        if self.camera_distortion is not None:
            content["distortion_order"] = self.camera_distortion.order
            content["distortion_columns"] = self.camera_distortion.columns.ravel().tolist()
            content["distortion_rows"] = self.camera_distortion.rows.ravel().tolist()
        return content

    @classmethod
    def from_message(cls, message: Any) -> RigModel:
        """Read any object with the attributes of ``fringedic_msgs/RigCalibration``, those of older recordings too.

        Raises
        ------
        InvalidCalibrationError
            When a parameter has no meaning.
        """
        values: dict[str, Any] = {}
        for each in fields(cls):
            if each.name != "camera_distortion":
                value = getattr(message, each.name)
                has_many = hasattr(value, "__len__") and not isinstance(value, str)
                values[each.name] = tuple(np.asarray(value).tolist()) if has_many else value
        # messages of before the distortion was measured lack its fields
        columns, rows = (np.asarray(getattr(message, f"distortion_{name}", ()), float) for name in ("columns", "rows"))
        if columns.size or rows.size:
            count = int(message.distortion_order) + 1
            if not columns.size == rows.size == count**2:
                raise InvalidCalibrationError(
                    f"distortion of order {count - 1} with {columns.size} and {rows.size} coefficients: "
                    f"{count**2} are needed"
                )
            width, height = int(message.camera_width), int(message.camera_height)
            values["camera_distortion"] = DistortionMap(
                width, height, columns.reshape(count, count), rows.reshape(count, count)
            )
        return cls(**values)

    def _fringes(self, pitch: float, orientation: Orientation) -> tuple[float, float]:
        """Return (scale, axis): the distorted normalised coordinate across the fringes is ``scale * phi + axis``."""
        scale = pitch / (2 * math.pi * self.projector_focal_length)
        if orientation == Orientation.VERTICAL:
            offset = (self.projector_width - 1) / 2 - self.projector_principal_column
        else:
            offset = self.projector_principal_row - (self.projector_height - 1) / 2
        return scale, offset / self.projector_focal_length


@dataclass(frozen=True)
class PaperModel:
    """The paper's closed form (eq. 10, signs corrected): both axes meet in the origin, fringes along y.

    Attributes
    ----------
    camera_distance, projector_distance
        h0 and hp, heights of the pin-holes above the reference plane [m].
    base
        d, distance of the projector from the camera's axis [m], negative on the left.
    sensitivity
        K = 2 pi f_p / P_t [rad], projector focal length over fringe pitch.
    """

    camera_distance: float
    projector_distance: float
    base: float
    sensitivity: float

    def phase(self, x: ArrayLike, z: ArrayLike) -> np.ndarray:
        """Return the phase [rad] on points at x and z [m]."""
        x, z = np.asarray(x, float), np.asarray(z, float)
        d, hp = self.base, self.projector_distance
        return self.sensitivity * (x * hp - z * d) / (d**2 + hp**2 - x * d - z * hp)

    def position(
        self, phase: ArrayLike, reference_x: ArrayLike, reference_y: ArrayLike
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x, y, z [m] of pixels that would see (`reference_x`, `reference_y`) [m] on the reference plane."""
        phi, big_x, big_y = (np.asarray(each, float) for each in (phase, reference_x, reference_y))
        h0 = self.camera_distance
        numerator = self._e(phi) * big_x - self._length_squared * phi
        z = h0 * numerator / self._denominator(phi, big_x)
        return (h0 - z) * big_x / h0, (h0 - z) * big_y / h0, z

    def dz_dphi(self, phase: ArrayLike, reference_x: ArrayLike) -> np.ndarray:
        """Return the derivative of z by the phase along the line of sight [m/rad]."""
        phi, big_x = np.asarray(phase, float), np.asarray(reference_x, float)
        h0, hp, d = self.camera_distance, self.projector_distance, self.base
        growth = h0 * self.sensitivity * self._length_squared * ((h0 - hp) * big_x - h0 * d)
        return growth / self._denominator(phi, big_x) ** 2

    @property
    def _length_squared(self) -> float:
        return self.base**2 + self.projector_distance**2

    def _e(self, phi: np.ndarray) -> np.ndarray:
        return self.sensitivity * self.projector_distance + self.base * phi

    def _denominator(self, phi: np.ndarray, big_x: np.ndarray) -> np.ndarray:
        opposite = self.sensitivity * self.base - self.projector_distance * phi
        return self._e(phi) * big_x + self.camera_distance * opposite


def pixel_positions(image: np.ndarray | xr.DataArray | xr.Dataset, shape: tuple[int, ...]) -> tuple[np.ndarray, ...]:
    """Return the rows and the columns [px] of an image: its coordinates, or a count from 0 when it has none."""
    coordinates: Mapping = image.coords if isinstance(image, xr.DataArray | xr.Dataset) else {}
    return tuple(
        np.asarray(coordinates[name], float) if name in coordinates else np.arange(length, dtype=float)
        for name, length in zip(("row", "column"), shape, strict=True)
    )


@njit(cache=True, nogil=True, parallel=True)
def _reconstruct(
    phase: np.ndarray,
    sigma: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    to_ideal: np.ndarray,
    ray_matrix: np.ndarray,
    ray_in_projector: np.ndarray,
    camera_in_projector: np.ndarray,
    camera_distance: float,
    scale: float,
    axis: float,
    k1: float,
    variances: np.ndarray,
    height: float,
    places: np.ndarray,
    borders: np.ndarray,
    along_row: np.ndarray,
    result: np.ndarray,
) -> None:
    """Meet the line of sight, camera + t direction, with the fringe ``m (1 + k1 (m^2 + n^2)) = scale phi + axis``.

    ``to_ideal`` is the field from the pixels to ideal ones, or empty. ``variances`` and ``height`` are those of
    `fringedic.rig_uncertainty.variance_map`, or empty: ``places`` and ``along_row`` are the rows and columns in steps
    of its grid, ``borders`` the indices of the columns at which its cells begin.
    """
    camera_m, camera_n, camera_back = camera_in_projector
    distorted = to_ideal.size > 0
    for i in prange(phase.shape[0]):
        for j in range(phase.shape[1]):
            r, s = columns[j], rows[i]
            if distorted:
                r += to_ideal[0, i, j]
                s += to_ideal[1, i, j]
            dx = ray_matrix[0, 0] * r + ray_matrix[0, 1] * s + ray_matrix[0, 2]
            dy = ray_matrix[1, 0] * r + ray_matrix[1, 1] * s + ray_matrix[1, 2]
            dz = ray_matrix[2, 0] * r + ray_matrix[2, 1] * s + ray_matrix[2, 2]
            g_m = ray_in_projector[0, 0] * r + ray_in_projector[0, 1] * s + ray_in_projector[0, 2]
            g_n = ray_in_projector[1, 0] * r + ray_in_projector[1, 1] * s + ray_in_projector[1, 2]
            g_back = ray_in_projector[2, 0] * r + ray_in_projector[2, 1] * s + ray_in_projector[2, 2]
            target = scale * phase[i, j] + axis
            denominator = g_m + target * g_back
            t = -(camera_m + target * camera_back) / denominator
            slope = -denominator / (camera_back + t * g_back)
            if k1 != 0.0:
                for _ in range(_NEWTON_STEPS):
                    inverse = -1.0 / (camera_back + t * g_back)
                    m = (camera_m + t * g_m) * inverse
                    n = (camera_n + t * g_n) * inverse
                    m_t = (g_m + m * g_back) * inverse
                    n_t = (g_n + n * g_back) * inverse
                    slope = m_t * (1.0 + k1 * (3.0 * m * m + n * n)) + 2.0 * k1 * m * n * n_t
                    step = (m * (1.0 + k1 * (m * m + n * n)) - target) / slope
                    t -= step
                    if abs(step) < _NEWTON_ENDS * abs(t):
                        break
            growth = scale / slope
            noise = abs(growth) * sigma[i, j]
            z = camera_distance + t * dz
            result[0, i, j] = t * dx
            result[1, i, j] = t * dy
            result[2, i, j] = z
            result[3, i, j] = abs(dx) * noise
            result[4, i, j] = abs(dy) * noise
            result[5, i, j] = abs(dz) * noise
            result[6, i, j] = abs(dz) * noise
            result[7, i, j] = dz * growth
        if variances.size > 0:
            _add_variances(result, i, places[i], borders, along_row, variances, height)


@njit(cache=True, nogil=True)
def _add_variances(
    result: np.ndarray,
    i: int,
    place: float,
    borders: np.ndarray,
    where: np.ndarray,
    variances: np.ndarray,
    height: float,
) -> None:
    """Add the calibration's variances to the sigmas of one row, cell by cell: plain loops that run as vectors."""
    zero, one = result.dtype.type(0.0), result.dtype.type(1.0)
    per_height = result.dtype.type(1.0 / height)
    above = min(int(place), variances.shape[0] - 2)
    share = place - above
    cells = variances.shape[1] - 1
    at = ((1.0 - share) * variances[above] + share * variances[above + 1]).astype(result.dtype)
    to = at[1:] - at[:-1]
    heights = result[2, i]
    for k in range(3):
        sigmas = result[3 + k, i]
        for cell in range(cells):
            first = 0 if cell == 0 else borders[cell - 1]
            end = result.shape[2] if cell == cells - 1 else borders[cell]
            a0, a1, a2, a3, a4 = at[cell, k, 0], at[cell, k, 1], at[cell, k, 2], at[cell, k, 3], at[cell, k, 4]
            b0, b1, b2, b3, b4 = to[cell, k, 0], to[cell, k, 1], to[cell, k, 2], to[cell, k, 3], to[cell, k, 4]
            begin = result.dtype.type(cell)  # an integer would turn all into 64 bits
            for j in range(first, end):
                along = where[j] - begin
                z = heights[j] * per_height
                z = z if z < one else one
                z = z if z > -one else -one
                at_left = a0 + z * (a1 + z * (a2 + z * (a3 + z * a4)))
                growth = b0 + z * (b1 + z * (b2 + z * (b3 + z * b4)))
                variance = at_left + along * growth
                variance = variance if variance > zero else zero
                sigmas[j] = np.sqrt(sigmas[j] * sigmas[j] + variance)


def _rotation_x(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _rotation_y(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _rotation_z(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


_NO_NUMBERS = ("identifier", "model", "source", "parameter_names", "camera_distortion")
_NUMBERS = tuple(each.name for each in fields(RigModel) if each.name not in _NO_NUMBERS)
_TUPLES = ("projector_position", "projector_rotation", "parameter_names", "covariance")
_POSITIVE = (
    "camera_width",
    "camera_height",
    "camera_distance",
    "pixel_size",
    "pixel_aspect",
    "projector_width",
    "projector_height",
    "projector_focal_length",
)
_MM, _DEGREE, _ONE = 1e-3, math.pi / 180, 1
_YAML: dict[str, dict[str, tuple[str, float]]] = {
    "camera": {
        "width_px": ("camera_width", _ONE),
        "height_px": ("camera_height", _ONE),
        "distance_mm": ("camera_distance", _MM),
        "pixel_size_mm": ("pixel_size", _MM),
        "pixel_aspect": ("pixel_aspect", _ONE),
        "principal_column_px": ("principal_column", _ONE),
        "principal_row_px": ("principal_row", _ONE),
        "tilt_x_degree": ("camera_tilt_x", _DEGREE),
        "tilt_y_degree": ("camera_tilt_y", _DEGREE),
    },
    "projector": {
        "width_px": ("projector_width", _ONE),
        "height_px": ("projector_height", _ONE),
        "position_mm": ("projector_position", _MM),
        "yaw_pitch_roll_degree": ("projector_rotation", _DEGREE),
        "focal_length_px": ("projector_focal_length", _ONE),
        "principal_column_px": ("projector_principal_column", _ONE),
        "principal_row_px": ("projector_principal_row", _ONE),
        "k1": ("projector_k1", _ONE),
    },
}


def _to_people(value: float | tuple[float, ...], unit: float) -> float | list[float]:
    if isinstance(value, tuple):
        return [each / unit for each in value]
    return value if unit == _ONE else value / unit


def _from_people(value: float | list[float], unit: float) -> float | tuple[float, ...]:
    if isinstance(value, list):
        return tuple(each * unit for each in value)
    return value if unit == _ONE else value * unit
