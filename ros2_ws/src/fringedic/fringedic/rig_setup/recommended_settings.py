"""Recommended settings of the in-plane displacement, from a reference and two static images before a test.

The terms follow good practice for digital image correlation: what the images are (noise, feature size, gradient, use of
the grey levels), which subset and step size reach a requested noise or resolution, and the resulting noise floors.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import correlate1d

from fringedic.correlation import Reference, measure_displacement
from fringedic.correlation.images import SMALLEST_WINDOW
from fringedic.correlation.prepared import Prepared
from fringedic.correlation.texture_noise import FAINT, TextureNoise
from fringedic.correlation.transfer import shortest_period
from fringedic.errors import CorrelationError, ErrorCode, RigSetupError
from fringedic.evaluation.noise_floor import NoiseFloor, noise_floor
from fringedic.rig_setup.advice import Advice, SettingsWarning
from fringedic.rig_setup.settings_warnings import image_warnings, texture_warnings
from fringedic.rig_setup.static_images import StaticImages, describe_images
from fringedic.rig_setup.window_choice import FIRST_WINDOW, WindowRequest, choose_window
from fringedic.wording.arguments import check_arguments, number, optional, whole

STEPS_PER_SUBSET = 4  # a step size of a third to a half of the subset is usual; a quarter loses no information
TABLE_WINDOWS = (16, 24, 32, 48, 64, 96, 128)  # [px]

ROW, COLUMN = 1, 2  # axes of stacked fields
Image = NDArray[np.float64]


LARGEST_STRAIN_WINDOW = 1001  # [points], as in CouplingParameters


@dataclass(frozen=True)
class _Floors:
    """Noise floors of the displacement [px] as (x, y) and of the strain at one setting.

    `subset` is the width of the window in the image [px], `binning` the side of the blocks that were averaged [px].
    """

    subset: int
    binning: int
    spatial: tuple[float, float]
    predicted: tuple[float, float]
    temporal: tuple[float, float]
    bias: tuple[float, float]
    strain: tuple[float, float, float]


@check_arguments(
    RigSetupError,
    wanted_noise=optional(number()),
    wanted_period=optional(number()),
    strain_window=whole(high=LARGEST_STRAIN_WINDOW),
    pixel_size=optional(number()),
    full_scale=optional(number()),
)
def advise_settings(  # noqa: PLR0913 (options of a public function, all by keyword)
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
    """Recommend subset and step size, with the noise floors at these settings, from images of the specimen at rest.

    The noise of the displacement falls as ``1 / (window - 1)``, the shortest period that passes grows as
    ``window - 1``: one requirement determines the other.

    Parameters
    ----------
    reference, static_1, static_2
        Grey images (row, column) of the mounted specimen [grey level], one after the other and without any load; NaN
        where not measured.
    wanted_noise
        Requested standard deviation of the displacement [px]. The narrowest window that reaches it is recommended.
    wanted_period
        Requested period of the shortest displacement wave that keeps 90 % of its amplitude [px]. Without a requested
        noise, the widest window that keeps it is recommended; without either, a window of about five features.
    strain_window
        Width of the strain window in points, odd and at least 3.
    pixel_size
        Size of a pixel on the surface [m], for lengths in millimetres.
    full_scale
        Largest grey level of the camera; by default that of 8, 10, 12, 14 or 16 bits that holds all pixels, unknown
        for real numbers.
    mask
        Booleans (row, column), True where the surface is to be measured; all of it by default.

    Returns
    -------
    Advice
        Figures of the images, recommended settings and noise floors.

    Raises
    ------
    RigSetupError
        A request is not a positive number, or `strain_window` is not odd or smaller than 3.
    ImageError
        An image or the mask is invalid, or the sizes differ.
    CorrelationError
        The images do not show the same surface, its texture does not stand out from the noise, or the images are too
        small to be correlated.

    References
    ----------
    Jones and Iadicola (eds.), "A Good Practices Guide for Digital Image Correlation", International Digital Image
    Correlation Society (2018; edition 2: doi 10.58720/idics/gpg.ed2). Terms and noise floors follow it; conformity is
    not claimed.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy.ndimage import gaussian_filter
    >>> random = np.random.default_rng(1)
    >>> surface = 128 + 400 * gaussian_filter(random.normal(size=(120, 160)), 1.5)
    >>> images = [np.uint8(np.clip(surface + random.normal(0, 2, surface.shape), 0, 255)) for _ in range(3)]
    >>> advice = advise_settings(*images, wanted_noise=0.02)
    >>> bool(max(advice.noise) < 0.03), advice.full_scale
    (True, 255.0)
    """
    request = WindowRequest(wanted_noise, wanted_period)
    wanted = {"wanted_noise": request.noise, "wanted_period": request.period, "pixel_size": pixel_size}
    for name, value in wanted.items():
        if value is not None and not (math.isfinite(value) and value > 0):
            raise RigSetupError(f"{name} = {value}: it must be a positive number")
    if int(strain_window) != strain_window or strain_window < 3 or strain_window % 2 == 0:
        raise RigSetupError(f"strain_window = {strain_window} points: it must be an odd number of at least 3")
    images = StaticImages.checked(reference, static_1, static_2, mask)
    figures = describe_images(images, full_scale)

    limit = min(images.shape) // 2
    known, prepared = _measure_first(images, min(FIRST_WINDOW, limit), strain_window)
    noise_scale = (known.subset - 1) * max(known.predicted)
    subset, warnings = choose_window(
        request,
        noise_scale=noise_scale,
        feature_size=max(figures.feature_size),
        widest=limit,
        binning=known.binning,
    )
    window, spacing = subset // known.binning, _spacing(subset)
    floors = _noise_floors(images, _reference(images, window, spacing), strain_window)
    if floors.binning < known.binning:  # this window measures enough points without averaging, but is too narrow
        window = subset
        floors = _noise_floors(images, _reference(images, window, spacing), strain_window)
    advice = Advice(
        shape=images.shape,
        full_scale=figures.full_scale,
        quantisation=figures.quantisation,
        saturated=figures.saturated,
        dark=figures.dark,
        grey_range=figures.grey_range,
        coverage=figures.coverage,
        image_noise=figures.image_noise,
        contrast=figures.contrast,
        feature_size=figures.feature_size,
        mean_gradient=figures.mean_gradient,
        window=window,
        spacing=spacing,
        strain_window=int(strain_window),
        binning=floors.binning,
        period=shortest_period(floors.subset),
        noise=floors.spatial,
        noise_predicted=floors.predicted,
        noise_temporal=floors.temporal,
        bias=floors.bias,
        strain_noise=floors.strain,
        wanted_noise=None,
        wanted_period=None,
        pixel_size=None,
        table=(),
        warnings=(),
    )
    advice = replace(
        advice,
        wanted_noise=wanted_noise,
        wanted_period=wanted_period,
        pixel_size=pixel_size,
        table=tuple(
            (width, noise_scale / (width - 1), shortest_period(width))
            for width in TABLE_WINDOWS
            if SMALLEST_WINDOW * known.binning <= width <= limit
        ),
    )
    return replace(advice, warnings=(*warnings, *_warn_of_texture(prepared), *image_warnings(advice)))


def _spacing(window: int) -> int:
    return max(window // STEPS_PER_SUBSET, 1)


def _reference(images: StaticImages, window: int, spacing: int) -> Reference:
    return Reference(images.stored[0], window=window, spacing=spacing, mask=images.mask)


def _measure_first(images: StaticImages, window: int, strain_window: int) -> tuple[_Floors, Prepared]:
    """Measure with a window, or with a narrower one if too few of the averaged pixels of a faint texture remain."""
    reference = _reference(images, window, _spacing(window))
    try:
        return _noise_floors(images, reference, strain_window), reference.prepared
    except CorrelationError as error:
        faint = error.code is ErrorCode.NO_CORRELATION and TextureNoise.of(reference.prepared.levels[0]).ratio <= FAINT
        if not faint or window // 2 < SMALLEST_WINDOW:
            raise
    return _measure_first(images, window // 2, strain_window)


def _warn_of_texture(prepared: Prepared) -> list[SettingsWarning]:
    """Return warnings of a periodic texture, and of one that is faint where pixels are not averaged.

    The gradient energy alone does not tell a faint texture from a specimen before a plain background.
    """
    period = math.nan if prepared.lattice is None else prepared.lattice.shortest
    contrast = math.nan if prepared.binned() is None else TextureNoise.of(prepared.levels[0]).ratio
    return texture_warnings(period, contrast, FAINT)


def _noise_floors(images: StaticImages, reference: Reference, strain_window: int) -> _Floors:
    """Measure both static images against the reference."""
    results = [measure_displacement(reference, image) for image in images.stored[1:]]
    x, y = (
        _floor(
            f"displacement_{axis}",
            np.stack([field[f"displacement_{axis}"].values for field in results]),
            np.stack([field[f"sigma_{axis}"].values for field in results]),
        )
        for axis in "xy"
    )
    return _Floors(
        subset=max(field.attrs["window_px"] for field in results),
        binning=max(field.attrs.get("binning_px", 1) for field in results),
        spatial=(x.spatial, y.spatial),
        predicted=(x.predicted, y.predicted),
        temporal=(x.temporal, y.temporal),
        bias=(x.bias, y.bias),
        strain=strain_noise(results, reference.spacing, strain_window),
    )


def _floor(name: str, maps: np.ndarray, sigmas: np.ndarray) -> NoiseFloor:
    floor = noise_floor(name, maps, sigmas)
    if floor is None:
        raise CorrelationError(
            "the static images have no two points in common that were measured: do they show the same surface?",
            code=ErrorCode.NO_CORRELATION,
        )
    return floor


def strain_noise(fields: Sequence[xr.Dataset], spacing: int, points: int) -> tuple[float, float, float]:
    """Return the spatial standard deviations of the in-plane strains e_xx, e_yy, e_xy of images at rest.

    Parameters
    ----------
    fields
        Displacements of the images from `fringedic.measure_displacement`.
    spacing
        Distance of the points [px].
    points
        Width of the strain window in points, odd.

    Returns
    -------
    tuple of float
        Dimensionless; NaN where no strain window is complete.
    """
    x, y = (np.stack([each[f"displacement_{axis}"].values for each in fields]).astype(np.float64) for axis in "xy")
    if min(x.shape[1:]) < points:
        return math.nan, math.nan, math.nan
    shear = 0.5 * (_slope(x, ROW, spacing, points) + _slope(y, COLUMN, spacing, points))
    strains = (_slope(x, COLUMN, spacing, points), _slope(y, ROW, spacing, points), shear)
    floors = (noise_floor(name, strain) for name, strain in zip(("e_11", "e_22", "e_12"), strains, strict=True))
    xx, yy, xy = (math.nan if floor is None else floor.spatial for floor in floors)
    return xx, yy, xy


def _slope(fields: Image, along: int, spacing: int, points: int) -> Image:
    """Return slopes [1] of fields (image, row, column) [px] along an axis.

    They are those of least-squares planes over `points` x `points` points, NaN where one of these is not measured.
    """
    position = np.arange(points) - points // 2
    slope = position / (np.sum(position**2) * spacing)
    part = correlate1d(fields, slope, axis=along, mode="constant", cval=np.nan)
    return np.asarray(correlate1d(part, np.full(points, 1 / points), axis=3 - along, mode="constant", cval=np.nan))
