"""Distortion of a camera as two polynomials over its image, without a lens model.

An ideal camera images straight lines as straight lines. The distortion is the field U(p) = p_u - p [px]: a point that
is seen at the pixel p of the image would be seen at p_u by the ideal camera. The other direction is D(p_u) = p - p_u,
the D of section 2.4: a point at q in the ideal camera is seen at q + D(q), and D(p_u) = -U(p). Images are not resampled
for measurements; a pixel p has the line of sight of its ideal pixel p_u.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
import yaml
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from fringedic.camera.camera_info import CameraInfo, is_camera_info
from fringedic.errors import GridError, ImageError
from fringedic.wording.arguments import array, check_value, whole
from fringedic.wording.causes import cause_of
from fringedic.wording.sealed_yaml import sealed, unsealed
from fringedic.wording.yaml_text import load_yaml

_INVERSE_STEPS = 60  # a field with a gradient below 0.6 px per pixel is inverted to 1e-12 px
_CONVERGED = 1e-10  # [px]
_BROWN_POINTS = (25, 33)  # rows and columns of the grid that a Brown model is fitted to


class BrownModel(NamedTuple):
    """Distortion in the form of Brown and Conrady, as OpenCV and ROS ("plumb_bob") write it.

    Attributes
    ----------
    coefficients
        (k1, k2, p1, p2, k3).
    camera_matrix : (3, 3)
        From normalised distorted coordinates to the pixels of the image.
    ideal_camera_matrix : (3, 3)
        From normalised undistorted coordinates to ideal pixels.
    residual
        Root mean square residual of this model over the image [px].

    References
    ----------
    D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37 (1971) 855-866.
    """

    coefficients: tuple[float, float, float, float, float]
    camera_matrix: np.ndarray
    ideal_camera_matrix: np.ndarray
    residual: float


@dataclass(frozen=True, eq=False)
class DistortionMap:
    """Field U(p) = p_u - p [px] from the pixels of an image to those of an ideal camera.

    An ideal camera after any homography is ideal as well; this class takes p_u as given. `fringedic.measure_distortion`
    chooses the homography for which value and first derivatives of U are zero at the centre of the image.

    Attributes
    ----------
    width, height
        Size of the image [px].
    columns, rows : (order + 1, order + 1)
        Coefficients [px] of the two components of U: entry (i, j) belongs to T_i(b) T_j(a) with the Chebyshev
        polynomials T and a = 2 column / (width - 1) - 1, b = 2 row / (height - 1) - 1. Read-only.

    Raises
    ------
    GridError
        The coefficients are not finite square arrays of equal size, or the image is smaller than 2 x 2 px.

    Examples
    --------
    A field that shifts the upper left corner of the image by 0.5 px to the right and keeps the opposite corner:

    >>> import numpy as np
    >>> from fringedic.camera import DistortionMap
    >>> coefficients = np.zeros((2, 2))
    >>> coefficients[0, 0], coefficients[0, 1] = 0.25, -0.25
    >>> lens = DistortionMap(640, 480, coefficients, np.zeros((2, 2)))
    >>> column, row = lens.ideal(0.0, 0.0)
    >>> float(column), float(row)
    (0.5, 0.0)
    >>> column, row = lens.seen(column, row)
    >>> bool(abs(column) < 1e-9)
    True
    """

    width: int
    height: int
    columns: np.ndarray
    rows: np.ndarray

    def __post_init__(self) -> None:
        for name, check in (("width", whole()), ("height", whole()), ("columns", array(2)), ("rows", array(2))):
            object.__setattr__(self, name, check_value(GridError, name, getattr(self, name), check))
        if min(self.width, self.height) < 2:
            raise GridError(f"an image of {self.width} x {self.height} px has no distortion")
        for name in ("columns", "rows"):
            values = np.array(getattr(self, name), float)
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        shape = self.columns.shape
        if len(shape) != 2 or shape[0] != shape[1] or shape[0] == 0 or self.rows.shape != shape:
            raise GridError(f"coefficients of shapes {shape} and {self.rows.shape}: two equal square arrays are needed")
        if not (np.isfinite(self.columns).all() and np.isfinite(self.rows).all()):
            raise GridError("a coefficient of the distortion is not a finite number")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, DistortionMap) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @cached_property
    def _key(self) -> tuple[int, int, bytes, bytes]:
        # adding 0 turns -0 into 0, which is the same field
        return self.width, self.height, (self.columns + 0.0).tobytes(), (self.rows + 0.0).tobytes()

    @property
    def order(self) -> int:
        """Highest degree along one direction of the image."""
        return len(self.columns) - 1

    def ideal(self, column: ArrayLike, row: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Return the ideal pixels [px] of the pixels (column, row), float64 in their shape."""
        column, row = np.broadcast_arrays(np.asarray(column, float), np.asarray(row, float))
        a, b = 2 * column / (self.width - 1) - 1, 2 * row / (self.height - 1) - 1
        return column + chebyshev.chebval2d(b, a, self.columns), row + chebyshev.chebval2d(b, a, self.rows)

    def seen(self, column: ArrayLike, row: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Return the pixels [px] of the ideal pixels (column, row), float64 in their shape.

        The inverse of `ideal`; NaN where there is no inverse, far outside the image.
        """
        column, row = np.broadcast_arrays(np.asarray(column, float), np.asarray(row, float))
        seen_column, seen_row = column.copy(), row.copy()
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(_INVERSE_STEPS):
                ideal_column, ideal_row = self.ideal(seen_column, seen_row)
                error = np.maximum(np.abs(ideal_column - column), np.abs(ideal_row - row))
                seen_column, seen_row = seen_column + (column - ideal_column), seen_row + (row - ideal_row)
                if not (error > _CONVERGED).any():
                    break
            lost = ~(error <= _CONVERGED)
        return np.where(lost, np.nan, seen_column), np.where(lost, np.nan, seen_row)

    def field(self, rows: ArrayLike | None = None, columns: ArrayLike | None = None) -> np.ndarray:
        """Return U on the grid of `rows` and `columns` [px]; by default at every pixel.

        Returns
        -------
        ndarray
            float32 (2, rows, columns): components of U along x (right) and along y (down) [px]; read-only, and cached
            for the next call with the same pixels.
        """
        rows = np.arange(self.height, dtype=float) if rows is None else np.asarray(rows, float)
        columns = np.arange(self.width, dtype=float) if columns is None else np.asarray(columns, float)
        key = (rows.tobytes(), columns.tobytes())
        kept = self.__dict__.get("_kept_field")
        if kept is None or kept[0] != key:
            a, b = 2 * columns / (self.width - 1) - 1, 2 * rows / (self.height - 1) - 1
            # elementwise sums give the same bits with any number of threads, matrix products may not
            values = np.stack(
                [chebyshev.chebgrid2d(b, a, each) for each in (self.columns, self.rows)], dtype=np.float32
            )
            values.setflags(write=False)
            kept = key, values
            self.__dict__["_kept_field"] = kept
        return kept[1]

    def followed_by(self, homography: np.ndarray) -> Self:
        """Return the same lens for an ideal camera whose pixels are those of this one mapped by a homography (3, 3).

        The result is not a polynomial; for tilts of a degree two additional orders approximate it within 1e-6 px.
        """
        order = max(self.order, 2) + 2
        nodes = np.cos(np.pi * (np.arange(order + 1) + 0.5) / (order + 1))
        column, row = np.meshgrid(0.5 * (self.width - 1) * (nodes + 1), 0.5 * (self.height - 1) * (nodes + 1))
        ideal = np.stack([*self.ideal(column, row), np.ones(column.shape)])
        mapped = np.tensordot(homography, ideal, axes=1)
        inverse = np.linalg.inv(chebyshev.chebvander(nodes, order))
        fields = [inverse @ (mapped[k] / mapped[2] - at) @ inverse.T for k, at in enumerate((column, row))]
        return type(self)(self.width, self.height, *fields)

    def undistort(self, image: np.ndarray) -> np.ndarray:
        """Return the image that an ideal camera would have taken, for display (cubic splines).

        Parameters
        ----------
        image : (row, column)
            Of the size that the distortion was measured with.

        Returns
        -------
        ndarray
            float32 (row, column): ``undistorted(q) = image(q + D(q))``, NaN where q + D(q) is outside the image.

        Raises
        ------
        ImageError
            The image has another size.
        """
        from scipy.ndimage import map_coordinates

        if np.shape(image) != (self.height, self.width):
            raise ImageError(
                f"image of shape {np.shape(image)} for the distortion of {self.height} rows and {self.width} columns"
            )
        row, column = np.mgrid[: self.height, : self.width]
        seen_column, seen_row = self.seen(column, row)
        return map_coordinates(
            np.asarray(image, np.float32), [seen_row, seen_column], order=3, mode="constant", cval=float("nan")
        )

    def brown(self, ideal_camera_matrix: ArrayLike | None = None) -> BrownModel:
        """Return the nearest model of Brown and Conrady, for other programs.

        Parameters
        ----------
        ideal_camera_matrix : (3, 3)
            From normalised coordinates to ideal pixels. The coefficients scale with its focal length; by default the
            focal length is the width of the image and the principal point its centre.

        Returns
        -------
        BrownModel
            Fitted by least squares over the image, including focal lengths and principal point of the distorted image.

        References
        ----------
        D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37 (1971) 855-866.
        """
        from scipy.optimize import least_squares

        if ideal_camera_matrix is None:
            centre = 0.5 * (self.width - 1), 0.5 * (self.height - 1)
            ideal_camera_matrix = np.array([[self.width, 0, centre[0]], [0, self.width, centre[1]], [0, 0, 1.0]])
        matrix = np.asarray(ideal_camera_matrix, float)
        row, column = np.meshgrid(
            np.linspace(0, self.height - 1, _BROWN_POINTS[0]),
            np.linspace(0, self.width - 1, _BROWN_POINTS[1]),
            indexing="ij",
        )
        ideal_column, ideal_row = self.ideal(column, row)
        x, y = (ideal_column - matrix[0, 2]) / matrix[0, 0], (ideal_row - matrix[1, 2]) / matrix[1, 1]
        # normalised to the corner of the image, so that all nine parameters have similar effects
        reach = float(np.sqrt(np.max(x**2 + y**2)))
        x, y = x / reach, y / reach
        scale = np.array([matrix[0, 0] * reach, matrix[1, 1] * reach])

        def residuals(p: np.ndarray) -> np.ndarray:
            k1, k2, p1, p2, k3 = p[:5]
            square = x**2 + y**2
            radial = 1 + square * (k1 + square * (k2 + square * k3))
            bent_x = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x**2)
            bent_y = y * radial + p1 * (square + 2 * y**2) + 2 * p2 * x * y
            fitted_column = scale[0] * (1 + p[5]) * bent_x + matrix[0, 2] + scale[0] * p[7]
            fitted_row = scale[1] * (1 + p[6]) * bent_y + matrix[1, 2] + scale[1] * p[8]
            return np.concatenate([(fitted_column - column).ravel(), (fitted_row - row).ravel()])

        fit = least_squares(residuals, np.zeros(9), xtol=1e-14, ftol=1e-14, gtol=1e-14)
        k1, k2, p1, p2, k3 = (float(value) for value in fit.x[:5] / reach ** np.array([2, 4, 1, 1, 6]))
        seen_matrix = np.diag([matrix[0, 0] * (1 + fit.x[5]), matrix[1, 1] * (1 + fit.x[6]), 1.0])
        seen_matrix[:2, 2] = matrix[:2, 2] + scale * fit.x[7:]
        residual = float(np.sqrt(2 * np.mean(fit.fun**2)))
        return BrownModel((k1, k2, p1, p2, k3), seen_matrix, matrix, residual)

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers and lists, for YAML."""
        return {
            "width_px": self.width,
            "height_px": self.height,
            "columns_px": self.columns.tolist(),
            "rows_px": self.rows.tolist(),
        }

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> Self:
        """Read what `to_dict` returned.

        Raises
        ------
        GridError
            An entry is missing or not allowed.
        """
        try:
            return cls(
                content["width_px"],
                content["height_px"],
                np.array(content["columns_px"], float),
                np.array(content["rows_px"], float),
            )
        except KeyError as error:
            raise GridError(f"{error.args[0]} is missing") from None
        except (TypeError, ValueError) as error:
            raise GridError(f"this is not the distortion of a camera: {error}") from None

    def save(self, path: str | Path) -> None:
        """Write the field as YAML."""
        text = yaml.safe_dump(sealed({"camera_distortion": self.to_dict()}), sort_keys=False, default_flow_style=None)
        Path(path).write_text(text, encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a file that `save` wrote, or the calibration of a rig with a distortion.

        The calibration of a camera by another program, ``ost.yaml`` or ``camera_info`` of ROS, is read as its lens.

        Raises
        ------
        GridError
            The file cannot be read or contains no distortion.
        """
        try:
            content = load_yaml(Path(path).read_text(encoding="utf-8"))
            if is_camera_info(content):
                camera = CameraInfo.of(content)
                return cls(camera.width, camera.height, *camera.polynomials())
            return cls.from_dict(unsealed(content, str(path))[0]["camera_distortion"])
        except GridError as error:
            raise GridError(f"{path}: {error}") from None
        except OSError as error:
            raise GridError(f"{path}: cannot be read: {cause_of(error)}") from error
        except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError) as error:
            raise GridError(f"{path} contains no distortion of a camera: {error}") from None
