"""Names, units and meanings of everything in a dataset."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import numpy as np
import xarray as xr

from fringedic.errors import DatasetError
from fringedic.surface.strain_measures import GREEN_LAGRANGE, STRAIN_MEASURE, TENSORS, flat_fields

MAP_DIMENSIONS = ("step", "row", "column")
TEXT = "text"  # type of a variable that NumPy has no name for
METADATA_ATTRIBUTE = "facts"  # name of the metadata in datasets
SOURCE_BYTES = "source_bytes"  # attribute: size of the recording when the dataset was made, as digits
ATTACHMENTS = "attachments"  # attribute: SHA-256 of the descriptions of attached files by their names, as JSON
MISSING_PARTS = "missing_parts"  # attribute: names of later parts of the run that the dataset lacks, as a JSON list
LATER_REFERENCES = "later_references"  # attribute: references in place of one that is not recorded, as a JSON list
MISSING_SETTINGS = "missing_settings"  # attribute: nodes whose settings were not recorded, as a JSON list
TIME_ZERO = "time_zero"  # attribute of selected steps: time of the first step of the whole dataset


class Quantity(NamedTuple):
    """Unit and meaning of one map."""

    units: str
    long_name: str


MAPS: dict[str, Quantity] = {
    "phase": Quantity("rad", "absolute phase at the finest pitch"),
    "phase_sigma": Quantity("rad", "standard deviation of the phase"),
    "modulation": Quantity("grey level", "fringe amplitude"),
    "texture": Quantity("grey level", "surface without fringes"),
    "displacement_x": Quantity("px", "in-plane displacement x (right)"),
    "displacement_y": Quantity("px", "in-plane displacement y (down)"),
    "displacement_sigma_x": Quantity("px", "standard deviation of displacement_x"),
    "displacement_sigma_y": Quantity("px", "standard deviation of displacement_y"),
    "shape_x": Quantity("m", "x of this step's surface, seen by this pixel"),
    "shape_y": Quantity("m", "y of this step's surface, seen by this pixel"),
    "shape_z": Quantity("m", "height of this step's surface, seen by this pixel"),
    "shape_sigma_z": Quantity("m", "standard deviation of shape_z"),
    "x": Quantity("m", "x of the reference surface, to the right"),
    "y": Quantity("m", "y of the reference surface, upwards"),
    "z": Quantity("m", "height of the reference surface, towards the camera"),
    "u": Quantity("m", "displacement along x"),
    "v": Quantity("m", "displacement along y"),
    "w": Quantity("m", "displacement along z"),
    "sigma_u": Quantity("m", "standard deviation of u"),
    "sigma_v": Quantity("m", "standard deviation of v"),
    "sigma_w": Quantity("m", "standard deviation of w"),
    "noise_z": Quantity("m", "noise of the filtered height of the reference surface"),
    "noise_z_deformed": Quantity("m", "noise of the filtered height of this step's surface at the moved point"),
    "u_t": Quantity("m", "displacement along the surface, first tangent"),
    "v_t": Quantity("m", "displacement along the surface, second tangent"),
    "w_n": Quantity("m", "displacement along the surface's normal"),
    "e_11": Quantity("1", "surface strain along the first tangent"),
    "e_22": Quantity("1", "surface strain along the second tangent"),
    "e_12": Quantity("1", "surface shear strain (tensor)"),
    "sigma_e_11": Quantity("1", "standard deviation of e_11"),
    "sigma_e_22": Quantity("1", "standard deviation of e_22"),
    "sigma_e_12": Quantity("1", "standard deviation of e_12"),
    "resolution_e_11": Quantity("1", "expected error of e_11 by the smoothing of its window"),
    "resolution_e_22": Quantity("1", "expected error of e_22 by the smoothing of its window"),
    "resolution_e_12": Quantity("1", "expected error of e_12 by the smoothing of its window"),
}
CLOSURES: dict[str, Quantity] = {  # of the desk, not of the nodes
    "phase_closure": Quantity("standard deviations", "phase of the next coarser pitch minus that of the finest one"),
    "displacement_closure_x": Quantity("standard deviations", "what an independent check leaves of displacement_x"),
    "displacement_closure_y": Quantity("standard deviations", "what an independent check leaves of displacement_y"),
}
JOINED_MAPS: dict[str, Quantity] = {  # of the joined surface of several sensors
    "overlap_shape": Quantity("standard deviations", "height of one sensor minus that of the other"),
    "overlap_u": Quantity("standard deviations", "u of one sensor minus that of the other"),
    "overlap_v": Quantity("standard deviations", "v of one sensor minus that of the other"),
    "overlap_w": Quantity("standard deviations", "w of one sensor minus that of the other"),
    "sensors": Quantity("1", "number of sensors that measured the point"),
    "sigma_shape": Quantity("m", "standard deviation of the position along the normal"),
}
ALL_MAPS = {**MAPS, **JOINED_MAPS}
"""The maps of a sensor, and those that the joined surface of several has beside them."""
NANOSECONDS = "nanoseconds since 1970-01-01"
"""Unit of the times in a dataset."""
SCALARS: dict[str, Quantity] = {
    "valid_fraction": Quantity("1", "part of the points with a result of the last processing step"),
    "rms_displacement": Quantity("m", "root mean square length of (u, v, w)"),
}
STEP_NUMBERS: dict[str, str] = {  # -1 without a displacement, or if a recording of an older version lacks it
    "reference_step": "step from whose configuration the displacement counts",
    "correlated_step": "step whose images this one's were compared with",
    "increments_summed": "1 when the displacement is composed with that of correlated_step, else 0",
}
TEXTS: dict[str, str] = {"error": "reason of the failure, empty for a measured step"}


class Layout(NamedTuple):
    """Variables of a kind of dataset: maps, values and texts of each step, and whether the steps have times."""

    maps: Mapping[str, Quantity]
    scalars: Mapping[str, Quantity]
    texts: Mapping[str, str]
    timed: bool


_CONFIRMED = {"confirmed_fraction": Quantity("1", "part of the checked points with closures within 3 sigma")}
RECORDING = Layout({**MAPS, **CLOSURES}, {**SCALARS, **_CONFIRMED}, TEXTS, timed=True)
GREY_RESIDUAL = Quantity("grey level", "deformed minus reference image at the material points")
_IN_IMAGE = ("texture", "displacement_x", "displacement_y", "displacement_sigma_x", "displacement_sigma_y")


def layout_of_images(scaled: bool, strain_measure: str = GREEN_LAGRANGE) -> Layout:
    """Return the variables of a series of images; lengths in metres only where the scale is known."""
    maps = {name: MAPS[name] for name in _IN_IMAGE}
    if scaled:
        maps |= {name: MAPS[name] for name in ("u", "v", "sigma_u", "sigma_v")}
    scalars = {
        "valid_fraction": SCALARS["valid_fraction"],
        "rms_displacement": Quantity("m" if scaled else "px", "root mean square length of the displacement"),
    }
    texts = {**TEXTS, "image": "name of the image", "remarks": "what needs attention, as a JSON list; empty if nothing"}
    refuted = {"refuted_fraction": Quantity("1", "part of the points that were measured and that the check refuted")}
    checks = {name: CLOSURES[name] for name in ("displacement_closure_x", "displacement_closure_y")}
    strain = {name: Quantity("1", long_name) for name, long_name in flat_fields(strain_measure).items()}
    maps |= {**strain, "grey_residual": GREY_RESIDUAL, **checks}
    return Layout(maps, {**scalars, **_CONFIRMED, **refuted}, texts, timed=False)


COUNTS = {"sensors"}
"""Maps of numbers, which are no strain although their unit is 1."""
POSITIONS = {"x", "y", "z", "shape_x", "shape_y", "shape_z"}
PHASE_TOPICS = {"map": "phase", "sigma": "phase_sigma", "modulation": "modulation", "texture": "texture"}


class PeopleUnit(NamedTuple):
    """A unit of reports and exports: its text, its identifier in names, and its value in the unit of the dataset."""

    text: str
    identifier: str
    factor: float


_MILLIMETRE = PeopleUnit("mm", "mm", 1e-3)
_MICROMETRE = PeopleUnit("µm", "um", 1e-6)
_NUMBER = PeopleUnit("1", "number", 1.0)
_MICROSTRAIN = PeopleUnit("µstrain", "ustrain", 1e-6)
_MEGAPASCAL = PeopleUnit("MPa", "MPa", 1e6)
_PERCENT = PeopleUnit("%", "percent", 0.01)
_LARGE_STRAIN = 0.01


def strain_unit(largest: float) -> PeopleUnit:
    """Return the unit of strains that people look at: % if the largest one exceeds 1 %, else µstrain.

    Examples
    --------
    >>> strain_unit(0.025).text, strain_unit(0.002).text
    ('%', 'µstrain')
    """
    return _PERCENT if largest > _LARGE_STRAIN else _MICROSTRAIN


def largest_of(values: Iterable[np.ndarray]) -> float:
    """Return the largest absolute value of arrays, 0 where nothing is measured."""
    finite = [np.abs(each[np.isfinite(each)]) for each in values]
    return max((float(each.max()) for each in finite if each.size), default=0.0)


def people_unit(variable: xr.DataArray, largest: float = 0.0) -> PeopleUnit:
    """Return the one unit of a map in pictures, curves, tables and exports.

    Positions are in mm, displacements in µm, stress in MPa and strain in µstrain; a map without the attribute ``units``
    has that of `ALL_MAPS`. Signals have the unit of their dataset, lengths mm.

    Parameters
    ----------
    variable
        The map.
    largest
        Largest strain that is shown, as of `strain_unit`; exports always contain µstrain.
    """
    name = str(variable.name)
    units = variable.attrs.get("units") or ALL_MAPS.get(name, Quantity("", "")).units
    if name in COUNTS:
        return _NUMBER
    if "quantity" in variable.attrs:
        return _MILLIMETRE if units == "m" else PeopleUnit(units, units.replace("/", "_per_"), 1.0)
    if units == "m":
        return _MILLIMETRE if name in POSITIONS else _MICROMETRE
    if units == "1":
        return strain_unit(largest)
    if units == "Pa":
        return _MEGAPASCAL
    return PeopleUnit(units, units.replace(" ", "_"), 1.0)


def strain_measure_of(dataset: xr.Dataset) -> str:
    """Return the name of the measure of the strain of a dataset, one of `fringedic.surface.strain_measures.TENSORS`.

    Raises
    ------
    DatasetError
        The attribute contains another name.
    """
    measure = str(dataset.attrs.get(STRAIN_MEASURE, GREEN_LAGRANGE))
    if measure not in TENSORS:
        raise DatasetError(
            f"attribute '{STRAIN_MEASURE}' of the dataset is {measure!r}: write one of {', '.join(TENSORS)}"
        )
    return measure


def strain_words(dataset: xr.Dataset, name: str) -> str:
    """Return measure and kind of shear of a map of images, for headings of tables; empty for other maps.

    Examples
    --------
    >>> images = xr.Dataset(attrs={"strain_measure": "logarithmic"})
    >>> strain_words(images, "e_xx"), strain_words(images, "e_xy"), strain_words(images, "sigma_e_xy")
    ('logarithmic', 'logarithmic tensor shear', '')
    """
    measure = strain_measure_of(dataset)
    if not name.startswith("e_") or name not in flat_fields(measure):
        return ""
    return f"{TENSORS[measure].title}{' tensor shear' if name == 'e_xy' else ''}"


def sigma_of(name: str) -> str | None:
    """Return the map that contains the standard deviation of a map; None when there is none.

    Examples
    --------
    >>> sigma_of("e_11"), sigma_of("displacement_x"), sigma_of("phase"), sigma_of("texture")
    ('sigma_e_11', 'displacement_sigma_x', 'phase_sigma', None)
    """
    first, _, last = name.rpartition("_")
    candidates = (f"sigma_{name}", f"{first}_sigma_{last}", f"{name}_sigma")
    return next((candidate for candidate in candidates if candidate in MAPS), None)


def resolution_of(name: str) -> str | None:
    """Return the map that contains the expected smoothing error of a map; None when there is none.

    Examples
    --------
    >>> resolution_of("e_11"), resolution_of("w")
    ('resolution_e_11', None)
    """
    candidate = f"resolution_{name}"
    return candidate if candidate in MAPS else None
