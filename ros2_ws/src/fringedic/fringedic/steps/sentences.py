"""Sentences about the drift marker."""

from __future__ import annotations

from fringedic.steps.drift_marker import COMPONENTS, MarkerMotion
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
