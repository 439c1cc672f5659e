"""Choosing the settings of the in-plane displacement before a test, from a reference and two static images.

Reports, in the words of good practice for image correlation, what the images are (noise, feature size, gradient, use of
the grey levels), which subset and step reach a wanted resolution, and the noise floors that then hold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import correlate1d

from fringedic.advice_report import report
from fringedic.correlation import Reference, measure_displacement
from fringedic.correlation.dense import NARROWER, ORDER, window_of
from fringedic.correlation.images import SMALLEST_WINDOW, checked_image, checked_mask
from fringedic.errors import AdviceError, ShapeMismatchError
from fringedic.image_quality import full_scale_of, image_noise, mean_gradient, texture

KEPT = 0.9  # of the amplitude of the shortest displacement wave that counts as resolved
FIRST_WINDOW = 32  # [px], what the noise is measured with before a window is recommended
WIDEST_WINDOW = 256
FEWEST_FEATURES, USUAL_FEATURES = 3, 5  # per subset
STEPS_PER_SUBSET = 4
TABLE_WINDOWS = (16, 24, 32, 48, 64, 96, 128)

Image = NDArray[np.float64]


@dataclass(frozen=True)
class Advice:
    """What the images are, the settings recommended for them, and the noise floors at these settings.

    Pairs are (along columns, along rows). Displacements are in pixels, strains dimensionless, grey levels as stored.

    Attributes
    ----------
    shape
        Rows and columns of the images.
    full_scale, quantisation
        Largest grey level that the camera can deliver and the step between grey levels; NaN where not known.
    saturated, dark
        Share of the pixels at the full scale (NaN where it is not known) and at zero.
    grey_range
        Grey levels under which 1 % and 99 % of the pixels lie.
    coverage
        Share of the pixels darker than the middle between dark and bright.
    image_noise
        Standard deviation of a pixel's noise between two exposures.
    contrast
        Standard deviation of the texture, without noise.
    feature_size
        Full width at half height of the texture's autocorrelation [px].
    mean_gradient
        Mean magnitude of the intensity gradient [grey level / px].
    window, spacing, strain_window
        Recommended subset [px] and step [px], and the width of the strain window in points.
    period
        Shortest period of a displacement wave that keeps 90 % of its amplitude [px].
    noise, noise_predicted, noise_temporal, bias
        Displacement noise floor at these settings: spatial standard deviation (averaged over both static images), the
        one that the stated uncertainty predicts, standard deviation over time (averaged over the points), and mean.
    strain_noise
        Spatial standard deviation of e_xx, e_yy and the tensor shear e_xy of the in-plane displacement.
    pixel_size
        Size of a pixel on the surface [m], or None.
    table
        Expected noise [px] and period [px] of other windows [px]: (window, noise, period).
    warnings
        What should be put right before the test.
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
    period: float
    noise: tuple[float, float]
    noise_predicted: tuple[float, float]
    noise_temporal: tuple[float, float]
    bias: tuple[float, float]
    strain_noise: tuple[float, float, float]
    pixel_size: float | None
    table: tuple[tuple[int, float, float], ...]
    warnings: tuple[str, ...]

    @property
    def gauge_length(self) -> float:
        """Virtual strain gauge L_VSG = (L_window - 1) L_step + L_subset [px]."""
        return (self.strain_window - 1) * self.spacing + self.window

    def report(self) -> str:
        """The advice as text for people."""
        return report(self)


