"""Where the points of a dataset are and how they move: in space, or in the image alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import xarray as xr

from fringedic.datasets.millimetres import origin_in_image
from fringedic.errors import DatasetError
from fringedic.evaluation.step_maps import maps_by_step, require_maps

_SPACE = ("x", "y", "z", "u", "v", "w")
_SPACE_SIGMAS = ("sigma_u", "sigma_v", "sigma_w")
_IMAGE = ("displacement_x", "displacement_y")
_IMAGE_SIGMAS = (("displacement_sigma_x", "displacement_sigma_y"), ("sigma_x", "sigma_y"))


@dataclass(frozen=True)
class Motion:
    """Positions and displacements of a dataset.

    Attributes
    ----------
    dataset
        Over (row, column), with or without steps.
    spatial
        Whether it contains positions and displacements in space; otherwise those in the image are used, with z = 0.
    scale
        Size of a pixel [`unit`]; 1 in space.
    unit
        Of lengths: ``m``, or ``px`` for images without a scale.
    sigmas
        Maps of the standard deviations; empty when there are none.
    """

    dataset: xr.Dataset
    spatial: bool
    scale: float
    unit: str
    sigmas: tuple[str, ...]

    def by_step(self) -> Iterator[np.ndarray]:
        """Iterate over the steps: x, y, z, u, v, w and, when known, their sigmas [`unit`], (map, row, column).

        x and u point to the right, y and v upwards; in images from their middle, if their size is known.
        """
        if self.spatial:
            yield from maps_by_step(self.dataset, (*_SPACE, *self.sigmas))
            return
        first, top = origin_in_image(self.dataset)
        x, y = np.meshgrid(self.dataset["column"].values - first, top - self.dataset["row"].values)
        zero = np.zeros(x.shape)
        for maps in maps_by_step(self.dataset, (*_IMAGE, *self.sigmas)):
            moved = [x, y, zero, maps[0], -maps[1], np.where(np.isfinite(maps[0]), 0.0, np.nan)]
            yield self.scale * np.stack([*moved, *maps[2:], zero] if self.sigmas else moved)


def in_space(step: xr.Dataset) -> xr.Dataset:
    """Return a step with the maps x, y, z, u, v, w [m], flat at z = 0 for images with a scale; else as it is."""
    if all(name in step for name in _SPACE) or "pixel_size" not in step.attrs or not set(_IMAGE) <= set(step.data_vars):
        return step
    [maps] = motion_of(step.drop_vars("step")).by_step()
    units = {"units": "m"}
    dimensions = ("row", "column")
    return step.assign({name: (dimensions, values, units) for name, values in zip(_SPACE, maps, strict=False)})


def motion_of(dataset: xr.Dataset) -> Motion:
    """Return the motion in space of a dataset; that in the image when it contains no other.

    Raises
    ------
    DatasetError
        The dataset contains neither.
    """
    dataset = dataset.transpose(..., "row", "column", missing_dims="ignore")
    if all(name in dataset for name in _SPACE):
        require_maps(dataset, _SPACE)
        return Motion(dataset, True, 1.0, "m", _present(dataset, _SPACE_SIGMAS))
    if not all(name in dataset for name in _IMAGE):
        raise DatasetError(
            f"the dataset has no displacement: it needs the maps {', '.join(_SPACE)}, or {' and '.join(_IMAGE)}"
        )
    require_maps(dataset, _IMAGE)
    sigmas = _present(dataset, _IMAGE_SIGMAS[0]) or _present(dataset, _IMAGE_SIGMAS[1])
    if "pixel_size" in dataset.attrs:
        return Motion(dataset, False, float(dataset.attrs["pixel_size"]), "m", sigmas)
    return Motion(dataset, False, 1.0, "px", sigmas)


def _present(dataset: xr.Dataset, names: tuple[str, ...]) -> tuple[str, ...]:
    return names if all(name in dataset for name in names) else ()
