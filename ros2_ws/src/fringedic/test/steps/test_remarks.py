"""Remarks as data have the sentence of what they were made of."""

from __future__ import annotations

from dataclasses import asdict
from types import SimpleNamespace

import pytest

from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.phase.findings import Finding, FindingKind
from fringedic.phase.sentences import describe
from fringedic.steps.drift_marker import MarkerMotion
from fringedic.steps.remarks import Remark
from fringedic.steps.sentences import drift_sentence, remark_sentence

PATTERN = (ProjectedPattern(PatternKind.FRINGES, pitch=16.0, shift=1, shifts=3),)
FINDINGS = [
    Finding(FindingKind.SATURATED, value=0.25),
    Finding(FindingKind.SATURATED, value=0.25, exposure_time=0.02),
    Finding(FindingKind.FLICKER, value=0.003, limit=0.01, light_change=0.04),
    Finding(FindingKind.MOTION_ACROSS, value=0.1, limit=0.2),
    Finding(FindingKind.HARMONICS, patterns=PATTERN, value=0.02, limit=0.01),
    Finding(FindingKind.RELATIVE_ONE_IMAGE, patterns=PATTERN),
    Finding(FindingKind.RELATIVE_ONE_PITCH, patterns=PATTERN),
]


def sent(remark: Remark) -> Remark:
    """Return a remark as it arrives in a message."""
    names, values = list(remark.values), list(remark.values.values())
    return Remark.of_message(SimpleNamespace(code=remark.code, sentence="", names=names, values=values))


@pytest.mark.parametrize("finding", FINDINGS, ids=lambda finding: finding.kind.name)
def test_a_finding_has_the_same_sentence_after_its_way_through_a_message(finding: Finding) -> None:
    assert remark_sentence(sent(Remark.of_finding(finding))) == describe(finding)


def test_the_motion_of_the_marker_does_too() -> None:
    motion = MarkerMotion(5e-6, 0.0, -3e-6, 1e-6, 1e-6, 2e-6, measured=0.9, reference_step=2)
    again = sent(Remark.of_marker(motion))
    assert (again.marker(), remark_sentence(again)) == (motion, drift_sentence(motion))
    assert set(again.values) == set(asdict(motion))
