"""Regions of the camera's image: polygons and their masks."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import ArrayLike
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fringedic.errors import ImageError
from fringedic.frames.files import read_grey, write_grey
from fringedic.wording.arguments import check_value, number, several
from fringedic.wording.yaml_text import load_yaml

POLYGON_SUFFIXES = (".yaml", ".yml")
SUBPIXEL_BITS = 4  # OpenCV draws corners with this resolution
_LARGEST_IMAGE = 32_768  # width or height [px]
_position = number(-1e6, 1e6)  # [px]; OpenCV draws with 32 bits
Point = tuple[float, float]
"""A position (column, row) in an image [px]."""


class _PolygonEntry(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    points: list[tuple[float, float]] = Field(min_length=3)
    hole: bool = False


class _RegionFile(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    width: int = Field(ge=1, le=_LARGEST_IMAGE)
    height: int = Field(ge=1, le=_LARGEST_IMAGE)
    polygons: list[_PolygonEntry] = Field(min_length=1)


@dataclass(frozen=True)
class Polygon:
    """A closed polygon.

    Attributes
    ----------
    points
        Corners (column, row) [px], at least three.
    hole
        Cut out of the polygons before it instead of filled.

    Raises
    ------
    ImageError
        There are fewer than three corners, or one is more than a million pixels away.
    """

    points: tuple[Point, ...]
    hole: bool = False

    def __post_init__(self) -> None:
        check_value(ImageError, "points", self.points, several(several(_position, length=2)))
        if len(self.points) < 3:
            raise ImageError(f"a polygon has {len(self.points)} corners: it needs at least three")


@dataclass(frozen=True)
class Region:
    """A part of the camera's image, bounded by polygons; positions are (column, row) [px].

    Pixels on the boundary of a polygon belong to it.

    Attributes
    ----------
    polygons
        In the order in which they are filled or cut out.
    width, height
        Size of the images in which the region was drawn [px]; None for a region that is not bound to a size.

    Raises
    ------
    ImageError
        `polygons` contains something else than polygons.

    Examples
    --------
    >>> region = Region.rectangle((1, 0), (3, 1))
    >>> region.mask_for((3, 5)).astype(int)
    array([[0, 1, 1, 1, 0],
           [0, 1, 1, 1, 0],
           [0, 0, 0, 0, 0]])
    """

    polygons: tuple[Polygon, ...]
    width: int | None = None
    height: int | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.polygons, tuple) or not all(isinstance(each, Polygon) for each in self.polygons):
            raise ImageError(
                "a region consists of polygons: use Region.rectangle(first, last) or Region.polygon(corners), "
                "with positions (column, row)"
            )

    @classmethod
    def rectangle(cls, first: Point, last: Point) -> Region:
        """Return the rectangle between two opposite corners (column, row) [px], both included."""
        (left, top), (right, bottom) = (
            check_value(ImageError, name, corner, several(_position, length=2))
            for name, corner in (("first", first), ("last", last))
        )
        return cls.polygon([(left, top), (right, top), (right, bottom), (left, bottom)])

    @classmethod
    def polygon(cls, corners: Sequence[Point]) -> Region:
        """Return the region inside one polygon.

        Parameters
        ----------
        corners
            (column, row) [px], at least three.

        Raises
        ------
        ImageError
            There are fewer than three corners.

        Examples
        --------
        >>> int(Region.polygon([(0, 0), (4, 0), (0, 4)]).mask_for((5, 5)).sum())
        15
        """
        return cls((Polygon(tuple((float(column), float(row)) for column, row in corners)),))

    def mask(self) -> np.ndarray:
        """Return the mask for images of the region's own size: booleans (row, column), True inside.

        Raises
        ------
        ImageError
            The region is not bound to a size of images.
        """
        if self.width is None or self.height is None:
            raise ImageError("the region has no image size: ask for the mask of an image by mask_for(shape)")
        return self._filled(self.width, self.height)

    def mask_for(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return the mask for an image of a shape (row, column): booleans, True inside.

        Raises
        ------
        ImageError
            The region was drawn in an image of another size, or is empty.
        """
        self.require_size(shape[1], shape[0])
        mask = self._filled(shape[1], shape[0])
        if not mask.any():
            raise ImageError("the region is empty: its holes leave nothing to measure")
        return mask

    def require_size(self, width: int, height: int) -> None:
        """Refuse an image of another size [px] than that of the image in which the region was drawn, if this is known.

        Raises
        ------
        ImageError
            The region was drawn in an image of another size.
        """
        if self.width is not None and (width, height) != (self.width, self.height):
            raise ImageError(
                f"the region was drawn in an image of {self.width}x{self.height} px, this one has "
                f"{width}x{height} px: draw it again with 'fringedic region'"
            )

    def mask_at(self, columns: ArrayLike, rows: ArrayLike) -> np.ndarray:
        """Return which points of a grid of pixels lie in the region.

        Parameters
        ----------
        columns, rows
            Pixel positions of the grid lines, shapes (column,) and (row,) [px], such as the coordinates of a dataset.

        Returns
        -------
        ndarray
            Booleans (row, column), True inside.

        Raises
        ------
        ImageError
            A grid line lies outside of any image.

        Examples
        --------
        >>> Region.rectangle((4, 0), (8, 4)).mask_at(columns=[0, 4, 8, 12], rows=[0, 4, 8]).astype(int)
        array([[0, 1, 1, 0],
               [0, 1, 1, 0],
               [0, 0, 0, 0]])
        """
        lines = np.concatenate([np.ravel(columns), np.ravel(rows)])
        if not np.all((lines >= 0) & (lines <= _LARGEST_IMAGE)):
            raise ImageError(f"columns and rows of a grid have to be positions from 0 to {_LARGEST_IMAGE} px")
        column, row = np.asarray(columns, int), np.asarray(rows, int)
        mask = self._filled(int(column.max()) + 1, int(row.max()) + 1)
        return np.asarray(mask[np.ix_(row, column)])

    def _filled(self, width: int, height: int) -> np.ndarray:
        mask = np.zeros((height, width), np.uint8)
        for polygon in self.polygons:
            corners = np.round(np.array(polygon.points) * (1 << SUBPIXEL_BITS)).astype(np.int32)
            cv2.fillPoly(mask, [corners], 0 if polygon.hole else 1, shift=SUBPIXEL_BITS)
        return mask.astype(bool)

    def to_text(self) -> str:
        """Return the region as one line of YAML, the form of the parameter ``region`` of the dic node."""
        return yaml.safe_dump(self._content(), default_flow_style=True, width=10**6).strip()

    @classmethod
    def from_text(cls, text: str) -> Region:
        """Read what `to_text` or `save` wrote.

        Raises
        ------
        ImageError
            The text is no region.
        """
        try:
            return cls.from_content(load_yaml(text))
        except yaml.YAMLError as error:
            raise ImageError(f"region: no YAML: {error}") from error

    @classmethod
    def from_content(cls, content: Any) -> Region:
        """Return the region whose polygons and size a mapping contains.

        Raises
        ------
        ImageError
            The content is no region.
        """
        try:
            found = _RegionFile.model_validate(content)
        except ValidationError as error:
            problems = "; ".join(f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors())
            raise ImageError(f"region: {problems}") from error
        polygons = tuple(Polygon(tuple(polygon.points), polygon.hole) for polygon in found.polygons)
        return cls(polygons, found.width, found.height)

    def share(self) -> float:
        """Return the fraction of the image that is in the region."""
        return float(self.mask().mean())

    def save(self, picture: str | os.PathLike[str]) -> tuple[Path, Path]:
        """Write the mask as an image (white inside), and beside it the polygons as YAML; return both paths.

        Raises
        ------
        ImageError
            The region is not bound to a size of images, or the image cannot be written.
        OSError
            The polygons cannot be written.
        """
        target = Path(picture)
        target.parent.mkdir(parents=True, exist_ok=True)
        write_grey(target, self.mask().astype(np.uint8) * 255)
        corners = target.with_suffix(".yaml")
        head = "# Region of interest: corners are [column, row] in pixels of the camera's image, holes are cut out\n"
        corners.write_text(head + yaml.safe_dump(self._content(), default_flow_style=None, sort_keys=False))
        return target, corners

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Region:
        """Read the polygons that `save` wrote.

        Raises
        ------
        ImageError
            The file cannot be read, or holds no region.
        """
        try:
            return cls.from_text(Path(path).read_text("utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise ImageError(f"{path}: cannot be read: {error}") from error
        except ImageError as error:
            raise ImageError(f"{path}: {error}") from error

    def _content(self) -> dict[str, object]:
        polygons = [
            {"hole": polygon.hole, "points": [[round(float(x), 2), round(float(y), 2)] for x, y in polygon.points]}
            for polygon in self.polygons
        ]
        return {"width": self.width, "height": self.height, "polygons": polygons}


def mask_of(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    """Return the mask in a file: polygons (YAML), or an image that is white where the surface is measured.

    Parameters
    ----------
    path
        The file.
    shape
        Rows and columns of the images.

    Returns
    -------
    ndarray
        bool, shape (row, column); True where the surface is measured.

    Raises
    ------
    ImageError
        The file cannot be read, the mask belongs to images of another size, or it is empty.
    """
    if path.suffix in POLYGON_SUFFIXES:
        region = Region.load(path)
        try:
            return region.mask_for(shape)
        except ImageError as error:
            raise ImageError(f"{path}: {error}") from error
    image = read_grey(path)
    if image.shape != tuple(shape):
        raise ImageError(
            f"{path}: the mask has {image.shape[1]}x{image.shape[0]} px, the images have {shape[1]}x{shape[0]} px"
        )
    mask = image > np.iinfo(image.dtype).max // 2 if image.dtype.kind == "u" else image > 0
    if not mask.any():
        raise ImageError(f"{path}: the mask is black everywhere; make it white where the surface is measured")
    return mask
