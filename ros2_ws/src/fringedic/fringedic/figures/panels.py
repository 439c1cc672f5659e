"""The maps that pictures show, and their titles; units are those of `fringedic.datasets.quantities.people_unit`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr


class Panel(NamedTuple):
    """One map of a picture.

    Attributes
    ----------
    name
        Of the map in the dataset.
    title
        What it is.
    symmetric
        Whether the colour scale is symmetric about zero, as for errors.
    like
        Another map of the dataset that has the same colour scale, which covers both; "" for a scale of its own.
    """

    name: str
    title: str
    symmetric: bool = False
    like: str = ""


HEIGHT = Panel("shape_z", "height z")
DISPLACEMENT = (
    Panel("u", "displacement u along x (right)"),
    Panel("v", "displacement v along y (up)"),
    Panel("w", "displacement w along z (to the camera)"),
)
SHAPE_AND_DISPLACEMENT = (HEIGHT, *DISPLACEMENT)
SIGMAS = tuple(Panel(f"sigma_{name}", f"standard deviation of {name}") for name in "uvw")
PRINCIPAL = (Panel("e_1", "larger principal strain e_1"), Panel("e_2", "smaller principal strain e_2"))
STRAIN = (
    Panel("e_11", "strain e_11 along t1 (right)"),
    Panel("e_22", "strain e_22 along t2 (up)"),
    Panel("e_12", "shear strain e_12 (tensor)"),
)
FLAT_STRAIN = (
    Panel("e_xx", "strain e_xx along x (right)"),
    Panel("e_yy", "strain e_yy along y (up)"),
    Panel("e_xy", "shear strain e_xy (tensor)"),
)
STRESS = (
    Panel("s_1", "larger principal stress s_1"),
    Panel("s_2", "smaller principal stress s_2"),
    Panel("s_von_mises", "equivalent stress (von Mises)"),
)
VON_MISES = Panel("e_von_mises", "equivalent strain (von Mises)")
DISPLACEMENT_IN_IMAGE = (
    Panel("displacement_x", "displacement x (right)"),
    Panel("displacement_y", "displacement y (down)"),
)
SIGMAS_IN_IMAGE = (
    Panel("displacement_sigma_x", "standard deviation of x"),
    Panel("displacement_sigma_y", "standard deviation of y"),
)
SIGMAS_OF_TWO_IMAGES = (Panel("sigma_x", "standard deviation of x"), Panel("sigma_y", "standard deviation of y"))
SIGMAS_OF_STRAIN = tuple(
    Panel(f"sigma_{panel.name}", f"standard deviation of {panel.name}") for panel in (*STRAIN, *FLAT_STRAIN)
)
RESOLUTIONS = tuple(
    Panel(f"resolution_{panel.name}", f"expected smoothing error of {panel.name}") for panel in (*STRAIN, *FLAT_STRAIN)
)
GREY_RESIDUAL = Panel("grey_residual", "grey-level residual", symmetric=True)
OVERLAP = tuple(
    Panel(f"overlap_{name}", f"sensors differ in {title}", symmetric=True)
    for name, title in {"shape": "height", "u": "u", "v": "v", "w": "w"}.items()
)
ERRORS = tuple(Panel(f"error_{name}", f"error of {name}", symmetric=True) for name in "zuvw")
ANIMATED = (*DISPLACEMENT, *STRAIN[:2], *FLAT_STRAIN[:2], *DISPLACEMENT_IN_IMAGE)
_PICTURES = {
    "": ((HEIGHT, *DISPLACEMENT), DISPLACEMENT, DISPLACEMENT[:2], DISPLACEMENT_IN_IMAGE),
    "strain": ((*STRAIN, *PRINCIPAL), STRAIN, (*FLAT_STRAIN, *PRINCIPAL, VON_MISES)),
    "stress": (STRESS,),
    "sigma": (
        (*SIGMAS, *SIGMAS_OF_STRAIN[:3]),
        SIGMAS,
        (*SIGMAS[:2], *SIGMAS_OF_STRAIN[3:]),
        (*SIGMAS_IN_IMAGE, *SIGMAS_OF_STRAIN[3:]),
        SIGMAS_IN_IMAGE,
    ),
    "resolution": (RESOLUTIONS[:3], RESOLUTIONS[3:]),
    "overlap": (OVERLAP,),
}
_ALL = (HEIGHT, *DISPLACEMENT, *SIGMAS, *PRINCIPAL, *STRAIN, *FLAT_STRAIN, *STRESS, VON_MISES)
_PANELS = {
    panel.name: panel
    for panels in (
        (*_ALL, *DISPLACEMENT_IN_IMAGE, *SIGMAS_IN_IMAGE, *SIGMAS_OF_TWO_IMAGES),
        (*SIGMAS_OF_STRAIN, *RESOLUTIONS, GREY_RESIDUAL, *OVERLAP, *ERRORS),
    )
    for panel in panels
}


def panel_of(name: str) -> Panel:
    """Return the panel of a map; one with its name as title for a map that no picture shows."""
    return _PANELS.get(name, Panel(name, name))


def pictures_of(step: xr.Dataset) -> dict[str, tuple[Panel, ...]]:
    """Return the panels of the pictures of a step by name.

    They are displacement (""), strain, stress, sigma, resolution and overlap.
    """
    measured = {
        str(name) for name, values in step.data_vars.items() if values.ndim == 2 and np.isfinite(values.values).any()
    }
    found = {}
    for name, choices in _PICTURES.items():
        for panels in choices:
            if measured.issuperset(panel.name for panel in panels):
                found[name] = panels
                break
    return found
