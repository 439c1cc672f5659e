"""Figure of a response curve: the curve, and the harmonic error of the phase before and after its correction."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fringedic.patterns.response import FULL_SCALE, ResponseCurve
from fringedic.phase.checks.harmonic_error import HarmonicError
from fringedic.wording.optional_packages import optional_import

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def response_figure(curve: ResponseCurve, before: HarmonicError, after: HarmonicError) -> Figure:
    """Draw the curve, the error over one fringe with three shifts, and how much is left with each number of shifts.

    Parameters
    ----------
    curve
        The measured curve.
    before, after
        Harmonic error with patterns as they are, and with patterns that are corrected for the curve.
    """
    with optional_import("figures"):
        from matplotlib.figure import Figure
    figure = Figure(figsize=(12.5, 4.0), dpi=100, layout="constrained")
    bent, wave, bars = figure.subplots(1, 3)
    level = np.arange(FULL_SCALE + 1)
    brightness = np.array(curve.brightness)
    shown = np.round(curve.level_for(level / FULL_SCALE)).astype(int)
    bent.plot(level, level / FULL_SCALE, color="0.7", linestyle="--", label="straight line")
    bent.plot(level, brightness, color="tab:orange", label=f"as it is: gamma {curve.gamma:.2f}")
    bent.plot(level, brightness[shown], color="tab:blue", label="with corrected patterns")
    bent.set_xlabel("requested grey level")
    bent.set_ylabel("brightness in the image, black 0, white 1")
    bent.legend(loc="upper left")
    fewest = min(before.error)
    for waves, name, colour in ((before, "as it is", "tab:orange"), (after, "corrected", "tab:blue")):
        wave.plot(np.degrees(waves.phase), waves.error[fewest], color=colour, label=f"{name}: {waves.rms(fewest):.4f}")
    wave.set_xlabel("phase [degree]")
    wave.set_ylabel("error [fringe]")
    wave.set_title(f"harmonic error over one fringe, {fewest} shifts; RMS [fringe]", fontsize=10)
    wave.legend(loc="upper right")
    places = np.arange(len(before.error))
    for offset, waves, name, colour in (
        (-0.2, before, "as it is", "tab:orange"),
        (0.2, after, "corrected", "tab:blue"),
    ):
        bars.bar(places + offset, [waves.rms(each) for each in waves.error], 0.4, color=colour, label=name)
    bars.set_yscale("log")
    bars.set_xticks(places, [str(each) for each in before.error])
    bars.set_xlabel("shifts")
    bars.set_ylabel("harmonic error, RMS [fringe]")
    bars.legend(loc="upper right")
    return figure
