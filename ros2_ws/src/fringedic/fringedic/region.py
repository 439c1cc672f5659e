"""The region of interest: polygons in the camera's image, and the mask that they make."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fringedic.errors import RegionError

SUBPIXEL_BITS = 4  # of the corners, when they are drawn


class _Polygon(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    points: list[tuple[float, float]] = Field(min_length=3)
    hole: bool = False


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    width: int = Field(ge=1)
    height: int = Field(ge=1)
    polygons: list[_Polygon] = Field(min_length=1)


@dataclass(frozen=True)
class Polygon:
    """A closed line through corners (column, row) [px]; a hole is cut out of what was drawn before it."""

    points: tuple[tuple[float, float], ...]
    hole: bool = False


@dataclass(frozen=True)
class Region:
    """What is to be measured in images of one size.

    Attributes
    ----------
    width, height
        Of the images [px].
    polygons
        In the order in which they are filled and cut out.
    """

    width: int
    height: int
    polygons: tuple[Polygon, ...]

    def mask(self) -> np.ndarray:
        """Return booleans (row, column), True in the region; the lines themselves belong to what they enclose."""
        mask = np.zeros((self.height, self.width), np.uint8)
        for polygon in self.polygons:
            corners = np.round(np.array(polygon.points) * (1 << SUBPIXEL_BITS)).astype(np.int32)
            cv2.fillPoly(mask, [corners], 0 if polygon.hole else 1, shift=SUBPIXEL_BITS)
        return mask.astype(bool)

    def mask_for(self, shape: tuple[int, ...]) -> np.ndarray:
        """Return the mask for an image of a shape (row, column).

        Raises
        ------
        RegionError
            The region was drawn in an image of another size, or leaves nothing.
        """
        if tuple(shape) != (self.height, self.width):
            raise RegionError(
                f"the region was drawn in an image of {self.width}x{self.height} px, this one has "
                f"{shape[1]}x{shape[0]} px: draw it again with 'fringedic region'"
            )
        mask = self.mask()
        if not mask.any():
            raise RegionError("the region is empty: its holes leave nothing to measure")
        return mask

    def to_text(self) -> str:
        """Return the region as one line of YAML, as the parameter ``region`` of the dic node takes it."""
        return yaml.safe_dump(self._content(), default_flow_style=True, width=10**6).strip()

    @classmethod
    def from_text(cls, text: str) -> Region:
        """Read what `to_text` or `save` wrote.

        Raises
        ------
        RegionError
            It is no region.
        """
        try:
            found = _File.model_validate(yaml.safe_load(text))
        except yaml.YAMLError as error:
            raise RegionError(f"region: no YAML: {error}") from error
        except ValidationError as error:
            problems = "; ".join(f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors())
            raise RegionError(f"region: {problems}") from error
        polygons = tuple(Polygon(tuple(polygon.points), polygon.hole) for polygon in found.polygons)
        return cls(found.width, found.height, polygons)

    def save(self, picture: str | os.PathLike[str]) -> tuple[Path, Path]:
        """Write the mask as an image (white: measured), and beside it the polygons as YAML; return both."""
        target = Path(picture)
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            written = cv2.imwrite(str(target), self.mask().astype(np.uint8) * 255)
        except cv2.error as error:
            raise RegionError(f"{target}: cannot be written as an image; take a name that ends in .png") from error
        if not written:
            raise RegionError(f"{target}: cannot be written")
        corners = target.with_suffix(".yaml")
        head = "# Region of interest: corners are [column, row] in pixels of the camera's image, holes are cut out\n"
        corners.write_text(head + yaml.safe_dump(self._content(), default_flow_style=None, sort_keys=False))
        return target, corners

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Region:
        """Read the polygons that `save` wrote.

        Raises
        ------
        RegionError
            The file cannot be read, or holds no region.
        """
        try:
            return cls.from_text(Path(path).read_text("utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise RegionError(f"{path}: cannot be read: {error}") from error
        except RegionError as error:
            raise RegionError(f"{path}: {error}") from error

    def _content(self) -> dict[str, object]:
        polygons = [
            {"hole": polygon.hole, "points": [[round(float(x), 2), round(float(y), 2)] for x, y in polygon.points]}
            for polygon in self.polygons
        ]
        return {"width": self.width, "height": self.height, "polygons": polygons}
