"""Conditions of a programme: limits of force, strain and valid fraction that end a move, a ramp or a cycle."""

from __future__ import annotations

import math
from enum import StrEnum
from typing import NamedTuple

from pydantic import Field, model_validator

from fringedic.configuration.yaml_section import Section

PERCENT = 100.0


class Reading(NamedTuple):
    """Values that conditions are compared with; NaN is not known.

    Attributes
    ----------
    force
        Force [N], tension positive.
    strain
        Strain of the extensometer, dimensionless.
    valid_fraction
        Measured part of the surface, 0 to 1.
    """

    force: float = math.nan
    strain: float = math.nan
    valid_fraction: float = math.nan


class Quantity(StrEnum):
    """Quantities of a condition."""

    FORCE = "force"
    STRAIN = "strain"
    VALID_FRACTION = "valid fraction"


class MetCondition(NamedTuple):
    """A limit that a reading reached; `fringedic.configuration.sentences.condition_sentence` composes the sentence.

    Attributes
    ----------
    quantity
        What is limited.
    value
        The reading in the unit of the limit; NaN when it is not known, which meets every condition.
    limit
        The limit as it is written in the programme [N, %, or 0 to 1].
    rising
        The limit is reached from below.
    """

    quantity: Quantity
    value: float
    limit: float
    rising: bool


class Until(Section):
    """Conditions of which the first that is met ends a move, a ramp or a cycle; an unknown value ends it, too.

    Examples
    --------
    >>> until = Until(force_above_n=500)
    >>> until.met(Reading(force=499.0)) is None
    True
    >>> until.met(Reading(force=510.0)).value
    510.0
    """

    force_above_n: float | None = Field(None, description="The force reaches this from below [N].")
    force_below_n: float | None = Field(None, description="The force falls to this: unloaded, or broken [N].")
    strain_above_percent: float | None = Field(None, description="The extensometer's strain reaches this [%].")
    strain_below_percent: float | None = Field(None, description="The extensometer's strain falls to this [%].")
    valid_fraction_below: float | None = Field(
        None, gt=0, le=1, description="Less of the surface than this is measured, 0 to 1; not for a move."
    )

    @model_validator(mode="after")
    def _has_a_condition(self) -> Until:
        if not self.model_fields_set:
            raise ValueError(f"give one of {', '.join(type(self).model_fields)}")
        return self

    @property
    def needs_strain(self) -> bool:
        """Whether a condition needs an extensometer."""
        return self.strain_above_percent is not None or self.strain_below_percent is not None

    def of_strain(self) -> Until | None:
        """Return the conditions of the strain alone; None without any.

        Examples
        --------
        >>> strain = Until(force_above_n=500, strain_above_percent=2).of_strain()
        >>> strain.force_above_n, strain.strain_above_percent
        (None, 2.0)
        """
        names = self.model_fields_set & {"strain_above_percent", "strain_below_percent"}
        return Until(**{name: getattr(self, name) for name in names}) if self.needs_strain else None

    def met(self, reading: Reading) -> MetCondition | None:
        """Return the first condition that a reading meets, None when it meets none."""
        strain = PERCENT * reading.strain
        for quantity, value, limit, rising in (
            (Quantity.FORCE, reading.force, self.force_above_n, True),
            (Quantity.FORCE, reading.force, self.force_below_n, False),
            (Quantity.STRAIN, strain, self.strain_above_percent, True),
            (Quantity.STRAIN, strain, self.strain_below_percent, False),
            (Quantity.VALID_FRACTION, reading.valid_fraction, self.valid_fraction_below, False),
        ):
            if limit is None:
                continue
            if math.isnan(value) or (value >= limit if rising else value <= limit):
                return MetCondition(quantity, value, limit, rising)
        return None
