"""The maps that pictures show, and their titles; units are those of `fringedic.results.quantities.people_unit`."""

from __future__ import annotations

from typing import NamedTuple


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
    """

    name: str
    title: str
    symmetric: bool = False


HEIGHT = Panel("shape_z", "height z")
DISPLACEMENT = (
    Panel("u", "displacement u along x (right)"),
    Panel("v", "displacement v along y (up)"),
    Panel("w", "displacement w along z (to the camera)"),
)
SHAPE_AND_DISPLACEMENT = (HEIGHT, *DISPLACEMENT)
SIGMAS = tuple(Panel(f"sigma_{name}", f"standard deviation of {name}") for name in "uvw")
STRAIN = (
    Panel("e_11", "strain e_11 along t1"),
    Panel("e_22", "strain e_22 along t2"),
    Panel("e_12", "shear strain e_12 (tensor)"),
)
DISPLACEMENT_IN_IMAGE = (
    Panel("displacement_x", "displacement x (right)"),
    Panel("displacement_y", "displacement y (down)"),
)
IN_PLANE = (
    *DISPLACEMENT_IN_IMAGE,
    Panel("displacement_sigma_x", "standard deviation of x"),
    Panel("displacement_sigma_y", "standard deviation of y"),
)
ERRORS = tuple(Panel(f"error_{name}", f"error of {name}", symmetric=True) for name in "zuvw")
ANIMATED = (*DISPLACEMENT, *STRAIN[:2], *DISPLACEMENT_IN_IMAGE)
_PANELS = {panel.name: panel for panel in (HEIGHT, *DISPLACEMENT, *SIGMAS, *STRAIN, *IN_PLANE, *ERRORS)}


def panel_of(name: str) -> Panel:
    """Return the panel of a map; one with its name as title for a map that no picture shows."""
    return _PANELS.get(name, Panel(name, name))
