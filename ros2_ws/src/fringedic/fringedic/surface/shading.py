"""Light on the relief of a surface, and the displacement that its change imitates.

A texture contains the light of the projector on every flank of a relief, E = cos(angle of incidence) / distance^2
(Lambert). When the surface tilts and stretches, one flank becomes brighter and the other darker, so that the feature
between them seems to move. The relief moves with the material: the tangents T of the reference surface become
T + grad(u, v, w) T, with a smooth gradient, and E after follows from the shape before. No difference of two
measured slopes is taken, whose noise would be as large as the effect.

With m = E after / E before, the estimator finds the displacement b between m f and the texture f itself, where there
is none. The images f and g of two steps then give d - b: b is added to what they give.

The slopes (p, q) of the flanks are small and the motion is smooth, so that to second order, with smooth fields c of
each step, log m = c_1 p + c_2 q + c_3 p^2 + c_4 p q + c_5 q^2, besides a smooth part, which gain and offset of each
window follow. b is the sum of c_k B_k; B_k, the displacement that the estimator finds for c_k = 1, belongs to the
reference step and is measured once.

References
----------
J. H. Lambert (1760), Photometria.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

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
_MOTION_SPACING = 16  # [px] of the points at which the smooth motion is computed
_TRIAL_SPACING = 8  # [px] of the points of a trial
_LAG = 4  # [px] of pixels whose light is compared: the size of a usual feature
_NEGLIGIBLE = 1e-4  # local change of the light that moves no feature by more than a twentieth of the noise
_TRIAL = 0.01  # noise of a trial over the standard deviation of the texture, or its change of the light
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
    """

    def __init__(
        self, shape: PreparedShape, texture: np.ndarray, light: tuple[float, float, float], field: xr.Dataset
    ) -> None:
        self._shape, self._light, self._texture = shape, np.array(light), texture
        self._method, self._grid = str(field.attrs["method"]), field.displacement_x.shape
        self._window, self._spacing = int(field.attrs["window_px"]), int(field.attrs["spacing_px"])
        self._slopes = np.empty((2, *shape.z.shape), np.float32)
        _compute_slopes(shape.z, shape.rays, shape.camera_distance, self._slopes)
        slopes = self._slopes
        changes = []
        between = 4 * _LAG  # [px] of the lines: a sample is enough
        for lines in (slopes[:, ::between], slopes[:, :, ::between].swapaxes(1, 2)):
            products = np.stack(list(_multiply_slopes(lines)))
            second = products[..., 2 * _LAG :] - 2 * products[..., _LAG:-_LAG] + products[..., : -2 * _LAG]
            changes.append(second[:, np.isfinite(second).all(axis=0)].astype(float))
        change = np.concatenate(changes, axis=1)
        self._roughness = np.asarray(change @ change.T / (6 * max(change.shape[1], 1)))

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
        every = max(1, _MOTION_SPACING // self._spacing)
        some = field.isel(row=slice(None, None, every), column=slice(None, None, every))
        change = self._change(couple(self._shape, deformed, some, z_filter=self._shape.z_filter))
        if (
            change is None
            or float(np.sqrt(np.einsum("irc,ij,jrc", change, self._roughness, change, optimize=True) / change[0].size))
            < _NEGLIGIBLE
        ):
            return field
        moved = np.stack([field[name].values for name in _VECTOR])
        _add_responses(change, every, self._responses, moved)
        return field.assign({name: field[name].copy(data=each) for name, each in zip(_VECTOR, moved, strict=True)})

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
        try:
            found = self._measure(self._prepare(one, self._spacing * max(1, _TRIAL_SPACING // self._spacing)), other)
        except CorrelationError:  # fewer points are left than the estimator needs
            return 1.0
        row, column = (each.astype(np.float32) for each in np.meshgrid(found.row, found.column, indexing="ij"))
        over = found.assign(x=(("row", "column"), column), y=(("row", "column"), row))
        planes = fit_planes(over, _VECTOR, window, ("sigma_x", "sigma_y"))
        spacing = (round(planes.spacing[0]), round(planes.spacing[1]))
        gains = displacement_gains(self._window, self._method, planes.half, spacing)
        expected = planes.means[:, None] * gains[:, None, None] * planes.white[:2]
        ratio = planes.slopes**2 / expected
        known = np.isfinite(ratio)
        if not known.any():
            return 1.0
        length = max(planes.width_px) + self._window
        number = known.sum() * spacing[0] * spacing[1] / length**2
        return float((number * ratio[known].mean(dtype=float) + _FEW) / (number + _FEW))

    @cached_property
    def _responses(self) -> np.ndarray:
        """Displacement B_k (k, component, row, column) [px] for each of the products of slopes."""
        responses = np.zeros((len(self._roughness), 2, *self._grid), np.float32)
        reference = self._prepare(self._texture, self._spacing)
        for response, product in zip(responses, _multiply_slopes(self._slopes), strict=True):
            small = np.float32(_TRIAL / np.nanstd(product))
            try:
                seeming = self._measure(reference, self._texture * np.exp(-small * product))
            except CorrelationError:  # the light of too few pixels is known
                break
            response[:] = np.nan_to_num(np.stack([seeming[name].values for name in _VECTOR])) / small
        return responses

    def _prepare(self, texture: np.ndarray, spacing: int) -> Reference:
        return Reference(texture, window=self._window, spacing=spacing)

    def _measure(self, reference: Reference, other: np.ndarray) -> xr.Dataset:
        """Measure the displacement between two images of the texture at rest."""
        still = np.zeros((2, reference.rows.size, reference.columns.size), np.float32)
        return measure_displacement(reference, other, initial=tuple(still), method=self._method)

    def _change(self, cloud: xr.Dataset) -> np.ndarray | None:
        """Return the factors c_k (k, row, column) of a motion; None where it is not known."""
        if min(cloud.sizes.values()) < 3:
            return None
        z, *motion = fit_planes(cloud, ("z", "u", "v", "w"), 2 * self._window + 1).slopes
        place, moved = (np.stack([cloud[name].values for name in names]) for names in ("xyz", "uvw"))
        away = self._light[:, None, None] - place
        zero, one = np.zeros_like(z[0]), np.ones_like(z[0])
        along, down = np.stack([one, zero, z[0]]), np.stack([zero, one, z[1]])
        by_x, by_y = np.stack(motion, axis=1)
        before = _differentiate_light(along, down, away)
        (p, q, pp, pq, qq) = _differentiate_light(along + by_x, down + by_y, away - moved) - before
        change = np.stack([p - pp * z[0] - pq * z[1], q - pq * z[0] - qq * z[1], pp / 2, pq, qq / 2])
        known = np.isfinite(change).all(axis=0)
        if not known.any():
            return None
        nearest = tuple(distance_transform_edt(~known, return_distances=False, return_indices=True))
        return np.ascontiguousarray(change[(slice(None), *nearest)], np.float32)


def _differentiate_light(along: np.ndarray, down: np.ndarray, away: np.ndarray) -> np.ndarray:
    """Return the derivatives of log E = log(n . away) - log(n . n)/2 by the slopes p, q, by p^2, p q and q^2.

    `along` and `down` are tangents (3, row, column) of a surface, whose third components grow by p and q; n is their
    vector product, linear in p and q, and `away` the way to the light.
    """
    up = np.array([0.0, 0.0, 1.0])[:, None, None]
    normal, by_p, by_q = (np.cross(*each, axis=0) for each in ((along, down), (up, down), (along, up)))

    def product(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("irc,irc->rc", one, other))

    lit, length = product(normal, away), product(normal, normal)
    light = [product(each, away) / lit for each in (by_p, by_q)]
    size = [product(each, normal) / length for each in (by_p, by_q)]
    second = [
        2 * size[i] * size[j] - light[i] * light[j] - product(one, other) / length
        for i, j, one, other in ((0, 0, by_p, by_p), (0, 1, by_p, by_q), (1, 1, by_q, by_q))
    ]
    return np.stack([light[0] - size[0], light[1] - size[1], *second])


def _multiply_slopes(slopes: np.ndarray) -> Iterator[np.ndarray]:
    """Yield p, q, p^2, p q and q^2 of slopes (2, ...)."""
    p, q = slopes
    yield from (p, q)
    yield p * p
    yield p * q
    yield q * q


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _compute_slopes(z: np.ndarray, rays: np.ndarray, h0: float, slopes: np.ndarray) -> None:
    """Compute dz/dx and dz/dy (2, row, column) at each pixel from its neighbours; NaN where one is not measured."""
    rows, columns = z.shape
    slopes[:] = np.nan
    for r in prange(1, rows - 1):
        for c in range(1, columns - 1):
            right, left = float(z[r, c + 1]) - h0, float(z[r, c - 1]) - h0
            below, above = float(z[r + 1, c]) - h0, float(z[r - 1, c]) - h0
            along_x = rays[0, r, c + 1] * right - rays[0, r, c - 1] * left
            along_y = rays[1, r, c + 1] * right - rays[1, r, c - 1] * left
            down_x = rays[0, r + 1, c] * below - rays[0, r - 1, c] * above
            down_y = rays[1, r + 1, c] * below - rays[1, r - 1, c] * above
            area = along_x * down_y - along_y * down_x
            slopes[0, r, c] = (down_y * (right - left) - along_y * (below - above)) / area
            slopes[1, r, c] = (along_x * (below - above) - down_x * (right - left)) / area


@njit(cache=True, nogil=True, parallel=True, error_model="numpy")
def _add_responses(change: np.ndarray, every: int, responses: np.ndarray, moved: np.ndarray) -> None:
    """Add the responses (k, component, row, column), each times its factor, to a displacement.

    `change` (k, row, column), at every `every`-th point, is interpolated linearly; its outermost values are repeated.
    """
    _, rows, columns = moved.shape
    last_row, last_column = change.shape[1] - 2, change.shape[2] - 2
    for r in prange(rows):
        i = min(r // every, last_row)
        a = np.float32(min(r / every - i, 1.0))
        line = (np.float32(1) - a) * change[:, i] + a * change[:, i + 1]
        for k in range(len(change)):
            for c in range(columns):
                j = min(c // every, last_column)
                b = np.float32(min(c / every - j, 1.0))
                factor = (np.float32(1) - b) * line[k, j] + b * line[k, j + 1]
                moved[0, r, c] += factor * responses[k, 0, r, c]
                moved[1, r, c] += factor * responses[k, 1, r, c]
