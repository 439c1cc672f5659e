"""Choice of the correlation window from requested noise or resolution."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fringedic.correlation.images import SMALLEST_WINDOW
from fringedic.correlation.transfer import shortest_period
from fringedic.rig_setup.advice import SettingsProblem, SettingsWarning

FIRST_WINDOW = 32  # [px], for measuring the noise before a window is recommended
WIDEST_WINDOW = 256  # [px], as of the parameter dic.window
# features in a subset, at least and usually: Jones and Iadicola (eds.), "A Good Practices Guide for Digital Image
# Correlation" (2018)
FEWEST_FEATURES, USUAL_FEATURES = 3, 5


@dataclass(frozen=True)
class WindowRequest:
    """What is wanted of a window.

    Attributes
    ----------
    noise
        Standard deviation of the displacement [px], or None.
    period
        Period of the shortest displacement wave that must keep 90 % of its amplitude [px], or None.
    """

    noise: float | None
    period: float | None


def choose_window(
    request: WindowRequest, *, noise_scale: float, feature_size: float, widest: int, binning: int = 1
) -> tuple[int, list[SettingsWarning]]:
    """Return the recommended width of the subset [px], and warnings about requests that it does not fulfil.

    Parameters
    ----------
    request
        Requested noise and resolution; a requested noise has priority.
    noise_scale
        Noise of the displacement times ``window - 1`` [px^2].
    feature_size
        Larger of the feature sizes in both directions [px]; NaN where not known.
    widest
        Widest subset that the images allow [px].
    binning
        Side of the blocks whose mean is a pixel of the window [px]; the subset consists of whole blocks.
    """
    fewest = _whole_blocks(max(SMALLEST_WINDOW * binning, _width_of(FEWEST_FEATURES, feature_size)), binning)
    widest = min(widest // binning, WIDEST_WINDOW) * binning
    period_per_width = shortest_period(FIRST_WINDOW) / (FIRST_WINDOW - 1)
    if request.noise is not None:
        wanted = _whole_blocks(1 + math.ceil(noise_scale / request.noise), binning)
    elif request.period is not None:
        wanted = (1 + math.floor(request.period / period_per_width)) // binning * binning
    else:
        usual = max(2 * SMALLEST_WINDOW, _width_of(USUAL_FEATURES, feature_size))
        wanted = max(fewest, _whole_blocks(usual, binning))
    window = min(max(wanted, fewest), widest)

    warnings = []
    if request.noise is not None and wanted > widest:
        warnings.append(SettingsWarning(SettingsProblem.NOISE_OUT_OF_REACH, noise_scale / (window - 1), wanted))
    if request.period is not None and period_per_width * (window - 1) > request.period * (1 + 1e-9):
        if request.noise is not None and wanted > fewest:
            noise = noise_scale * period_per_width / request.period
            warnings.append(SettingsWarning(SettingsProblem.PERIOD_TOO_NOISY, request.period, noise))
        else:
            warnings.append(SettingsWarning(SettingsProblem.PERIOD_TOO_FEW_FEATURES, request.period, FEWEST_FEATURES))
    return window, warnings


def _whole_blocks(width: int, binning: int) -> int:
    """Return the narrowest width of whole blocks that is at least as wide [px]."""
    return -(-width // binning) * binning


def _width_of(features: int, feature_size: float) -> int:
    """Return the width of so many features [px]; 0 where their size is not known."""
    return math.ceil(features * feature_size) if math.isfinite(feature_size) else 0
