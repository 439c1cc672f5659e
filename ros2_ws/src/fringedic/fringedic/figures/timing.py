"""Figure of a projector's timing: brightness after a change of the pattern, and pulses of the light."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fringedic.rig_setup.timing import ProjectorTiming
from fringedic.rig_setup.timing_samples import TimingSamples
from fringedic.wording.optional_packages import optional_import

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = {True: "tab:orange", False: "tab:blue"}


def timing_figure(samples: TimingSamples, timing: ProjectorTiming, exposure_time: float) -> Figure:
    """Draw the brightness over the time since the pattern and, where the light pulses, over the phase of the refresh.

    Parameters
    ----------
    samples, timing
        Samples and measurement.
    exposure_time
        Exposure time of the rig's frames [s].
    """
    with optional_import("figures"):
        from matplotlib.figure import Figure
    figure = Figure(figsize=(12.5, 5.0), dpi=100, layout="constrained")
    if timing.refresh is None:
        _change(figure.subplots(), samples, timing)
    else:
        change, pulses = figure.subplots(1, 2)
        _change(change, samples, timing)
        refresh = timing.refresh
        assert refresh is not None, "only called for pulsing light"
        chosen = samples.bright & (samples.since - samples.exposure_time / 2 > timing.settled())
        seen = (samples.brightness[chosen] - timing.dark) / (timing.bright - timing.dark)
        pulses.plot(
            1e3 * (samples.stamp[chosen] % refresh.period), 100 * seen, ".", color=COLOURS[True], label="frames"
        )
        time = np.linspace(0.0, refresh.period, 400)
        whole = timing.whole_exposure(exposure_time)
        for length, style in ((samples.exposure_time, "-"), (exposure_time, "--"), (whole, ":")):
            wave = refresh.mean(time - length / 2, length)
            pulses.plot(1e3 * time, 100 * wave, style, color="black", label=f"exposures of {1e3 * length:.4g} ms")
        pulses.set(
            xlabel="middle of the exposure within a refresh period [ms]",
            ylabel="brightness of white [% of its mean]",
            title=f"The light pulses at {refresh.frequency:.2f} Hz",
        )
        pulses.legend(loc="upper right")
    return figure


def _change(axes: Axes, samples: TimingSamples, timing: ProjectorTiming) -> None:
    end = min(2.0 * timing.settle_time() + samples.exposure_time, float(samples.since.max()))
    since = np.linspace(0.0, end, 600)
    for bright in (True, False):
        chosen = (samples.bright == bright) & (samples.since <= end)
        after = "after white" if bright else "after dark"
        axes.plot(1e3 * samples.since[chosen], samples.brightness[chosen], ".", color=COLOURS[bright], label=after)
        axes.plot(1e3 * since, timing.curve(since, bright), color=COLOURS[bright], linewidth=1)
    if not np.isnan(timing.delay):
        axes.axvline(1e3 * timing.delay, color="black", linestyle=":", label=f"delay {1e3 * timing.delay:.2f} ms")
    settle = 1e3 * timing.settle_time()
    axes.axvline(settle, color="black", linestyle="--", label=f"settle time to set: {settle:.4g} ms")
    axes.set(
        xlabel="time from the request of the pattern to the middle of the exposure [ms]",
        ylabel="brightness of the lit pixels [grey level]",
        title=f"{timing.samples} frames of {1e3 * timing.exposure_time:.3g} ms",
    )
    axes.legend(loc="center right")
