"""The maps that pictures show: names, titles and units."""

from __future__ import annotations

from typing import NamedTuple

MILLI, MICRO = 1e-3, 1e-6


class Panel(NamedTuple):
    """One map of a picture.

    Attributes
    ----------
    name
        Of the map in the dataset.
    title
        What it is.
    units
        Its unit in the picture.
    factor
        That unit in the unit of the dataset.
    symmetric
        Whether the colour scale is symmetric about zero, as for errors.
    """

    name: str
    title: str
    units: str
    factor: float
    symmetric: bool = True


def _displacement(units: str, factor: float) -> tuple[Panel, ...]:
    """Return the components of the displacement in space."""
    components = zip("uvw", "xyz", strict=True)
    return tuple(Panel(name, f"displacement {name} along {axis}", units, factor, False) for name, axis in components)


_HEIGHT = Panel("shape_z", "height z", "mm", MILLI, symmetric=False)
SHAPE_AND_DISPLACEMENT = (_HEIGHT, *_displacement("µm", MICRO))
SHAPE_IN_MM = (_HEIGHT, *_displacement("mm", MILLI))
STRAIN = (
    Panel("e_11", "strain e_11 along t1", "µstrain", MICRO, symmetric=False),
    Panel("e_22", "strain e_22 along t2", "µstrain", MICRO, symmetric=False),
    Panel("e_12", "shear strain e_12 (tensor)", "µstrain", MICRO, symmetric=False),
)
DISPLACEMENT_IN_IMAGE = (
    Panel("displacement_x", "displacement x (right)", "px", 1.0, symmetric=False),
    Panel("displacement_y", "displacement y (down)", "px", 1.0, symmetric=False),
)
IN_PLANE = (
    *DISPLACEMENT_IN_IMAGE,
    Panel("displacement_sigma_x", "standard deviation of x", "px", 1.0, symmetric=False),
    Panel("displacement_sigma_y", "standard deviation of y", "px", 1.0, symmetric=False),
)
ERRORS = (
    Panel("shape_z", "error of z", "µm", MICRO),
    *(Panel(name, f"error of {name}", "µm", MICRO) for name in "uvw"),
)
ANIMATED = (*_displacement("mm", MILLI), *STRAIN[:2], *DISPLACEMENT_IN_IMAGE)
