"""What a measurement found to be worth a remark: a code with values (SI); sentences are composed elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum


class GridFinding(StrEnum):
    """Remarks on the image of a printed grid, with the values of each."""

    SATURATED = "grid_saturated"  # share
    IN_STEP = "grid_in_step"  # period_columns, period_rows [px] where in step; turn, advised_turn (if any) [rad]
    COVERED = "grid_covered"  # subject: the places
    ASPECT = "grid_aspect"  # difference, relative
    SKEW = "grid_skew"  # angle between both directions [rad]
    CONTRADICTION = "grid_contradiction"  # residual [px]; stated_1, apparent_1, stated_2, ... [rad]


@dataclass(frozen=True)
class Finding:
    """A remark as data.

    Attributes
    ----------
    code
        Which remark it is; the enumerations list the values of each.
    subject
        Name of the image or the places concerned; empty when it concerns all.
    values
        Numbers of the remark by name, in SI units and pixels.
    """

    code: StrEnum
    subject: str = ""
    values: Mapping[str, float] = field(default_factory=dict)
