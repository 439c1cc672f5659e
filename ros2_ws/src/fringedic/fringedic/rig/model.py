"""The calibrated rig: pin-hole model of camera and projector, its reconstruction, files and message."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fringedic.errors import CalibrationError, GridError, ImageError
from fringedic.patterns.pattern import Orientation
from fringedic.rig.files import parse_rig, read_rig, write_rig
from fringedic.rig.geometry import RigGeometry
from fringedic.rig.messages import fields_of_rig, rig_of_fields
from fringedic.rig.six_parameter import SixParameterModel
from fringedic.wording.arguments import array, check_arguments, number, optional

if TYPE_CHECKING:
    import xarray as xr


@dataclass(frozen=True)
class RigModel(RigGeometry):
    """Pin-hole model of camera and projector, the content of the message ``fringedic_msgs/RigCalibration`` (SI).

    Rig frame ``reference_plane``, right-handed: z = 0 is the reference plane, z towards the camera, x to the right of
    the image, y up in the image. The camera's pin-hole is at (0, 0, h0), the projector's at (d, y, hp).

    Attributes
    ----------
    camera_width, camera_height
        Size of the camera's image [px].
    camera_first_column, camera_first_row
        Pixel of the sensor with which the image begins [px]; -1 when it is not known.
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
        From the pixels of the image to ideal pixels; None for an ideal camera.
    projector_width, projector_height
        Size of the projector's image [px].
    projector_position
        (d, y, hp) of the projector's pin-hole [m].
    projector_rotation
        (yaw, pitch, roll) [rad] about the projector's own up, right and backward axes, in this order, relative to the
        attitude that looks at the origin with its columns growing towards +x.
    projector_focal_length
        F [projector px].
    projector_principal_column, projector_principal_row
        Position of the projector's optical axis in its image [px].
    projector_k1, projector_k2, projector_p1, projector_p2, projector_k3
        Distortion of the projector's lens (Brown 1971) with the signs of OpenCV: radial k, tangential p.
    sensor
        Name of the sensor, this camera with this projector.
    identifier, model, source
        Name of this calibration, ``"six_parameter"`` or ``"general"``, and its origin. The name ``"paper"`` of older
        files is accepted for the six-parameter model.
    parameter_names, covariance
        Fitted parameters, names out of `fringedic.rig.geometry.PARAMETERS`, and their covariance, row-major (SI and
        px); empty when unknown.

    Raises
    ------
    CalibrationError
        A parameter is not finite, is not positive although it has to be, or does not fit the others.

    References
    ----------
    J. Molimard, G. Boyer, H. Zahouani, "Frequency-based image analysis of random patterns: an alternative way to
    classical stereocorrelation", eq. 10: the six-parameter model.

    C. Breque, J.-C. Dupre, F. Bremand, "Calibration of a system of projection moire for relief measuring: biomechanical
    applications", Optics and Lasers in Engineering 41 (2004) 241-260.

    D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37 (1971) 855-866: radial distortion.

    Examples
    --------
    The phase of the reference plane is reconstructed as z = 0:

    >>> import numpy as np
    >>> from fringedic import RigModel
    >>> rig = RigModel(
    ...     camera_width=160, camera_height=120, camera_distance=0.8, pixel_size=400e-6, pixel_aspect=1.0,
    ...     principal_column=79.5, principal_row=59.5, projector_width=800, projector_height=600,
    ...     projector_position=(-0.3, 0.0, 0.9), projector_focal_length=1200.0,
    ...     projector_principal_column=399.5, projector_principal_row=299.5,
    ... )
    >>> column, row = np.meshgrid(np.arange(160.0), np.arange(120.0))
    >>> x, y = 400e-6 * (column - 79.5), 400e-6 * (59.5 - row)
    >>> surface = rig.reconstruct(rig.phase(x, y, 0.0, pitch=10.0), pitch=10.0)
    >>> bool(abs(surface.z).max() < 1e-12), bool(np.allclose(surface.x, x))
    (True, True)
    """

    @check_arguments(
        ImageError, phase=array(2, infinite=True), pitch=number(), sigma_phase=optional(array(2, infinite=True))
    )
    def reconstruct(
        self,
        phase: np.ndarray | xr.DataArray,
        pitch: float,
        sigma_phase: np.ndarray | xr.DataArray | None = None,
        orientation: Orientation = Orientation.VERTICAL,
    ) -> xr.Dataset:
        """Return the surface of a phase map: eq. 10 with corrected signs, for any attitude of the projector.

        Parameters
        ----------
        phase
            Absolute phase [rad], float32 or float64, shape (row, column), NaN where not measured. The coordinates
            ``row`` and ``column`` of a DataArray are pixel positions in the image; without them the image begins at
            pixel (0, 0).
        pitch
            Pitch that the phase belongs to [projector px].
        sigma_phase
            Standard deviation of the phase [rad], the same shape; without it the sigmas of the result are NaN.
        orientation
            Direction of the fringes.

        Returns
        -------
        Dataset
            ``x``, ``y``, ``z`` and their standard deviations ``sigma_x``, ``sigma_y``, ``sigma_z`` [m] from the noise
            of the phase and the covariance of the calibration, (dX/dphi)^2 sigma_phi^2 + J Sigma_p J^T; ``noise_z``
            [m], the part of sigma_z due to the noise of the phase; ``dz_dphi`` along the line of sight [m/rad]. All
            have the dimensions (row, column) and the phase's float type, and are NaN where the phase is NaN. The
            attributes ``camera_distance`` [m] and ``ray_matrix`` (row-major) describe the lines of sight of ideal
            pixels; ``calibration_identifier`` names the calibration. Errors of the calibration are nearly equal for
            neighbouring pixels; for displacements see `fringedic.rig.uncertainty.displacement_variance`.

        Raises
        ------
        ImageError
            The phase is not an image (row, column), or sigma has another shape.
        """
        from fringedic.rig.reconstruction import reconstruct_surface  # loads xarray and Numba: many nodes need neither

        return reconstruct_surface(self, phase, pitch, sigma_phase, orientation)

    def six_parameter_model(self, pitch: float) -> SixParameterModel:
        """Return the closed form of this rig for vertical fringes of `pitch` [projector px].

        Raises
        ------
        CalibrationError
            The rig has an attitude, a distortion or a principal point that the closed form does not contain.
        """
        centred = self.projector_principal_column == (self.projector_width - 1) / 2
        beyond = (
            self.camera_tilt_x,
            self.camera_tilt_y,
            *self.projector_lens(Orientation.VERTICAL),
            self.projector_position[1],
        )
        if not centred or any(beyond) or any(self.projector_rotation):
            raise CalibrationError(
                "the six-parameter model contains no camera tilt, projector rotation, y position, distortion or "
                "shifted principal column: use reconstruct"
            )
        return SixParameterModel(
            self.camera_distance,
            self.projector_position[2],
            self.projector_position[0],
            2 * math.pi * self.projector_focal_length / pitch,
        )

    def to_yaml(self, path: str | Path) -> None:
        """Write the model for people: mm, degree and pixels, with the unit in every name."""
        write_rig(self, path)

    @classmethod
    def from_yaml(cls, path: str | Path) -> RigModel:
        """Read a model that `to_yaml` wrote.

        Raises
        ------
        CalibrationError
            The file is not such a model, or a parameter is missing or not allowed.
        """
        try:
            return cls(**read_rig(path))
        except (CalibrationError, GridError) as error:
            raise CalibrationError(f"{path}: {error}") from None

    @classmethod
    def from_text(cls, text: str) -> RigModel:
        """Read a model from the text of a file that `to_yaml` wrote.

        Raises
        ------
        CalibrationError, GridError
            The text is not such a model, or a parameter is missing or not allowed.
        """
        return cls(**parse_rig(text))

    def message_fields(self) -> dict[str, Any]:
        """Return the fields of ``fringedic_msgs/RigCalibration`` as plain numbers and lists, without its header.

        The fields of the distortion are omitted when the camera has none.
        """
        return fields_of_rig(self)

    @classmethod
    def from_message(cls, message: Any) -> RigModel:
        """Read any object with the attributes of ``fringedic_msgs/RigCalibration``, also of older recordings.

        Raises
        ------
        CalibrationError
            A parameter is not allowed.
        """
        return cls(**rig_of_fields(message))
