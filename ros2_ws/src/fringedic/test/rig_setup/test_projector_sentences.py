"""Assessment of a response correction, and the sentences about it."""

from __future__ import annotations

import numpy as np
import pytest

from fringedic.patterns.response import ResponseCurve
from fringedic.phase.checks.harmonic_error import HarmonicError
from fringedic.rig_setup.projector_sentences import response_sentences
from fringedic.rig_setup.response import Correction, assess_correction

BRIGHTNESS = tuple((level / 255) ** 2.2 for level in range(256))
CURVE = ResponseCurve(BRIGHTNESS, sigma=0.004)


def harmonic_error(rms: float) -> HarmonicError:
    """Error of this RMS with three shifts, a tenth of it with four."""
    return HarmonicError(np.zeros(8), {3: np.full(8, rms), 4: np.full(8, 0.1 * rms)})


@pytest.mark.parametrize(
    ("before", "after", "shifts", "correction", "recommendation"),
    [
        (0.024, 0.0004, 3, Correction.USEFUL, "Three shifts need the correction"),
        (0.024, 0.0004, 4, Correction.USEFUL, "With the 4 shifts of the rig file the error is smaller"),
        (0.0006, 0.0009, 3, Correction.HARMFUL, "Corrected patterns increase the error"),
        (0.0004, 0.0009, 3, Correction.UNNECESSARY, "The response is linear enough"),
    ],
)
def test_correction_is_recommended_when_it_helps(
    before: float, after: float, shifts: int, correction: Correction, recommendation: str
) -> None:
    errors = harmonic_error(before), harmonic_error(after)
    assert assess_correction(*errors) is correction
    first, *middle, last = response_sentences(CURVE, *errors, shifts)
    assert first == (
        "Projector and camera together: gamma 2.20 (1 is linear); standard deviation over the image 0.4 %."
    )
    assert middle[0].startswith(f"Harmonic phase error with 3 shifts: {before:.5f} fringe without correction, ")
    assert len(middle) == 2
    assert last.startswith(recommendation)


def test_uneven_curve_asks_for_another_measurement() -> None:
    sentences = response_sentences(ResponseCurve(BRIGHTNESS, 0.03), harmonic_error(0.02), harmonic_error(0.0004), 3)
    assert "The curve differs too much over the image" in sentences[1]
