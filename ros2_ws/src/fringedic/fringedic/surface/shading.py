"""Light on the relief of a surface, and the displacement that its change imitates.

A texture contains the light of the projector on every flank of a relief, E = cos(angle of incidence) / distance^2
(Lambert). When the surface tilts and stretches, one flank becomes brighter and the other darker, so that the feature
between them seems to move. The relief moves with the material: the tangents T of the reference surface become
T + grad(u, v, w) T, with a smooth gradient, and E after follows from the shape before. No difference of two
measured slopes is taken, whose noise would be as large as the effect.

With m = E after / E before, the estimator finds the displacement b between m f and the texture f itself, where there
is none. The images f and g of two steps then give d - b: b is added to what they give.

References
----------
J. H. Lambert (1760), Photometria.
"""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from numba import njit, prange
from scipy.ndimage import distance_transform_edt

from fringedic.correlation import Reference, measure_displacement
from fringedic.errors import CorrelationError
from fringedic.surface.coupling import couple
from fringedic.surface.noise_correlation import displacement_gains
from fringedic.surface.planes import fit_planes
from fringedic.surface.prepared import PreparedShape

SMALLEST_FILTER = 1.0  # of the height [px], below which the slopes of a relief are mostly noise
_SPACING = 8  # [px] of the points at which smooth fields are computed
_LAG = 4  # [px] of pixels whose light is compared: the size of a usual feature
_NEGLIGIBLE = 1e-4  # local change of the light that moves no feature by more than a twentieth of the noise
_TRIAL = 0.01  # noise of a trial over the standard deviation of the texture
_FEW = 20  # values from which a variance is known to 30 %: sqrt(2 / 20)
_VECTOR = ("displacement_x", "displacement_y")


class LitTexture:
    """The texture of a reference step on its relief.

    Parameters
    ----------
    shape
        The reference surface.
    texture
        Its mean over the fringe frames (row, column) [grey level]; NaN is not measured.
    light
        Position of the projector's pin-hole in the rig frame [m].
    field
        A displacement from this step: its points and window are those of the results.

    Raises
    ------
    CorrelationError
        The texture is constant or not measured.
    """

    def __init__(
        self, shape: PreparedShape, texture: np.ndarray, light: tuple[float, float, float], field: xr.Dataset
    ) -> None:
        self._shape, self._light = shape, np.array(light)
        self._texture = np.require(texture, np.float32, ["C", "W"])  # kernels are compiled for writable arrays
        self._method, self._spacing = str(field.attrs["method"]), int(field.attrs["spacing_px"])
        self._reference = Reference(texture, window=int(field.attrs["window_px"]), spacing=self._spacing)

    def without_shading(self, field: xr.Dataset, deformed: PreparedShape) -> xr.Dataset:
        """Return a displacement from this step without the part that the change of the shading imitates.

        Parameters
        ----------
        field
            Measured between the textures of this step and of another one.
        deformed
            The surface of the other step.

        Returns
        -------
        Dataset
            The field with other ``displacement_x`` and ``displacement_y``; the same field where the change of the light
            is negligible, or a shape is smoothed by less than `SMALLEST_FILTER`.
        """
        if self._shape.z_filter < SMALLEST_FILTER:
            return field
        lit = self._relit_texture(couple(self._shape, deformed, _decimate(field), z_filter=self._shape.z_filter))
        if lit is None or _local_change(lit / self._texture) < _NEGLIGIBLE:
            return field
        still = np.zeros((2, *field.displacement_x.shape), np.float32)
        try:
            seeming = measure_displacement(self._reference, lit, initial=tuple(still), method=self._method)
        except CorrelationError:  # fewer points are left than the estimator needs
            return field
        seeming = seeming.reindex_like(field)
        return field.assign({name: field[name] + seeming[name].fillna(0) for name in _VECTOR})

    def slope_noise(self, window: int) -> float:
        """Return the variance of the slopes of noise on this texture over that on a texture of uniform contrast.

        Between sparse features neighbouring points use the same ones, so that their errors are correlated over a longer
        distance than the window. Two copies of the texture with noise of their own are compared; what the slopes of
        their displacement have more than the predicted noise is the result.

        Parameters
        ----------
        window
            Of `surface_strain` [px].
        """
        random = np.random.default_rng(0)  # the same for every computation of a step
        noise = np.float32(_TRIAL * np.nanstd(self._texture))
        one, other = (self._texture + noise * random.standard_normal(self._texture.shape, np.float32) for _ in range(2))
        still = np.zeros((2, self._reference.rows.size, self._reference.columns.size), np.float32)
        try:
            found = measure_displacement(
                Reference(one, window=self._reference.window, spacing=self._spacing),
                other,
                initial=tuple(still),
                method=self._method,
            )
        except CorrelationError:
            return 1.0
        return _compare_slopes(_decimate(found), self._reference.window, self._method, window)

    def _relit_texture(self, cloud: xr.Dataset) -> np.ndarray | None:
        """Return the texture f / m, which lies at p + b for the texture f at p; None where the motion is not known."""
        if min(cloud.sizes.values()) < 3:
            return None
        planes = fit_planes(cloud, ("u", "v", "w"), 2 * self._reference.window + 1)
        motion = np.stack([cloud[name].values for name in "uvw"])
        smooth = np.concatenate([planes.slopes.reshape(6, *motion.shape[1:]), motion])
        known = np.isfinite(smooth).all(axis=0)
        if not known.any():
            return None
        nearest = tuple(distance_transform_edt(~known, return_distances=False, return_indices=True))
        step = float(cloud.row[1] - cloud.row[0])
        lit = np.empty_like(self._texture)
        _relight(
            self._shape.z,
            self._shape.rays,
            self._shape.camera_distance,
            self._light,
            np.ascontiguousarray(smooth[(slice(None), *nearest)]),
            step,
            self._texture,
            lit,
        )
        return lit


