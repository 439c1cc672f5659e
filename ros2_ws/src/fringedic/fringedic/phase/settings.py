"""Settings of a phase measurement: the noise model, what counts as measured, and the limits of its checks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from fringedic.frames.noise import CameraNoise
from fringedic.frames.region import Region

Method = Literal["auto", "steps", "one_image"]


@dataclass(frozen=True)
class PhaseSettings:
    """Settings of `measure_phase`.

    Attributes
    ----------
    method
        ``steps``: phase stepping; ``one_image``: from the last fringe image alone; ``auto``: from one image when there
        is only one.
    accept_relative
        Whether a relative phase, which is true up to whole fringes, is a result: that of one image, or that of one
        pitch without a Gray code that repeats in view. It is an error otherwise.
    noise
        Noise of the camera; None estimates it from the frames. Grey levels are those of the first exposure time.
    saturation
        Grey level from which a pixel counts as saturated; None takes the largest value of an integer type.
    minimum_modulation
        Modulation [grey level] that the surface has at least, and stray light has not.
    correct_harmonics
        Whether to correct the error that a nonlinear response causes, see `fit_harmonic_error`.
    lens_blur
        Standard deviation of the lens's point spread [camera px] to correct for; 0 corrects nothing.
    largest_error
        Error of the phase, RMS over the image [fringe], that flicker or motion along the light may cause. A larger one
        by the harmonics of the response is a remark. The default
        is half as much again as the noise of 8 shifts at one grey level (0.0021 fringe).
    largest_motion
        Motion across the image during the finest fringes [px] that is allowed.
    largest_misfit
        Variance of the residuals over that of the noise that a moving stack may have, see `demodulate_moving`.
    region
        Part of the image that shows the specimen; the checks use no other pixels. The phase is measured everywhere.

    Examples
    --------
    >>> PhaseSettings(noise=CameraNoise(read=1.0, shot=0.02), minimum_modulation=3.0).largest_motion
    0.2
    """

    method: Method = "auto"
    accept_relative: bool = False
    noise: CameraNoise | None = None
    saturation: float | None = None
    minimum_modulation: float = 0.0
    correct_harmonics: bool = False
    lens_blur: float = 0.0
    largest_error: float = 0.003
    largest_motion: float = 0.2
    largest_misfit: float = 2.0
    region: Region | None = None


DEFAULT_SETTINGS = PhaseSettings()
