"""Codes of what a registration of sensors can remark."""

from __future__ import annotations

from enum import StrEnum


class RegistrationFinding(StrEnum):
    """Remarks on a registration, with the values of each."""

    CONTRADICTION = "contradiction"  # subject: sensor and object; deviation [m], sigmas
    NOT_TESTED = "not_tested"  # nothing is left over to test the poses
    UNCERTAIN = "uncertain"  # subject: sensor; sigma [m] of a point in the middle of its objects


class RegistrationVerdict(StrEnum):
    """Whether a registration can be used."""

    GO = "GO"
    WITH_CARE = "GO with care"
    NO_GO = "NO-GO"
