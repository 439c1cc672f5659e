"""Checks of static images by good practice; `fringedic.rig_setup.settings_sentences` composes the sentences."""

from __future__ import annotations

import math

from fringedic.rig_setup.advice import Advice, SettingsProblem, SettingsWarning

# Features of 3 to 5 px: Jones and Iadicola (eds.), "A Good Practices Guide for Digital Image Correlation" (2018). The
# other limits are chosen so that the images of test_recommended_settings.py give the warnings that they deserve.
SMALLEST_FEATURE, LARGEST_FEATURE = 3.0, 7.0  # [px]; smaller features alias, larger ones waste resolution
MOST_SATURATED, MOST_DARK = 0.005, 0.01  # share of the pixels
LEAST_RANGE = 0.5  # of the full scale, reached by the brightest pixels
LEAST_NOISE = 0.5  # of the step between grey levels; with less, rounding errors of static images are alike
EXCESS_NOISE = 1.25  # displacement noise over the one that image noise explains
MOST_MOTION = 5.0  # mean displacement over its noise
SMALLEST_NOISE = 0.002  # [px], for the comparison with the mean displacement


def texture_warnings(period: float, energy: float, faint: float) -> list[SettingsWarning]:
    """Return what is wrong with the texture of a reference.

    Parameters
    ----------
    period
        Shortest distance after which it repeats [px]; NaN where it does not.
    energy
        Gradient energy over that of noise alone; NaN of a texture that is not both coarse and faint.
    faint
        Energy up to which a texture counts as faint.
    """
    found = []
    if math.isfinite(period):
        found.append(SettingsWarning(SettingsProblem.PERIODIC, period, period / 2))
    if energy <= faint:
        found.append(SettingsWarning(SettingsProblem.FAINT, energy, faint))
    return found


def image_warnings(advice: Advice) -> list[SettingsWarning]:
    """Return what good practice finds wrong with the images."""
    found = []
    if advice.saturated > MOST_SATURATED:
        found.append(SettingsWarning(SettingsProblem.SATURATED, advice.saturated, MOST_SATURATED))
    if advice.dark > MOST_DARK:
        found.append(SettingsWarning(SettingsProblem.DARK, advice.dark, MOST_DARK))
    if math.isfinite(advice.full_scale) and advice.grey_range[1] < LEAST_RANGE * advice.full_scale:
        share = advice.grey_range[1] / advice.full_scale
        found.append(SettingsWarning(SettingsProblem.UNDEREXPOSED, share, LEAST_RANGE))
    size = math.sqrt(advice.feature_size[0] * advice.feature_size[1])
    if size < SMALLEST_FEATURE:
        features = [SettingsWarning(SettingsProblem.SMALL_FEATURES, size, SMALLEST_FEATURE)]
    elif size > LARGEST_FEATURE:
        features = [SettingsWarning(SettingsProblem.LARGE_FEATURES, size, LARGEST_FEATURE)]
    else:
        features = []
    noisy = []
    measured, predicted = max(advice.noise), max(advice.noise_predicted)
    smallest = LEAST_NOISE * advice.quantisation
    if advice.image_noise < smallest:
        noisy.append(SettingsWarning(SettingsProblem.QUANTISED, advice.image_noise, smallest))
    elif measured > EXCESS_NOISE * predicted:
        noisy.append(SettingsWarning(SettingsProblem.EXCESS_NOISE, measured, predicted))
    moved, allowed = math.hypot(*advice.bias), MOST_MOTION * max(measured, SMALLEST_NOISE)
    if moved > allowed:
        noisy.append(SettingsWarning(SettingsProblem.MOVED, moved, allowed))
    return [*features, *found, *noisy]
