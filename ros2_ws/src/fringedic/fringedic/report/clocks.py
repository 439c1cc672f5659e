"""Sentences about the clocks of camera and testing machine."""

from __future__ import annotations

import math
from collections.abc import Mapping

from fringedic.recording.clocks import ClockEstimate

_MS, _PPM = 1e3, 1e6


def clock_sentences(clocks: Mapping[str, ClockEstimate]) -> list[str]:
    """Return one sentence for each device with a clock of its own: its offset and its drift.

    Parameters
    ----------
    clocks
        Estimates by the name of the device, as `fringedic.recording.recorded_clocks.recorded_clocks` returns them.

    Examples
    --------
    >>> clock_sentences({"camera": ClockEstimate(0, offset=1.5e-3, drift=2e-5, drift_sigma=3e-7, samples=40)})
    ['Clock of the camera: +1.500 ms relative to this computer since the first comparison; drift +20.0 ppm (standard \
uncertainty 0.3 ppm).']
    """
    return [_sentence(name, clock) for name, clock in clocks.items()]


def _sentence(name: str, clock: ClockEstimate) -> str:
    words = f"Clock of the {name}: {_MS * clock.offset:+.3f} ms relative to this computer since the first comparison"
    if math.isnan(clock.drift):
        return f"{words}."
    sigma = "" if math.isnan(clock.drift_sigma) else f" (standard uncertainty {_PPM * clock.drift_sigma:.2g} ppm)"
    return f"{words}; drift {_PPM * clock.drift:+.1f} ppm{sigma}."
