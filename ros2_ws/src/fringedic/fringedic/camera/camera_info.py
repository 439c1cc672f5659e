"""Calibrations of a single camera by other programs: ``ost.yaml`` and ``camera_info`` of ROS, which give its lens."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Self

import cv2
import numpy as np
from numpy.polynomial import chebyshev

from fringedic.errors import GridError

_MODELS = ("plumb_bob", "rational_polynomial", "equidistant")
_ORDER = 12  # of the polynomials; wide lenses of 100 degrees leave less than a hundredth of a pixel
_LARGEST_PX = 0.01  # deviation of the polynomials at the pixels between their nodes
_PRECISE = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)


class CameraInfo(NamedTuple):
    """Lens of a camera in the form of ROS.

    Attributes
    ----------
    width, height
        Size of the image [px].
    matrix : (3, 3)
        From normalised coordinates to pixels.
    model
        ``plumb_bob``, ``rational_polynomial`` or ``equidistant``.
    coefficients
        Of the model, in its order.
    """

    width: int
    height: int
    matrix: np.ndarray
    model: str
    coefficients: np.ndarray

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Self:
        """Read the content of ``ost.yaml``, or of a message on ``camera_info`` as ``ros2 topic echo`` prints it.

        Raises
        ------
        GridError
            An entry is missing or not allowed; the message names it.
        """
        named = ("image_width", "image_height", "camera_matrix", "distortion_coefficients")
        width, height, matrix, coefficients = named if "camera_matrix" in content else ("width", "height", "k", "d")
        try:
            model = str(content["distortion_model"])
            found = cls(
                int(content[width]),
                int(content[height]),
                _numbers(content[matrix]).reshape(3, 3),
                model,
                _numbers(content[coefficients]),
            )
        except KeyError as error:
            raise GridError(f"{error.args[0]} is missing in this calibration of a camera") from None
        except (TypeError, ValueError) as error:
            raise GridError(f"this is not the calibration of a camera: {error}") from None
        if model not in _MODELS:
            raise GridError(f"distortion_model '{model}' is not supported; known are {', '.join(_MODELS)}")
        if min(found.width, found.height) < 2 or not np.isfinite(found.matrix).all() or found.matrix[0, 0] <= 0:
            raise GridError("this camera is not calibrated: its size or its focal length is not larger than zero")
        return found

    def polynomials(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the coefficients of a `DistortionMap`: of its columns and of its rows, (order + 1, order + 1).

        Raises
        ------
        GridError
            The lens model cannot be inverted within the image.
        """
        nodes = np.cos(np.pi * (np.arange(_ORDER + 1) + 0.5) / (_ORDER + 1))
        inverse = np.linalg.inv(chebyshev.chebvander(nodes, _ORDER))
        columns, rows = (inverse @ each @ inverse.T for each in self._field(nodes))
        between = np.linspace(-1, 1, 2 * _ORDER)
        for each, exact in zip((columns, rows), self._field(between), strict=True):
            error = np.abs(chebyshev.chebgrid2d(between, between, each) - exact)
            if not np.max(error) < _LARGEST_PX:
                raise GridError(
                    "the lens model of this calibration of a camera cannot be inverted within its whole image: "
                    "calibrate the camera with targets up to the corners"
                )
        return columns, rows

    def _field(self, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the two components of U [px] at relative positions from -1 to 1, as rows and columns of a grid."""
        column, row = np.meshgrid(0.5 * (self.width - 1) * (positions + 1), 0.5 * (self.height - 1) * (positions + 1))
        seen = np.stack([column.ravel(), row.ravel()], axis=-1)[:, None]
        matrix, coefficients = self.matrix, self.coefficients
        if self.model == "equidistant":
            ideal = cv2.fisheye.undistortPoints(seen, matrix, coefficients[:4], P=matrix, criteria=_PRECISE)
        else:
            ideal = cv2.undistortPoints(seen, matrix, coefficients, P=matrix, criteria=_PRECISE)
        shape = column.shape
        return ideal[:, 0, 0].reshape(shape) - column, ideal[:, 0, 1].reshape(shape) - row


def is_camera_info(content: Any) -> bool:
    """Return whether the content of a YAML file is the calibration of a single camera.

    Examples
    --------
    >>> is_camera_info({"image_width": 640, "camera_matrix": {}}), is_camera_info({"k": [], "d": []})
    (True, True)
    """
    return isinstance(content, Mapping) and ("camera_matrix" in content or {"k", "d"} <= content.keys())


def _numbers(entry: Any) -> np.ndarray:
    return np.array(entry["data"] if isinstance(entry, Mapping) else entry, float)
