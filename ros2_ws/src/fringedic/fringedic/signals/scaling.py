"""Readings of a sensor to values in SI units: its calibration, with the uncertainty of scale and offset."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

from fringedic.signals.units import Unit, find_unit, known_units

_UNCERTAIN = re.compile(
    r"\s*(?P<value>[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?)\s*"
    r"((\+-|\+/-|±)\s*(?P<sigma>(\d+\.?\d*|\.\d+)(e[-+]?\d+)?)\s*)?(?P<unit>[^\d\s].*)?",
    re.I,
)


class Uncertain(NamedTuple):
    """A number with its standard uncertainty and its unit, as people write it."""

    value: float
    sigma: float = 0.0
    unit: str = ""

    @classmethod
    def parse(cls, text: str | float) -> Uncertain:
        """Return what a text such as ``12.5 +- 0.02 N/V`` contains.

        Raises
        ------
        ValueError
            It has another form.

        Examples
        --------
        >>> Uncertain.parse("12.5 +- 0.02 N/V")
        Uncertain(value=12.5, sigma=0.02, unit='N/V')
        """
        match = _UNCERTAIN.fullmatch(str(text))
        if match is None:
            raise ValueError(f"{text!r} is no number with an uncertainty; write it as 12.5 +- 0.02 N/V")
        return cls(float(match["value"]), float(match["sigma"] or 0.0), (match["unit"] or "").strip())


class Scaling(NamedTuple):
    """Calibration of a sensor: value = scale * reading + offset.

    Attributes
    ----------
    unit
        Unit of the value before it is converted into SI units.
    scale, sigma_scale
        Per unit of the reading, and its standard uncertainty.
    offset, sigma_offset
        In the unit of the value.
    sigma
        Standard uncertainty of a reading, in its unit.
    """

    unit: Unit
    scale: float = 1.0
    sigma_scale: float = 0.0
    offset: float = 0.0
    sigma_offset: float = 0.0
    sigma: float = float("nan")

    @classmethod
    def of(cls, unit: str, scale: str | float, offset: str | float, sigma: float | None) -> Scaling:
        """Return the calibration that a declaration contains.

        Parameters
        ----------
        unit
            Of a reading.
        scale, offset
            Numbers, or texts with uncertainty and unit, see `Uncertain`. The unit of the scale is that of the value
            over that of the reading, the unit of the offset that of the value.
        sigma
            Standard uncertainty of a reading in its unit; None if it is not known.

        Raises
        ------
        ValueError
            A unit is not known, or the units do not fit each other.

        Examples
        --------
        >>> Scaling.of("mV", "12.5 +- 0.02 N/V", 0.0, 1.0).apply(np.array([1000.0]))
        (array([12.5]), array([0.02358495]))
        """
        reading, factor, zero = _known(unit, "unit"), Uncertain.parse(scale), Uncertain.parse(offset)
        if factor.value == 0:
            raise ValueError("scale is 0: every value would be the same")
        value, of_reading = reading, 1.0
        if factor.unit:
            above, slash, below = factor.unit.rpartition("/")
            if not slash:
                raise ValueError(f"the unit of the scale, '{factor.unit}', needs that of a reading, such as N/{unit}")
            value, denominator = _known(above, "unit of the scale"), _known(below, "unit of the scale")
            if denominator.si != reading.si or denominator.zero != reading.zero:
                raise ValueError(f"the scale is per {below}, but a reading is in {unit}; write it per {unit}")
            of_reading = reading.factor / denominator.factor
        if zero.unit and _known(zero.unit, "unit of the offset") != value:
            raise ValueError(f"the offset is in {zero.unit}, but the value is not; write it in the unit of the value")
        return cls(
            unit=value,
            scale=factor.value * of_reading,
            sigma_scale=factor.sigma * of_reading,
            offset=zero.value,
            sigma_offset=zero.sigma,
            sigma=float("nan") if sigma is None else sigma,
        )

    def apply(self, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return values and standard uncertainties in the SI unit; NaN where they are not known.

        Parameters
        ----------
        readings
            In their unit, shape (n,).
        """
        values = self.scale * readings + self.offset
        sigmas = np.sqrt((self.scale * self.sigma) ** 2 + (readings * self.sigma_scale) ** 2 + self.sigma_offset**2)
        return self.unit.factor * values + self.unit.zero, self.unit.factor * sigmas


def _known(text: str, what: str) -> Unit:
    unit = find_unit(text)
    if unit is None:
        raise ValueError(f"the {what} '{text}' is not known; write one such as {known_units()}")
    return unit
