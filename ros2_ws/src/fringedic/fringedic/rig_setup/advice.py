"""Recommended settings with what the images are, as data."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from typing import NamedTuple


class SettingsProblem(Enum):
    """Kinds of warnings, with the meaning of `SettingsWarning.value` and `SettingsWarning.limit`."""

    NOISE_OUT_OF_REACH = auto()
    """Value: noise of the widest possible subset [px]; limit: subset that the requested noise needs [px]."""
    PERIOD_TOO_FEW_FEATURES = auto()
    """Value: requested period [px]; limit: features that the subset needs."""
    PERIOD_TOO_NOISY = auto()
    """Value: requested period [px]; limit: noise of the subset that keeps this period [px]."""
    SMALL_FEATURES = auto()
    """Value: feature size [px]; limit: smallest good size [px]."""
    LARGE_FEATURES = auto()
    """Value: feature size [px]; limit: largest good size [px]."""
    SATURATED = auto()
    """Value and limit: share of saturated pixels, 0 to 1."""
    DARK = auto()
    """Value and limit: share of black pixels, 0 to 1."""
    UNDEREXPOSED = auto()
    """Value and limit: 99th percentile of the grey levels over the full scale, 0 to 1."""
    QUANTISED = auto()
    """Value: noise of a pixel; limit: half the step between grey levels [grey level]."""
    EXCESS_NOISE = auto()
    """Value: measured noise of the displacement; limit: the one that image noise explains [px]."""
    MOVED = auto()
    """Value: mean displacement; limit: the one that noise allows [px]."""
    PERIODIC = auto()
    """Value: shortest distance after which the texture repeats; limit: largest displacement that is unique [px]."""
    FAINT = auto()
    """Value and limit: gradient energy over that of noise alone, in a rich window."""


class SettingsWarning(NamedTuple):
    """One thing that should be put right before the test.

    Attributes
    ----------
    problem
        Kind of the warning.
    value, limit
        What was found and what it is compared with, see `SettingsProblem`.
    """

    problem: SettingsProblem
    value: float
    limit: float


@dataclass(frozen=True)
class Advice:
    """What the images are, the settings recommended for them, and the noise floors at these settings.

    Pairs are (x, y): right and down in the image. Displacements are in pixels, strains dimensionless, grey levels as
    stored. `fringedic.rig_setup.settings_sentences.settings_report` writes an advice as text.

    Attributes
    ----------
    shape
        Rows and columns of the images.
    full_scale, quantisation
        Largest grey level that the camera can deliver and the step between grey levels; NaN where not known.
    saturated, dark
        Share of the pixels at the full scale (NaN where it is not known) and at zero, 0 to 1.
    grey_range
        1st and 99th percentile of the grey levels.
    coverage
        Share of the pixels that are darker than the middle between dark and bright, 0 to 1.
    image_noise
        Standard deviation of a pixel's noise between two exposures [grey level].
    contrast
        Standard deviation of the texture, without noise [grey level].
    feature_size
        Full width at half height of the texture's autocorrelation [px].
    mean_gradient
        Mean magnitude of the intensity gradient [grey level / px].
    window, spacing, strain_window
        Recommended window [px] and step size [px] as `measure_displacement` takes them, and the width of the strain
        window in points.
    binning
        Side of the blocks [px] that `measure_displacement` averages because the texture is coarse and faint; 1 for
        none. The window is `binning` times as wide in the image.
    period
        Shortest period of a displacement wave that keeps 90 % of its amplitude [px].
    noise, noise_predicted, noise_temporal, bias
        Displacement noise floor at these settings [px]: spatial standard deviation (averaged over both static images),
        the one that the stated uncertainty predicts, standard deviation over time (averaged over the points), and mean.
    strain_noise
        Spatial standard deviation of e_xx, e_yy and the tensor shear e_xy of the in-plane displacement.
    wanted_noise, wanted_period
        What was requested [px], or None.
    pixel_size
        Size of a pixel on the surface [m], or None.
    table
        Expected noise [px] and period [px] of other windows [px]: (window, noise, period).
    warnings
        What should be put right before the test; the sentences are in `fringedic.rig_setup.settings_sentences`.
    """

    shape: tuple[int, int]
    full_scale: float
    quantisation: float
    saturated: float
    dark: float
    grey_range: tuple[float, float]
    coverage: float
    image_noise: float
    contrast: float
    feature_size: tuple[float, float]
    mean_gradient: float
    window: int
    spacing: int
    strain_window: int
    binning: int
    period: float
    noise: tuple[float, float]
    noise_predicted: tuple[float, float]
    noise_temporal: tuple[float, float]
    bias: tuple[float, float]
    strain_noise: tuple[float, float, float]
    wanted_noise: float | None
    wanted_period: float | None
    pixel_size: float | None
    table: tuple[tuple[int, float, float], ...]
    warnings: tuple[SettingsWarning, ...]

    @property
    def subset(self) -> int:
        """Width of the subset in the image [px]."""
        return self.window * self.binning

    @property
    def gauge_length(self) -> float:
        """Virtual strain gauge L_VSG = (L_window - 1) L_step + L_subset [px]."""
        return (self.strain_window - 1) * self.spacing + self.subset

    @property
    def options(self) -> str:
        """Options of ``fringedic measure`` for these settings."""
        strain_window = (self.strain_window - 1) * self.spacing + 1
        return f"--window {self.window} --spacing {self.spacing} --strain-window {strain_window}"
