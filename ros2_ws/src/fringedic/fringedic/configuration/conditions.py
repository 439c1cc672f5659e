"""Conditions of a programme: limits of signals, strain and valid fraction that end a move, a ramp or a cycle."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from pydantic import Field, model_validator

from fringedic.configuration.yaml_section import Section
from fringedic.signals import FORCE

PERCENT = 100.0


class Reading(NamedTuple):
    """Values that conditions are compared with; NaN is not known.

    Attributes
    ----------
    signals
        Signals by their name, in their unit: the force [N], tension positive, and others.
    strain
        Strain of the extensometer, dimensionless.
    valid_fraction
        Measured part of the surface, 0 to 1.
    duration
        Time since the begin of the move [s].
    """

    signals: Mapping[str, float] = MappingProxyType({})
    strain: float = math.nan
    valid_fraction: float = math.nan
    duration: float = math.nan


class MetCondition(NamedTuple):
    """A limit that a reading reached; `fringedic.configuration.sentences.condition_sentence` composes the sentence.

    Attributes
    ----------
    quantity
        What is limited: ``force``, ``strain``, ``valid fraction``, ``time``, or the name of another signal.
    value
        The reading in the unit of the limit; NaN when it is not known, which meets every condition.
    limit
        The limit as it is written in the programme [N, %, 0 to 1, s, or in the unit of the signal].
    rising
        The limit is reached from below.
    unit
        Of value and limit; empty for 0 to 1, and for a signal, whose unit the programme does not contain.
    """

    quantity: str
    value: float
    limit: float
    rising: bool
    unit: str = ""


class Until(Section):
    """Conditions of which the first that is met ends a move, a ramp or a cycle; an unknown value ends it, too.

    Examples
    --------
    >>> until = Until(force_above_n=500)
    >>> until.met(Reading({"force": 499.0})) is None
    True
    >>> until.met(Reading({"force": 510.0})).value
    510.0
    >>> Until(above={"temperature_grip": 320}).met(Reading({"temperature_grip": 321.5})).quantity
    'temperature_grip'
    """

    force_above_n: float | None = Field(None, description="The force reaches this from below [N].")
    force_below_n: float | None = Field(None, description="The force falls to this: unloaded, or broken [N].")
    strain_above_percent: float | None = Field(None, description="The extensometer's strain reaches this [%].")
    strain_below_percent: float | None = Field(None, description="The extensometer's strain falls to this [%].")
    valid_fraction_below: float | None = Field(
        None, gt=0, le=1, description="Less of the surface than this is measured, 0 to 1; not for a move."
    )
    time_above_s: float | None = Field(
        None, gt=0, description="The time since the begin of the move reaches this [s]; only for a move."
    )
    above: dict[str, float] | None = Field(
        None, min_length=1, description="Other signals, by their names, that reach this from below [their unit]."
    )
    below: dict[str, float] | None = Field(
        None, min_length=1, description="Other signals, by their names, that fall to this [their unit]."
    )

    @model_validator(mode="after")
    def _has_a_condition(self) -> Until:
        if not self.model_fields_set:
            raise ValueError(f"give one of {', '.join(type(self).model_fields)}")
        if FORCE.name in self.signals:
            raise ValueError(
                "write force_above_n or force_below_n, which the load frame node compares with every sample"
            )
        return self

    @property
    def signals(self) -> set[str]:
        """Names of the signals in `above` and `below`."""
        return {*(self.above or {}), *(self.below or {})}

    @property
    def needs_strain(self) -> bool:
        """Whether a condition needs an extensometer."""
        return self.strain_above_percent is not None or self.strain_below_percent is not None

    def without_force(self) -> Until | None:
        """Return the conditions that the load frame node does not check; None without any.

        Examples
        --------
        >>> others = Until(force_above_n=500, strain_above_percent=2).without_force()
        >>> others.force_above_n, others.strain_above_percent
        (None, 2.0)
        """
        others = self.model_dump(exclude={"force_above_n", "force_below_n"}, exclude_none=True)
        return Until(**others) if others else None

    def met(self, reading: Reading) -> MetCondition | None:
        """Return the first condition that a reading meets, None when it meets none."""
        force = reading.signals.get(FORCE.name, math.nan)
        strain = PERCENT * reading.strain
        limits: list[tuple[str, float, str, float | None, bool]] = [
            ("force", force, "N", self.force_above_n, True),
            ("force", force, "N", self.force_below_n, False),
            ("strain", strain, "%", self.strain_above_percent, True),
            ("strain", strain, "%", self.strain_below_percent, False),
            ("valid fraction", reading.valid_fraction, "", self.valid_fraction_below, False),
            ("time", reading.duration, "s", self.time_above_s, True),
        ]
        for of_signals, rising in ((self.above, True), (self.below, False)):
            for name, limit in (of_signals or {}).items():
                limits.append((name, reading.signals.get(name, math.nan), "", limit, rising))
        for quantity, value, unit, bound, rising in limits:
            if bound is not None and (math.isnan(value) or (value >= bound if rising else value <= bound)):
                return MetCondition(quantity, value, bound, rising, unit)
        return None