def advise_settings(
    reference: ArrayLike,
    static_1: ArrayLike,
    static_2: ArrayLike,
    *,
    wanted_noise: float | None = None,
    wanted_period: float | None = None,
    strain_window: int = 5,
    pixel_size: float | None = None,
    full_scale: float | None = None,
    mask: ArrayLike | None = None,
) -> Advice:
    """Recommend subset and step, and tell the noise floors, from three images of the specimen at rest.

    The noise of the displacement falls as 1 / (window - 1), the shortest period that passes grows as window - 1:
    what is wanted of one decides about the other.

    Parameters
    ----------
    reference, static_1, static_2
        Grey images (row, column) of the mounted specimen, one after the other and without any load; NaN where not
        measured.
    wanted_noise
        Standard deviation of the displacement that is wanted [px]. The narrowest window that reaches it is recommended.
    wanted_period
        Period of the shortest displacement wave that must keep 90 % of its amplitude [px]. Without a wanted noise the
        widest window that keeps it is recommended. Without either, one of about five features.
    strain_window
        Width of the strain window in points.
    pixel_size
        Size of a pixel on the surface [m], for lengths in millimetres.
    full_scale
        Largest grey level of the camera; by default that of 8, 10, 12, 14 or 16 bits that holds all pixels, not known
        for real numbers.
    mask
        Booleans (row, column), True where the surface is to be measured; all of it by default.

    Returns
    -------
    Advice

    Raises
    ------
    AdviceError
        A wish has no meaning.
    ShapeMismatchError, ColourImageError, ImageTypeError, ImageSizeError, TexturelessImageError, EmptyMaskError
        The images cannot be measured, see `measure_displacement`.
    NoCorrelationError
        The images do not show the same surface.

    References
    ----------
    The terms follow what is known of the Good Practices Guide for Digital Image Correlation of the International
    Digital Image Correlation Society, edition 2, doi 10.58720/idics/gpg.ed2; conformity is not claimed.
    """
    for name, value in (("wanted_noise", wanted_noise), ("wanted_period", wanted_period), ("pixel_size", pixel_size)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise AdviceError(f"{name} = {value}: it must be a positive number")
    if int(strain_window) != strain_window or strain_window < 3 or strain_window % 2 == 0:
        raise AdviceError(f"strain_window = {strain_window} points: it must be an odd number of at least 3")
    stored = [
        checked_image(image, name)
        for image, name in ((reference, "reference"), (static_1, "first static"), (static_2, "second static"))
    ]
    shape = (stored[0].shape[0], stored[0].shape[1])
    for image, name in zip(stored[1:], ("first", "second"), strict=True):
        if image.shape != shape:
            raise ShapeMismatchError(
                f"the {name} static image has the shape {image.shape}, the reference {shape}: they must be equal"
            )
    allowed = checked_mask(mask, shape)
    seen = np.isfinite(stored[0]) & np.isfinite(stored[1]) & np.isfinite(stored[2])
    if allowed is not None:
        seen &= allowed

    largest = full_scale_of(stored) if full_scale is None else float(full_scale)
    step = _quantisation(stored[0][seen])
    grey = stored[0][seen]
    low, high = (float(value) for value in np.percentile(grey, (1, 99)))
    images = [np.where(seen, image, 0).astype(np.float64) for image in stored]
    noise = image_noise(images[1], images[2], seen)
    feature_size, contrast = texture(images[1], images[2], seen)

    limit = min(shape) // 2
    first = min(FIRST_WINDOW, limit)
    known = _noise_floor(stored, first, max(first // STEPS_PER_SUBSET, 1), strain_window, allowed)
    scale = (first - 1) * max(known.predicted)  # the noise times (window - 1)
    window, warnings = _window(scale, max(feature_size), limit, wanted_noise, wanted_period)
    spacing = max(window // STEPS_PER_SUBSET, 1)
    floor = _noise_floor(stored, window, spacing, strain_window, allowed)

    advice = Advice(
        shape=shape,
        full_scale=largest,
        quantisation=step,
        saturated=math.nan if math.isnan(largest) else float(np.mean(grey > largest - (step if step > 0 else 0.5))),
        dark=float(np.mean(grey <= 0)),
        grey_range=(low, high),
        coverage=float(np.mean(grey < 0.5 * (low + high))),
        image_noise=noise,
        contrast=contrast,
        feature_size=feature_size,
        mean_gradient=mean_gradient(np.mean(images, axis=0), seen),
        window=window,
        spacing=spacing,
        strain_window=int(strain_window),
        period=shortest_period(window),
        noise=floor.spatial,
        noise_predicted=floor.predicted,
        noise_temporal=floor.temporal,
        bias=floor.bias,
        strain_noise=floor.strain,
        pixel_size=pixel_size,
        table=tuple((w, scale / (w - 1), shortest_period(w)) for w in TABLE_WINDOWS if w <= limit),
        warnings=(),
    )
    return replace(advice, warnings=(*warnings, *_warnings(advice)))


def shortest_period(window: int) -> float:
    """Period [px] of the displacement wave that keeps 90 % of its amplitude in a window [px] of the dense method.

    The transfer of that method is h / (h + (1 - h) (1 - v)^ORDER) with Gaussians h = exp(-q^2) of standard deviation s
    and v = exp(-(NARROWER q)^2), q = sqrt(2) pi s / period. As s grows with window - 1, so does the period.
    """
    q2 = np.linspace(1e-3, 10, 100_000)
    h, v = np.exp(-q2), np.exp(-q2 * NARROWER**2)
    passed = h / (h + (1 - h) * (1 - v) ** ORDER)
    q = math.sqrt(q2[np.argmax(passed < KEPT)])
    return math.sqrt(2) * math.pi * window_of(window).deviation / q


def _quantisation(grey: np.ndarray) -> float:
    """Step between grey levels of integers, as 16 for 12 bits in the upper part of 16; NaN for real numbers."""
    if not np.issubdtype(grey.dtype, np.integer):
        return math.nan
    levels = np.unique(grey)
    return float(np.gcd.reduce(np.diff(levels))) if levels.size > 1 else math.nan


@dataclass(frozen=True)
class _Floor:
    """Noise floors of the displacement [px] (along columns, along rows) and of the strain at one setting."""

    spatial: tuple[float, float]
    predicted: tuple[float, float]
    temporal: tuple[float, float]
    bias: tuple[float, float]
    strain: tuple[float, float, float]


def _noise_floor(
    images: list[np.ndarray], window: int, spacing: int, strain_window: int, mask: np.ndarray | None
) -> _Floor:
    """Measure both static images against the reference, which all of them share.

    The standard deviation over time is that of the two fields, without the reference's own noise.
    """
    prepared = Reference(images[0], window=window, spacing=spacing, mask=mask)
    results = [measure_displacement(prepared, image) for image in images[1:]]
    fields = np.stack([np.stack([one.displacement_x, one.displacement_y]) for one in results]).astype(np.float64)
    sigmas = np.stack([np.stack([one.sigma_x, one.sigma_y]) for one in results]).astype(np.float64)
    axes = (2, 3)
    change = fields[1] - fields[0]
    slopes = strain_noise(fields, spacing, strain_window)
    return _Floor(
        spatial=_pair(np.sqrt(np.mean(np.nanvar(fields, axis=axes), axis=0))),
        predicted=_pair(np.sqrt(np.mean(np.nanmean(sigmas**2, axis=axes), axis=0))),
        temporal=_pair(np.sqrt(np.nanmean(change**2, axis=(1, 2)) / 2)),
        bias=_pair(np.mean(np.nanmean(fields, axis=axes), axis=0)),
        strain=slopes,
    )


def _pair(values: Image) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def strain_noise(fields: Image, spacing: int, points: int) -> tuple[float, float, float]:
    """Spatial standard deviations of e_xx, e_yy, e_xy of fields (image, component, row, column) [px].

    The points are `spacing` pixels apart. The slopes are those of least-squares planes over `points` x `points` points
    that are all measured.
    """
    position = np.arange(points) - points // 2
    slope = position / (np.sum(position**2) * spacing)
    mean = np.full(points, 1 / points)
    if min(fields.shape[2:]) < points:
        return math.nan, math.nan, math.nan

    def derivative(component: int, along: int) -> Image:
        part = correlate1d(fields[:, component], slope, axis=along, mode="constant", cval=np.nan)
        return correlate1d(part, mean, axis=3 - along, mode="constant", cval=np.nan)

    shear = 0.5 * (derivative(0, 1) + derivative(1, 2))
    strains = (derivative(0, 2), derivative(1, 1), shear)
    if not all(np.isfinite(strain).any() for strain in strains):
        return math.nan, math.nan, math.nan
    xx, yy, xy = (float(np.sqrt(np.mean(np.nanvar(strain, axis=(1, 2))))) for strain in strains)
    return xx, yy, xy


def _window(
    scale: float, feature: float, limit: int, wanted_noise: float | None, wanted_period: float | None
) -> tuple[int, list[str]]:
    """Recommended window [px] and what of the wishes it does not fulfil; the noise is scale / (window - 1)."""
    warnings = []
    slope = shortest_period(FIRST_WINDOW) / (FIRST_WINDOW - 1)
    fewest = max(SMALLEST_WINDOW, math.ceil(FEWEST_FEATURES * feature) if math.isfinite(feature) else SMALLEST_WINDOW)
    usual = max(fewest, 2 * SMALLEST_WINDOW, math.ceil(USUAL_FEATURES * feature) if math.isfinite(feature) else 0)
    widest = min(limit, WIDEST_WINDOW)
    if wanted_noise is not None:
        wanted = 1 + math.ceil(scale / wanted_noise)
    elif wanted_period is not None:
        wanted = 1 + math.floor(wanted_period / slope)
    else:
        wanted = usual
    window = min(max(wanted, fewest), widest)
    if wanted > widest and wanted_noise is not None:
        warnings.append(
            f"a noise of {wanted_noise:g} px needs a subset of {wanted} px, more than these images allow: "
            f"{scale / (window - 1):.2g} px are to be expected; average several images or light the surface better"
        )
    if wanted_period is not None and slope * (window - 1) > wanted_period * (1 + 1e-9):
        reached = scale * slope / wanted_period
        reason = f"fewer than {FEWEST_FEATURES} features would be left in the subset"
        if wanted_noise is not None and wanted > fewest:
            reason = f"it would have a noise of {reached:.2g} px, and {wanted_noise:g} px are wanted"
        warnings.append(
            f"waves of {wanted_period:g} px lose more than 10 %: the subset for them is too narrow, as {reason}"
        )
    return window, warnings


def _warnings(advice: Advice) -> list[str]:
    """What good practice finds wrong with the images."""
    found = []
    feature = math.sqrt(advice.feature_size[0] * advice.feature_size[1])
    if feature < 3:
        found.append(f"features of {feature:.1f} px are small: with less than 3 px they alias; defocus or go closer")
    elif feature > 7:
        found.append(f"features of {feature:.1f} px are large: 3 to 5 px give less noise in the same subset")
    if advice.saturated > 0.005:
        found.append(f"{100 * advice.saturated:.1f} % of the pixels are saturated: expose less, or dim the reflections")
    if advice.dark > 0.01:
        found.append(f"{100 * advice.dark:.1f} % of the pixels are black: raise the camera's black level or the light")
    if math.isfinite(advice.full_scale) and advice.grey_range[1] < 0.5 * advice.full_scale:
        share = 100 * advice.grey_range[1] / advice.full_scale
        found.append(f"the brightest pixels reach {share:.0f} % of the range: more light lowers the noise")
    measured, predicted = max(advice.noise), max(advice.noise_predicted)
    if advice.image_noise < 0.5 * advice.quantisation:
        found.append(
            f"the noise of {advice.image_noise:.2g} grey levels is under half a grey level: static images repeat what "
            "quantisation does, and the errors of a test are larger than the noise floor"
        )
    elif measured > 1.25 * predicted:
        found.append(
            f"the displacement scatters by {measured:.2g} px where image noise explains {predicted:.2g} px: look for "
            "vibration, warm air, a moving lens or flicker"
        )
    moved = math.hypot(*advice.bias)
    if moved > 5 * max(measured, 0.002):
        found.append(f"the specimen or the camera has moved by {moved:.2g} px: the images are not static")
    return found