def _decimate(field: xr.Dataset) -> xr.Dataset:
    """Return a field at fewer points: smooth functions need no more."""
    every = slice(None, None, max(1, _SPACING // int(field.attrs["spacing_px"])))
    return field.isel(row=every, column=every)


def _local_change(ratio: np.ndarray) -> float:
    """Return the root mean square second difference of the ratio of the light between near pixels."""
    lines = (ratio[::_LAG], ratio[:, ::_LAG].T)
    changes = np.concatenate(
        [(each[:, 2 * _LAG :] - 2 * each[:, _LAG:-_LAG] + each[:, : -2 * _LAG]).ravel() for each in lines]
    )
    changes = changes[np.isfinite(changes)]
    return float(np.sqrt(np.mean(changes**2) / 6)) if changes.size else 0.0


def _compare_slopes(noise: xr.Dataset, window: int, method: str, strain_window: int) -> float:
    """Return the mean square of the slopes of a noise [px] over the predicted one; few values count as predicted."""
    row, column = (each.astype(np.float32) for each in np.meshgrid(noise.row, noise.column, indexing="ij"))
    over = noise.assign(x=(("row", "column"), column), y=(("row", "column"), row))
    planes = fit_planes(over, _VECTOR, strain_window, ("sigma_x", "sigma_y"))
    spacing = (round(planes.spacing[0]), round(planes.spacing[1]))
    gains = displacement_gains(window, method, planes.half, spacing)
    expected = planes.means[:, None] * gains[:, None, None] * planes.white[:2]
    ratio = planes.slopes**2 / expected
    known = np.isfinite(ratio)
    if not known.any():
        return 1.0
    length = max(planes.width_px) + window
    number = known.sum() * spacing[0] * spacing[1] / length**2
    return float((number * ratio[known].mean(dtype=float) + _FEW) / (number + _FEW))


@njit(nogil=True, error_model="numpy")
def _irradiance(along: np.ndarray, down: np.ndarray, away: np.ndarray) -> float:
    """Return E of a surface element with the tangents `along` and `down` rows of pixels, the light at `away` of it."""
    n_x = down[1] * along[2] - down[2] * along[1]
    n_y = down[2] * along[0] - down[0] * along[2]
    n_z = down[0] * along[1] - down[1] * along[0]
    distance2 = away[0] * away[0] + away[1] * away[1] + away[2] * away[2]
    cosine = n_x * away[0] + n_y * away[1] + n_z * away[2]
    return float(cosine / (math.sqrt(n_x * n_x + n_y * n_y + n_z * n_z) * distance2 * math.sqrt(distance2)))


@njit(nogil=True, error_model="numpy")
def _at_place(smooth: np.ndarray, row: float, column: float, out: np.ndarray) -> None:
    """Interpolate all channels of a coarse grid linearly; the outermost points reach to the edge of the image."""
    i = min(int(row), smooth.shape[1] - 2)
    j = min(int(column), smooth.shape[2] - 2)
    a, b = min(row - i, 1.0), min(column - j, 1.0)
    for k in range(out.size):
        upper = (1 - b) * smooth[k, i, j] + b * smooth[k, i, j + 1]
        lower = (1 - b) * smooth[k, i + 1, j] + b * smooth[k, i + 1, j + 1]
        out[k] = (1 - a) * upper + a * lower


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _relight(
    z: np.ndarray,
    rays: np.ndarray,
    h0: float,
    light: np.ndarray,
    smooth: np.ndarray,
    step: float,
    texture: np.ndarray,
    lit: np.ndarray,
) -> None:
    """Divide a texture by E after / E before; NaN where a slope is not known.

    `smooth` contains the derivatives of u, v, w by x and y and u, v, w themselves, every `step` pixels.
    """
    rows, columns = z.shape
    lit[:] = np.nan
    for r in prange(1, rows - 1):
        along, down, away = np.empty(3), np.empty(3), np.empty(3)
        moved_along, moved_down, here = np.empty(3), np.empty(3), np.empty(9)
        for c in range(1, columns - 1):
            right, left = float(z[r, c + 1]) - h0, float(z[r, c - 1]) - h0
            below, above = float(z[r + 1, c]) - h0, float(z[r - 1, c]) - h0
            along[2], down[2] = right - left, below - above
            depth = float(z[r, c]) - h0
            for k in range(2):
                along[k] = rays[k, r, c + 1] * right - rays[k, r, c - 1] * left
                down[k] = rays[k, r + 1, c] * below - rays[k, r - 1, c] * above
                away[k] = light[k] - rays[k, r, c] * depth
            away[2] = light[2] - float(z[r, c])
            before = _irradiance(along, down, away)
            _at_place(smooth, r / step, c / step, here)
            for k in range(3):
                moved_along[k] = along[k] + here[2 * k] * along[0] + here[2 * k + 1] * along[1]
                moved_down[k] = down[k] + here[2 * k] * down[0] + here[2 * k + 1] * down[1]
                away[k] -= here[6 + k]
            after = _irradiance(moved_along, moved_down, away)
            if before > 0 and after > 0:
                lit[r, c] = texture[r, c] * before / after
