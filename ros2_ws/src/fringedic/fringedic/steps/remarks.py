"""Contents of a step's status beside its figures, as data: remarks on a valid result, and corrections of the phase."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from math import nan
from typing import Any

from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.phase.findings import Finding, FindingKind
from fringedic.steps.drift_marker import MarkerMotion

HEIGHTS_RELATIVE = "heights_relative"  # no values: the phase is relative, so that heights may be off by whole fringes
DRIFT_MARKER = "drift_marker"  # values: the fields of `MarkerMotion`
_OF_FINDINGS = {kind.name.lower(): kind for kind in FindingKind}  # values: see `Remark.of_finding`


@dataclass(frozen=True)
class Remark:
    """What needs attention although a result is valid; ``fringedic_msgs/Remark`` has the same content.

    Attributes
    ----------
    code
        Name of a `FindingKind` in small letters, `HEIGHTS_RELATIVE` or `DRIFT_MARKER`; empty for a sentence of an
        earlier version.
    values
        Numbers of the remark by name, in SI units, pixels and fringes.
    sentence
        Of a recording of an earlier version, which contains no code.
    """

    code: str
    values: Mapping[str, float] = field(default_factory=dict)
    sentence: str = ""

    @classmethod
    def of_finding(cls, finding: Finding) -> Remark:
        """Return a remark of the checks of a stack: its numbers, and pitch and shifts of the first pattern.

        Examples
        --------
        >>> Remark.of_finding(Finding(FindingKind.SATURATED, value=0.25))
        Remark(code='saturated', values={'value': 0.25}, sentence='')
        """
        numbers = {"value": finding.value, "limit": finding.limit, "light_change": finding.light_change}
        if finding.exposure_time is not None:
            numbers["exposure_time"] = finding.exposure_time
        if finding.patterns:
            numbers |= {"pitch": finding.patterns[0].pitch, "shifts": finding.patterns[0].shifts}
        known = {name: float(number) for name, number in numbers.items() if number == number}
        return cls(finding.kind.name.lower(), known)

    @classmethod
    def of_marker(cls, motion: MarkerMotion) -> Remark:
        """Return the remark that the drift marker has moved or is lost."""
        return cls(DRIFT_MARKER, {name: float(value) for name, value in asdict(motion).items()})

    @classmethod
    def of_message(cls, message: Any) -> Remark:
        """Return a remark from ``fringedic_msgs/Remark``."""
        values = dict(zip(message.names, map(float, message.values), strict=True))
        return cls(message.code, values, message.sentence)

    def finding(self) -> Finding | None:
        """Return the finding that a remark was made of, None for one of another origin."""
        kind = _OF_FINDINGS.get(self.code)
        if kind is None:
            return None
        pitch, shifts = (self.values.get(name, 0) for name in ("pitch", "shifts"))
        shown = ProjectedPattern(PatternKind.FRINGES, pitch=pitch, shifts=int(shifts))
        value, limit, change = (self.values.get(name, nan) for name in ("value", "limit", "light_change"))
        return Finding(
            kind,
            patterns=(shown,),
            value=value,
            limit=limit,
            light_change=change,
            exposure_time=self.values.get("exposure_time"),
        )

    def marker(self) -> MarkerMotion | None:
        """Return the motion of the drift marker that a remark was made of, None for one of another origin."""
        if self.code != DRIFT_MARKER:
            return None
        values = dict(self.values)
        return MarkerMotion(reference_step=int(values.pop("reference_step")), **values)


class CorrectionKind(StrEnum):
    """What can be corrected in a phase, with the texts of ``fringedic_msgs/Correction``."""

    LENS_BLUR = "lens_blur"
    HARMONICS = "harmonics"


@dataclass(frozen=True)
class Correction:
    """One correction of a phase. Two phases are compared only when their corrections are equal.

    Attributes
    ----------
    kind
        What was corrected.
    size
        LENS_BLUR: standard deviation of the blur [px]; otherwise 0.
    """

    kind: CorrectionKind
    size: float = 0.0

    def __str__(self) -> str:
        if self.kind is CorrectionKind.LENS_BLUR:
            return f"lens blur {self.size:g} px"
        return "harmonics"

    @classmethod
    def of_message(cls, message: Any) -> Correction:
        """Return a correction from ``fringedic_msgs/Correction``."""
        return cls(CorrectionKind(message.kind), message.size)


def corrections_text(corrections: Sequence[Correction]) -> str:
    """Return corrections as they stand in a sentence.

    Examples
    --------
    >>> corrections_text([Correction(CorrectionKind.LENS_BLUR, 0.8), Correction(CorrectionKind.HARMONICS)])
    'lens blur 0.8 px, harmonics'
    >>> corrections_text([])
    'nothing'
    """
    return ", ".join(map(str, corrections)) or "nothing"
