"""Picture of a clock that was fitted to a signal: both recordings over each other, and their difference."""

from __future__ import annotations

from fringedic.datasets.quantities import PeopleUnit
from fringedic.signals import Alignment, Channel
from fringedic.wording.optional_packages import optional_import

with optional_import("figures"):
    from matplotlib.figure import Figure


def alignment_figure(alignment: Alignment, channel: Channel, name: str) -> Figure:
    """Draw the smoothed signal of the rig and that of a file on its clock, and below the difference of both.

    Parameters
    ----------
    alignment
        From `fringedic.signals.align_clocks`.
    channel
        What the signal measures.
    name
        Of the file.
    """
    unit = PeopleUnit("mm", "mm", 1e-3) if channel.unit == "m" else PeopleUnit(channel.unit, channel.unit, 1.0)
    figure = Figure(figsize=(10.0, 6.0), dpi=100, layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    time = 1e-9 * (alignment.stamps - alignment.stamps[0])
    fitted = f"{name}, times {alignment.gain:.5g} plus {alignment.level / unit.factor:.4g} {unit.text}"
    upper.plot(time, alignment.rig / unit.factor, label="recording")
    upper.plot(time, alignment.file / unit.factor, "--", label=fitted)
    lower.plot(time, (alignment.rig - alignment.file) / unit.factor, color="tab:red")
    clock = alignment.clock
    upper.set(
        ylabel=f"{channel.name} [{unit.text}]",
        title=f"clock of the file: {clock.offset:+.4f} s ± {1e3 * clock.sigma_offset:.2g} ms (standard uncertainty), "
        f"drift {1e6 * clock.drift:+.0f} ± {1e6 * clock.sigma_drift:.0f} ppm",
    )
    lower.set(xlabel="time of the recording [s]", ylabel=f"difference [{unit.text}]")
    upper.legend(loc="best")
    return figure
