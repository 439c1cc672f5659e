"""Predicted standard uncertainties on a small part of a planned surface, by the formulas of the measurement.

Light, texture and noise of the patch follow from the components. The noise of the phase is sqrt(2/N) sigma_I / B; from
there on the library's own functions propagate it: `RigModel.reconstruct`, `measure_displacement` (which states its
uncertainty for two simulated images of the patch), `couple` and `surface_strain`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import xarray as xr
from scipy.ndimage import gaussian_filter

from fringedic.correlation import measure_displacement
from fringedic.frames.noise import CameraNoise
from fringedic.phase.demodulation_kernel import CONFIDENCE
from fringedic.phase.noise import phase_deviation
from fringedic.planning.planned_rig import PlannedRig
from fringedic.surface import PreparedShape, couple, surface_strain
from fringedic.virtual_rig.texture import make_texture, reflectance_at

QUANTITIES = ("x", "y", "z", "u", "v", "w", "e_11", "e_22", "e_12")
_SMALLEST_PATCH = 128  # [px]
_SHIFT = 0.25  # [px] interpolation at a quarter of a pixel passes the noise that it passes on average


@dataclass(frozen=True, eq=False)
class PatchUncertainty:
    """Root mean square standard uncertainties over a patch.

    Attributes
    ----------
    sigma
        By `QUANTITIES` [m], strains dimensionless; NaN where nothing is measured.
    phase
        Of the phase at the finest pitch [rad].
    in_plane
        Of the in-plane displacement (x, y) [px].
    level, modulation
        Mean grey level and mean modulation of the finest pitch.
    measured
        Part of the patch where the phase is valid, 0 to 1.
    """

    sigma: dict[str, float]
    phase: float
    in_plane: tuple[float, float]
    level: float
    modulation: float
    measured: float


def patch_width(planned: PlannedRig) -> int:
    """Return the width of the part of a patch whose windows are whole [px]."""
    window, strain_window = planned.dic.window, planned.coupling.strain_window_px
    return max(_SMALLEST_PATCH, 2 * window, 2 * strain_window - 2 * window)


@dataclass(frozen=True)
class NoiseFactors:
    """Factors of the variances of the sources of noise; 1 is the noise of the planned rig."""

    phase_photon: float = 1.0
    phase_read: float = 1.0
    texture_photon: float = 1.0
    texture_read: float = 1.0


@dataclass(frozen=True, eq=False)
class Patch:
    """A small part of the planned surface: its light, and the uncertainty of its in-plane displacement.

    Attributes
    ----------
    planned
        The rig.
    column, row
        Pixel positions of the patch, shape (n,) each.
    level
        Mean of the fringe frames [grey level], (n, n).
    modulations
        Modulation of every pitch [grey level], coarse to fine, (pitch, n, n).
    in_plane
        Displacement of two simulated textures of the patch, with its stated uncertainty.
    seed
        Of texture and noise.
    """

    planned: PlannedRig
    column: np.ndarray
    row: np.ndarray
    level: np.ndarray
    modulations: np.ndarray
    in_plane: xr.Dataset
    seed: int

    @classmethod
    def at(cls, planned: PlannedRig, column: float, row: float) -> Patch:
        """Return the patch around a pixel; it may reach beyond the image."""
        size = patch_width(planned) + 2 * planned.dic.window
        columns, rows = (np.round(centre) + np.arange(size) - size // 2 for centre in (column, row))
        seed = int((columns[0] + 10_000 * rows[0]) % 2**32)  # every patch has a texture of its own
        level, modulations = _light(planned, columns, rows, 0.0, seed)
        moved, _ = _light(planned, columns, rows, _SHIFT, seed)
        levels = (level, moved)
        random = np.random.default_rng(seed)
        frames = sum(planned.layout.counts)
        textures = [level + random.normal(0.0, np.sqrt(planned.noise.variance(level) / frames)) for level in levels]
        dic = planned.dic
        return cls(
            planned,
            columns,
            rows,
            level,
            modulations,
            measure_displacement(*textures, window=dic.window, spacing=dic.spacing, method=dic.method),
            seed,
        )

    def uncertainty(self, factors: NoiseFactors = NoiseFactors()) -> PatchUncertainty:
        """Return the uncertainties with these factors of the noise."""
        planned, layout = self.planned, self.planned.layout
        noise = planned.noise
        phase_noise = CameraNoise(noise.read * math.sqrt(factors.phase_read), noise.shot * factors.phase_photon)
        sigmas = [
            phase_deviation(np.sqrt(phase_noise.variance(self.level)), modulation, frames)
            for modulation, frames in zip(self.modulations, layout.counts, strict=True)
        ]
        random = np.random.default_rng(self.seed)
        # a measured modulation scatters as much as the phase does
        scattered = [np.abs(sigma / (1 + sigma * random.standard_normal(sigma.shape))) for sigma in sigmas]
        valid = np.all([CONFIDENCE * sigma < 1 for sigma in scattered], axis=0)
        for coarse, fine, ratio in zip(
            scattered, scattered[1:], [coarse / fine for coarse, fine in pairwise(layout.pitches)], strict=False
        ):
            valid &= CONFIDENCE * np.hypot(coarse * ratio, fine) < np.pi
        valid = np.asarray(valid)
        sigma = np.where(valid, sigmas[-1], np.nan)
        shape = self._shape(sigma, random.standard_normal(sigma.shape))
        noise = self.planned.noise
        photon, read = noise.shot * float(self.level.mean()), noise.read**2
        factor = math.sqrt((factors.texture_photon * photon + factors.texture_read * read) / (photon + read))
        field = self.in_plane
        still = {name: np.full(field[name].shape, _SHIFT) for name in ("displacement_x", "displacement_y")}
        scaled = {name: factor * field[name].to_numpy() for name in ("sigma_x", "sigma_y")}
        arrays = {name: (("row", "column"), values) for name, values in (still | scaled).items()}
        coordinates = {"row": self.row[0] + field["row"], "column": self.column[0] + field["column"]}
        displacement = xr.Dataset(arrays, coordinates, field.attrs)
        prepared = PreparedShape(shape, z_filter=planned.coupling.z_filter_px)
        cloud = couple(prepared, prepared, displacement, z_filter=planned.coupling.z_filter_px)
        window, cut = planned.dic.window, math.ceil(planned.dic.window / planned.dic.spacing)
        found = {name: _rms(shape[f"sigma_{name}"].to_numpy(), window) for name in "xyz"}
        found |= {name: _rms(cloud[f"sigma_{name}"].to_numpy(), cut) for name in "uvw"}
        window = planned.coupling.strain_window_px
        found |= dict.fromkeys(QUANTITIES[6:], math.nan)
        if window:
            strain = surface_strain(cloud, window=window)
            margin = math.ceil(window / 2 / planned.dic.spacing)
            found |= {name: _rms(strain[f"sigma_{name}"].to_numpy(), margin) for name in QUANTITIES[6:]}
        return PatchUncertainty(
            sigma=found,
            phase=_rms(sigma),
            in_plane=(_rms(displacement["sigma_x"].to_numpy(), cut), _rms(displacement["sigma_y"].to_numpy(), cut)),
            level=float(self.level.mean()),
            modulation=float(self.modulations[-1].mean()),
            measured=float(valid.mean()),
        )

    def _shape(self, sigma: np.ndarray, noise: np.ndarray) -> xr.Dataset:
        """Return the reference plane, reconstructed from a phase with this noise in units of its sigma.

        Noise and holes matter to the filter of z, which ends at what it takes for a discontinuity.
        """
        planned, pitch = self.planned, self.planned.layout.pitches[-1]
        column, row = np.meshgrid(self.column, self.row)
        x, y, z = planned.points(column, row)
        phase = planned.model.phase(x, y, z, pitch, planned.orientation)
        image = xr.DataArray(
            (phase + sigma * noise).astype(np.float32),  # as `absolute_phase`
            dims=("row", "column"),
            coords={"row": self.row, "column": self.column},
        )
        return planned.model.reconstruct(image, pitch, image.copy(data=sigma.astype(np.float32)), planned.orientation)


def _light(
    planned: PlannedRig, columns: np.ndarray, rows: np.ndarray, shift: float, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and modulations [grey level] on a patch; `shift` [px] moves its texture to the right and down."""
    column, row = np.meshgrid(columns, rows)
    points = planned.points(column, row)
    moved = planned.points(column - shift, row - shift)
    sensor, texture = planned.configuration.sensor, planned.configuration.texture
    margin = 4e-6 * texture.feature_um
    outline = np.array([part for axis in points[:2] for part in (axis.min() - margin, axis.max() + margin)])
    strokes = make_texture(texture, outline, seed)
    surface = reflectance_at(strokes, texture.floor, *(np.ascontiguousarray(axis) for axis in moved[:2]))
    white = planned.full_scale * sensor.white_level * surface
    irradiance, blur = planned.irradiance(points), planned.projector_blur(points)
    lights = [planned.modulation(pitch, blur) for pitch in planned.layout.pitches]
    level = white * (sensor.ambient_light + irradiance * lights[0][0])
    modulations = np.stack([white * irradiance * amplitude for _, amplitude in lights])
    if sensor.lens_blur_px > 0.0:
        level = gaussian_filter(level, sensor.lens_blur_px)
        modulations = gaussian_filter(modulations, (0, sensor.lens_blur_px, sensor.lens_blur_px))
    return level, modulations


def _rms(values: np.ndarray, margin: int = 0) -> float:
    """Return the root mean square over a map without a margin of so many points on all sides."""
    inner = values[margin : len(values) - margin, margin : values.shape[1] - margin]
    known = inner[np.isfinite(inner)]
    return float(np.sqrt(np.mean(known.astype(float) ** 2))) if known.size else math.nan
