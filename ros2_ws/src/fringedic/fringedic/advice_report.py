"""Words for the advice on settings: the terms of good practice, lengths in pixels and millimetres."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fringedic.advice import Advice


def report(advice: Advice) -> str:
    """Images, settings, noise floors, other subsets and warnings, one line each."""
    size = advice.pixel_size

    def length(pixels: float, digits: int = 1) -> str:
        return f"{pixels:.{digits}f} px" + ("" if size is None else f" ({1e3 * size * pixels:.3g} mm)")

    def displacement(values: tuple[float, float]) -> str:
        text = " / ".join(f"{value:z.4f}" for value in values) + " px"
        return text + ("" if size is None else " (" + " / ".join(f"{1e6 * size * v:.3g}" for v in values) + " µm)")

    known = math.isfinite(advice.full_scale)

    def percent(value: float) -> str:
        return f" ({100 * value / advice.full_scale:.1f} %)" if known else ""

    low, high = advice.grey_range
    features = advice.window / math.sqrt(advice.feature_size[0] * advice.feature_size[1])
    lines = [
        ("", "Images (x / y: along columns / rows)"),
        ("image resolution", f"{advice.shape[1]} x {advice.shape[0]} px"),
        ("full scale", f"{advice.full_scale:g} in steps of {advice.quantisation:g}" if known else "not known"),
        ("grey levels, 1 % to 99 %", f"{low:.0f}{percent(low)} to {high:.0f}{percent(high)}"),
        ("saturated, black", f"{100 * advice.saturated:.2f} %, {100 * advice.dark:.2f} % of the pixels"),
        ("dark coverage", f"{100 * advice.coverage:.0f} % (about 50 % is best)"),
        ("image noise", f"{advice.image_noise:.2f} grey levels{percent(advice.image_noise)}"),
        ("contrast", f"{advice.contrast:.1f} grey levels{percent(advice.contrast)}"),
        ("feature size", f"{advice.feature_size[0]:.2f} / {advice.feature_size[1]:.2f} px (3 to 5 px are best)"),
        ("mean intensity gradient", f"{advice.mean_gradient:.1f} grey levels/px"),
        ("", "Settings"),
        ("subset size", f"{length(advice.window, 0)}, {features:.1f} features"),
        ("step size", length(advice.spacing, 0)),
        ("spatial resolution", f"{length(advice.period, 0)}: shortest period that keeps 90 % of its amplitude"),
        ("strain window", f"{advice.strain_window} points ({(advice.strain_window - 1) * advice.spacing + 1} px)"),
        ("virtual strain gauge", f"{length(advice.gauge_length, 0)}: (window - 1) step + subset"),
        ("", "Noise floors of these settings (x / y)"),
        ("displacement, spatial", displacement(advice.noise)),
        ("  predicted from the images", displacement(advice.noise_predicted)),
        ("displacement, temporal", displacement(advice.noise_temporal)),
        ("displacement, bias", displacement(advice.bias)),
        ("strain e_xx / e_yy / e_xy", " / ".join(f"{1e6 * value:.0f}" for value in advice.strain_noise) + " µstrain"),
        ("  which is", "that of the in-plane displacement alone: planes over the strain window"),
        ("method", "two static images against the reference; spatial: over the points, averaged over both images;"),
        ("  ", "temporal: between both images, averaged over the points"),
    ]
    return _laid_out(lines, advice)


def _laid_out(lines: list[tuple[str, str]], advice: Advice) -> str:
    """Lines of (name, text), where an empty name begins a section, then the table and the warnings."""
    out = [f"  {name:28s} {text}" if name else f"\n{text}" for name, text in lines]
    out.append("\nOther subsets: noise and spatial resolution to be expected")
    out += [f"  {w:4d} px   {noise:.4f} px   {period:4.0f} px" for w, noise, period in advice.table]
    if advice.warnings:
        out += ["\nBefore the test", *(f"  - {warning}" for warning in advice.warnings)]
    return "\n".join(out).lstrip("\n")
