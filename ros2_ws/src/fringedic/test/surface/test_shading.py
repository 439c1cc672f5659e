"""Light on a relief that turns with its surface, against the exact motion of the virtual rig."""

from functools import cached_property

import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import gaussian_filter

from fringedic.correlation import measure_displacement
from fringedic.rig.model import RigModel
from fringedic.surface import PreparedShape
from fringedic.surface.shading import LitTexture
from fringedic.virtual_rig import VirtualRig
from fringedic.virtual_rig.configuration import VirtualRigConfiguration

INNER = np.s_[24:-24, 24:-24]


def shape_of(rig: RigModel, z: np.ndarray) -> xr.Dataset:
    """Return the shape whose height at every pixel is known."""
    column, row = np.meshgrid(np.arange(z.shape[1]), np.arange(z.shape[0]))
    rays = np.stack([column, row, np.ones_like(row)], axis=-1) @ rig.ray_matrix.T
    along = (z - rig.camera_distance) / rays[..., 2]
    fields = {"x": along * rays[..., 0], "y": along * rays[..., 1], "z": z, "noise_z": np.full_like(z, 1e-8)}
    return xr.Dataset({name: (("row", "column"), each) for name, each in fields.items()})


class Skin:
    """Two steps of the skin, seen without noise: textures, shapes, and the displacement that is measured."""

    def __init__(self, relief_um: float) -> None:
        sensor = {"bits": 16, "read_noise_grey_level": 0.0, "shot_noise_grey_level": 0.0}
        entries = {"preset": "skin", "size": "small", "seed": 31, "sensor": sensor}
        specimen = {"kind": "skin", "relief_um": relief_um}
        twin = VirtualRig(VirtualRigConfiguration.from_dict({**entries, "specimen": specimen}))
        position = 0.3 * twin.maximum_position
        white = np.full(twin.projector_shape, 255, np.uint8)
        self.rig = RigModel(**twin.optics())
        self.textures = [twin.expose(white, each, 0).astype(np.float32) for each in (0.0, position)]
        self.truth = twin.truth(position)
        heights = (self.truth.z.values, self.truth.z_deformed.values)
        self.shapes = [PreparedShape(shape_of(self.rig, z), z_filter=2.0, calibration=self.rig) for z in heights]
        self.field = measure_displacement(*self.textures, window=24)

    def error(self, field: xr.Dataset) -> float:
        error = field.displacement_y.values - self.truth.displacement_y.values
        return float(np.nanstd(error[INNER]))

    @cached_property
    def lit(self) -> LitTexture:
        return LitTexture(self.shapes[0], self.textures[0], self.rig.projector_position, self.field)

    def corrected(self) -> xr.Dataset:
        return self.lit.without_shading(self.field, self.shapes[1])


@pytest.fixture(scope="module")
def skins() -> tuple[Skin, Skin]:
    """The same skin without relief, and with furrows of the slopes that those of the full size have."""
    return Skin(0.0), Skin(60.0)


def test_the_shift_of_furrows_whose_flanks_turn_is_taken_out(skins: tuple[Skin, Skin]) -> None:
    flat, relief = skins
    without = flat.error(flat.field) ** 2  # of the curvature inside the windows
    before, after = (relief.error(field) ** 2 - without for field in (relief.field, relief.corrected()))
    assert before > without, "the light on the relief is the larger part of the error"
    assert after < 0.3 * before


def test_a_surface_without_relief_keeps_its_displacement(skins: tuple[Skin, Skin]) -> None:
    assert skins[0].corrected() is skins[0].field


def test_a_step_is_corrected_alike_however_many_were_before(skins: tuple[Skin, Skin]) -> None:
    skin = skins[1]
    measured = skin.field.copy(deep=True)
    first = skin.corrected()
    half = skin.field.assign(displacement_y=skin.field.displacement_y / 2)
    assert not skin.lit.without_shading(half, skin.shapes[1]).equals(first)
    xr.testing.assert_identical(skin.corrected(), first)
    xr.testing.assert_identical(skin.field, measured)


def test_a_relief_that_is_mostly_noise_is_not_used(skins: tuple[Skin, Skin]) -> None:
    skin = skins[1]
    shapes = [PreparedShape(shape_of(skin.rig, each.z), calibration=skin.rig) for each in skin.shapes]
    lit = LitTexture(shapes[0], skin.textures[0], skin.rig.projector_position, skin.field)
    assert lit.without_shading(skin.field, shapes[1]) is skin.field


def test_displacement_stays_where_the_relit_texture_is_not_measured(skins: tuple[Skin, Skin]) -> None:
    """A hole of the shape is wider than the window; the field beside it is corrected."""
    skin = skins[1]
    heights = [each.z.copy() for each in skin.shapes]
    heights[0][80:160, 120:200] = np.nan
    shapes = [PreparedShape(shape_of(skin.rig, z), z_filter=2.0, calibration=skin.rig) for z in heights]
    lit = LitTexture(shapes[0], skin.textures[0], skin.rig.projector_position, skin.field)
    corrected = lit.without_shading(skin.field, shapes[1])
    change = (corrected.displacement_y - skin.field.displacement_y).values
    assert np.array_equal(np.isnan(corrected.displacement_y.values), np.isnan(skin.field.displacement_y.values))
    assert change[118:122, 158:162].any() == 0
    assert np.nanstd(change[INNER]) > 1e-3


def lines_every(distance: int) -> np.ndarray:
    """Return a texture of dots of 2 px on a net of lines; between them it is constant."""
    random = np.random.default_rng(4)
    dots = random.normal(size=(256, 256))
    row, column = np.indices(dots.shape)
    dots[(row % distance > 3) & (column % distance > 3)] = 0
    smooth = gaussian_filter(dots, 1.2)
    return (100 + 20 * smooth / smooth.std()).astype(np.float32)


@pytest.mark.parametrize(("distance", "low", "high"), [(1, 0.85, 1.15), (20, 1.2, 1.6)])
def test_noise_between_sparse_features_is_correlated_farther_than_the_window(
    distance: int, low: float, high: float
) -> None:
    texture = lines_every(distance)
    field = measure_displacement(texture, texture, window=24, spacing=2)
    flat = {name: np.zeros(texture.shape, np.float32) for name in ("x", "y", "z", "noise_z")}
    shape = xr.Dataset({name: (("row", "column"), each) for name, each in flat.items()})
    prepared = PreparedShape(shape.assign_attrs(camera_distance=0.5))
    assert low < LitTexture(prepared, texture, (0.2, 0.0, 0.5), field).slope_noise(41) < high
