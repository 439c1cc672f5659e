"""Sentences about an acceptance test."""

from __future__ import annotations

import math

from fringedic.calibration.acceptance import (
    BALL_RANGE,
    LEAST_SPACING,
    Acceptance,
    AcceptanceError,
    Artefact,
    Place,
    unsuitable,
)
from fringedic.wording.numbers import number_text


def acceptance_text(acceptance: Acceptance) -> str:
    """Return the result, one line for each characteristic, and what differs from the guideline."""
    rows = [f"  {name:32s} {worst:>12s}   limit {limit}" for name, worst, limit in error_rows(acceptance)]
    return "\n".join([verdict_sentence(acceptance), *rows, *(f"  {each}" for each in size_sentences(acceptance))])


def verdict_sentence(acceptance: Acceptance) -> str:
    """Return whether the rig passes."""
    if not acceptance.limits:
        return "Errors without a judgement: the section acceptance states no maximum permissible error."
    if acceptance.passed:
        return "PASSED: no error exceeds its maximum permissible error."
    return f"FAILED: {', '.join(acceptance.exceeded)} exceeds the maximum permissible error."


def error_rows(acceptance: Acceptance) -> list[tuple[str, str, str]]:
    """Return (characteristic, worst error, maximum permissible error)."""
    return [
        (error.value, _micro(acceptance.worst(error)), _micro(acceptance.limits.get(error, math.nan)))
        for error in AcceptanceError
    ]


def place_rows(acceptance: Acceptance) -> list[tuple[str, str, str, str]]:
    """Return (number, place, errors, points) of every place."""
    return [
        (
            str(number),
            place_in_words(each.place),
            ", ".join(f"{error.value} {_micro(value)}" for error, value in each.errors.items()),
            str(each.points),
        )
        for number, each in enumerate(acceptance.results, start=1)
    ]


def size_sentences(acceptance: Acceptance) -> list[str]:
    """Return what of the artefacts differs from the sizes that the guideline asks for."""
    artefacts, found = acceptance.artefacts, unsuitable(acceptance.artefacts)
    low, high = (1e3 * part * artefacts.diagonal for part in BALL_RANGE)
    sentences = []
    if Artefact.BALL in found:
        sentences.append(
            f"The ball of {1e3 * artefacts.diameter:g} mm is not {low:.3g} to {high:.3g} mm, a tenth to a fifth of the "
            "volume's diagonal."
        )
    if Artefact.BALL_BAR in found:
        least = 1e3 * LEAST_SPACING * artefacts.diagonal
        sentences.append(f"The bar of {1e3 * artefacts.spacing:g} mm is shorter than {least:.3g} mm.")
    return sentences


def place_in_words(place: Place) -> str:
    """Return where an artefact is, for an operator."""
    x, y, z = (1e3 * each for each in place.centre)
    turns = [
        f"{math.degrees(angle):+.0f} degree about {axis}"
        for angle, axis in zip(place.rotation, "xyz", strict=True)
        if abs(angle) > 1e-9
    ]
    turned = f", turned {' and '.join(turns)}" if turns else ""
    return f"{place.artefact} at x {x:+.1f}, y {y:+.1f}, z {z:+.1f} mm{turned}"


def _micro(value: float) -> str:
    return "-" if math.isnan(value) else f"{number_text(1e6 * value, 3)} µm"
