"""Sentences about the remarks on a step: its drift marker, its frames, its heights."""

from __future__ import annotations

from fringedic.phase.sentences import describe
from fringedic.steps.drift_marker import COMPONENTS, MarkerMotion
from fringedic.steps.remarks import HEIGHTS_RELATIVE, Remark
from fringedic.wording.numbers import number_text


def drift_sentence(motion: MarkerMotion) -> str:
    """Return what a person has to know about the apparent motion of the drift marker; empty when it stood still."""
    if motion.lost:
        return (
            f"only {100 * motion.measured:.0f} % of the drift marker is measured: drift of the rig cannot be detected; "
            "give the marker a texture, light, and a margin of one window"
        )
    if not motion.moved:
        return ""
    moved = ", ".join(f"{name} {number_text(1e6 * getattr(motion, name), 2, sign=True)} µm" for name in COMPONENTS)
    noise = ", ".join(number_text(1e6 * getattr(motion, f"sigma_{name}"), 2) for name in COMPONENTS)
    return (
        f"the drift marker has moved since step {motion.reference_step} by {moved} (noise of one point: {noise} µm): "
        "the rig drifts, the projector is warming up, or the frame yields"
    )


def remark_sentence(remark: Remark) -> str:
    """Return the sentence about a remark; of a code of a later version its name and numbers.

    Examples
    --------
    >>> remark_sentence(Remark("relative_one_image"))
    'the phase of one image is relative: true up to the same number of whole fringes everywhere'
    >>> remark_sentence(Remark("focus_lost", {"part": 0.25}))
    'focus_lost (part 0.25)'
    """
    if remark.sentence:
        return remark.sentence
    if (finding := remark.finding()) is not None:
        return describe(finding)
    if (motion := remark.marker()) is not None:
        return drift_sentence(motion)
    if remark.code == HEIGHTS_RELATIVE:
        return "heights may be off by whole fringes, because the phase is relative"
    values = ", ".join(f"{name} {value:g}" for name, value in remark.values.items())
    return f"{remark.code} ({values})" if values else remark.code
