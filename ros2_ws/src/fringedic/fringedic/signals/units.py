"""Units that other programs write, and the SI units of signals."""

from __future__ import annotations

import re
from typing import NamedTuple

QUANTITIES = {
    "N": "force",
    "m": "length",
    "K": "temperature",
    "Pa": "pressure",
    "V": "voltage",
    "Nm": "torque",
    "s": "time",
    "A": "current",
    "Hz": "frequency",
    "rad": "angle",
    "m/s": "velocity",
    "m/s2": "acceleration",
    "W": "power",
    "J": "energy",
    "kg": "mass",
    "Ohm": "resistance",
    "1": "",
}
"""Quantity of a signal by its SI unit; without one for a number or a ratio."""


class Unit(NamedTuple):
    """A unit: a value in SI units is `factor` times the number, plus `zero`."""

    si: str
    factor: float = 1.0
    zero: float = 0.0

    @property
    def quantity(self) -> str:
        """What is measured in it."""
        return QUANTITIES[self.si]


_PREFIXES = {"": 1.0, "k": 1e3, "M": 1e6, "G": 1e9, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9}
_PREFIXED = ("N", "m", "Pa", "V", "s", "A", "Hz", "W", "J", "Nm", "Ohm", "rad")
_OTHERS = {
    **{name: Unit("N", factor) for name, factor in {"lbf": 4.4482216152605, "kgf": 9.80665, "kp": 9.80665}.items()},
    "lb": Unit("N", 4.4482216152605),
    "gf": Unit("N", 9.80665e-3),
    "kip": Unit("N", 4448.2216152605),
    **dict.fromkeys(("in", "inch", '"'), Unit("m", 0.0254)),
    "ft": Unit("m", 0.3048),
    "mil": Unit("m", 25.4e-6),
    "psi": Unit("Pa", 6894.757293168),
    "ksi": Unit("Pa", 6894757.293168),
    "bar": Unit("Pa", 1e5),
    "mbar": Unit("Pa", 1e2),
    "N/mm2": Unit("Pa", 1e6),
    "N/m2": Unit("Pa"),
    "K": Unit("K"),
    **dict.fromkeys(("degC", "°C", "C"), Unit("K", 1.0, 273.15)),
    **dict.fromkeys(("degF", "°F", "F"), Unit("K", 5 / 9, 459.67 * 5 / 9)),
    **dict.fromkeys(("deg", "°"), Unit("rad", 0.017453292519943295)),
    **dict.fromkeys(("sec", "secs", "second", "seconds", "Sek"), Unit("s")),
    "msec": Unit("s", 1e-3),
    **dict.fromkeys(("min", "minutes"), Unit("s", 60.0)),
    **dict.fromkeys(("h", "hr", "hours", "Std"), Unit("s", 3600.0)),
    **dict.fromkeys(("1", "-", "mm/mm", "m/m", "strain", "counts", "cycles", "Zyklen"), Unit("1")),
    **dict.fromkeys(("%", "percent"), Unit("1", 1e-2)),
    "mm/m": Unit("1", 1e-3),
    **dict.fromkeys(("um/m", "microstrain", "ue", "ustrain"), Unit("1", 1e-6)),
    "mV/V": Unit("1", 1e-3),
    "mm/s": Unit("m/s", 1e-3),
    "mm/min": Unit("m/s", 1e-3 / 60),
    "m/s": Unit("m/s"),
    "m/s2": Unit("m/s2"),
    "g": Unit("kg", 1e-3),
    "kg": Unit("kg"),
    "Nmm": Unit("Nm", 1e-3),
    **dict.fromkeys(("volt", "volts"), Unit("V")),
    **dict.fromkeys(("newton", "newtons"), Unit("N")),
}
_UNITS = {f"{prefix}{name}": Unit(name, factor) for name in _PREFIXED for prefix, factor in _PREFIXES.items()} | _OTHERS
_SPELLING = str.maketrans({"µ": "u", "μ": "u", "²": "2", "Ω": "Ohm", "ε": "e", "℃": "°C"})
_PRODUCT = re.compile(r"N\s*[·*.\-⋅ ]\s*(m+)")


def _other_case() -> dict[str, Unit]:
    """Return the units by their names in small letters, without those that differ only in case (mPa, MPa)."""
    found: dict[str, set[Unit]] = {}
    for name, unit in _UNITS.items():
        found.setdefault(name.lower(), set()).add(unit)
    return {name: units.pop() for name, units in found.items() if len(units) == 1}


_ANY_CASE = _other_case()


def find_unit(text: str) -> Unit | None:
    """Return the unit that a text names; None if it is not known.

    Examples
    --------
    >>> find_unit("kN"), find_unit("N/mm²"), find_unit("furlong")
    (Unit(si='N', factor=1000.0, zero=0.0), Unit(si='Pa', factor=1000000.0, zero=0.0), None)
    >>> find_unit("degC").zero
    273.15
    """
    name = _PRODUCT.sub(r"N\1", text.strip().translate(_SPELLING).replace("**2", "2").replace("^2", "2"))
    return _UNITS.get(name) or _ANY_CASE.get(name.lower())


def known_units() -> str:
    """Return examples of known units, for messages."""
    return "N, kN, lbf, mm, um, inch, s, min, MPa, bar, degC, K, V, %, Nm"
