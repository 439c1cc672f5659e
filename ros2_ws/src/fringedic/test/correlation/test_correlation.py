"""In-plane displacement: figures on exact images, robustness, and errors for bad input."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import fringedic.errors as errors
from fringedic.correlation import Reference, measure_displacement
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration


def grid(field: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.meshgrid(field.row, field.column, indexing="ij")
    return x.astype(float), y.astype(float)


def uniform(dx: float, dy: float):
    return lambda x, y: (np.full_like(x, dx), np.full_like(y, dy))


@pytest.mark.parametrize("method", ["dense", "zoi"])
def test_axes_and_signs(speckle, method):
    """d_x to the right, d_y down; the material point at p is found at p + d."""
    surface = speckle((128, 192), 3)
    field = measure_displacement(
        surface.image(), surface.image(uniform(2.3, -5.6)), spacing=8 if method == "zoi" else 1, method=method
    )
    assert field.displacement_x.median() == pytest.approx(2.3, abs=2e-3)
    assert field.displacement_y.median() == pytest.approx(-5.6, abs=2e-3)
    assert field.displacement_x.dims == ("row", "column")
    assert field.valid.mean() > 0.6


def test_spacing_returns_the_same_points(speckle):
    surface = speckle((96, 128), 4)
    f, g = surface.image(noise=10, seed=1), surface.image(uniform(0.4, 0.1), noise=10, seed=2)
    every = measure_displacement(f, g, window=16)
    fifth = measure_displacement(f, g, window=16, spacing=5)
    assert list(fifth.row[:3]) == [0, 5, 10]
    xr.testing.assert_equal(
        every.isel(row=slice(None, None, 5), column=slice(None, None, 5)).drop_attrs(), fifth.drop_attrs()
    )


def test_prepared_reference_is_the_same(speckle):
    surface = speckle((96, 128), 5)
    f, g = surface.image(noise=10, seed=1), surface.image(uniform(1.4, 0.1), noise=10, seed=2)
    xr.testing.assert_identical(measure_displacement(f, g, window=24), measure_displacement(Reference(f, window=24), g))


def test_initial_displacement_replaces_the_global_start(speckle):
    surface = speckle((128, 160), 6)
    f, g = surface.image(), surface.image(uniform(40.2, 0.3))
    start = measure_displacement(f, surface.image(uniform(39.0, 0.0)))
    field = measure_displacement(f, g, initial=start)
    assert field.displacement_x.median() == pytest.approx(40.2, abs=2e-3)
    pair = (start.displacement_x.to_numpy(), start.displacement_y.to_numpy())
    xr.testing.assert_identical(field, measure_displacement(f, g, initial=pair))


def test_a_prediction_may_be_off_by_what_moved_since() -> None:
    """Furrows 10 px apart, moved by up to 9 px: none may be matched with its neighbour."""
    twin = VirtualRig(VirtualRigConfiguration.from_dict({"preset": "skin", "camera": {"columns": 320}}))
    white = np.full(twin.projector_shape, 255, np.uint8)
    f, g = (twin.expose(white, position, number) for number, position in enumerate((0.0, 0.1e-3)))
    still = np.zeros((twin.shape[0] // 4, twin.shape[1] // 4), np.float32)
    field = measure_displacement(f, g, spacing=4, initial=(still, still))
    truth = twin.truth(0.1e-3).isel(row=slice(None, None, 4), column=slice(None, None, 4))
    moved = float(np.nanmax(np.hypot(truth.displacement_x, truth.displacement_y)))
    error = np.hypot(
        field.displacement_x - truth.displacement_x.values, field.displacement_y - truth.displacement_y.values
    )
    assert moved > 8
    assert float(error.max()) < 0.25, f"{float(error.max()):.3f} px, {int((error > 0.25).sum())} points beyond .25 px"
    assert float(field.valid.mean()) > 0.9


@pytest.mark.parametrize("method", ["dense", "zoi"])
def test_mask_and_missing_pixels_are_not_measured(speckle, method):
    surface = speckle((128, 160), 7)
    f, g = surface.image(noise=10, seed=1).astype(np.float32), surface.image(uniform(0.3, 0.0), noise=10, seed=2)
    f[40:60, 50:70] = np.nan
    mask = np.ones(f.shape, bool)
    mask[:, 120:] = False
    field = measure_displacement(f, g, mask=mask, spacing=1 if method == "dense" else 4, method=method)
    full = field.reindex(row=np.arange(128), column=np.arange(160))
    assert not (full.valid == 1)[40:60, 50:70].any()
    assert not (full.valid == 1)[:, 120:].any()
    assert np.isnan(field.displacement_x.to_numpy()[~field.valid]).all()
    assert abs(field.displacement_x - 0.3).max() < 0.03
    assert field.valid.sum() > 100


def test_another_scene_is_refused(speckle):
    f, g = speckle((160, 160), 8).image(noise=10, seed=1), speckle((160, 160), 9).image(noise=10, seed=2)
    for method, spacing in (("dense", 1), ("zoi", 16)):
        with pytest.raises(errors.CorrelationError, check=lambda e: e.code is errors.ErrorCode.NO_CORRELATION):
            measure_displacement(f, g, method=method, spacing=spacing)


@pytest.mark.parametrize("factor", [1 / 16, 16])
def test_images_of_another_bit_depth_are_refused(speckle, factor):
    f = speckle((64, 64), 10).image().astype(np.float32)
    with pytest.raises(errors.CorrelationError, match="with the same bit depth, 8 or 16") as refused:
        measure_displacement(f, f * np.float32(factor))
    assert refused.value.code is errors.ErrorCode.NO_CORRELATION
    assert abs(measure_displacement(f, f * np.float32(factor**0.75)).displacement_x).max() < 0.01


def test_bad_input_has_a_name(speckle):
    f = speckle((64, 64), 10).image()
    for bad, error, words in [
        (np.stack([f] * 3, axis=-1), errors.ImageError, "in colour"),
        (np.zeros((0, 0)), errors.ImageError, "0 x 0 pixels"),
        (f[:, :1], errors.ImageError, "64 x 1 pixels"),
        (f[0], errors.ImageError, "the dimensions"),
        (f > 2000, errors.ImageError, "bool"),
        (f.astype(complex), errors.ImageError, "complex128"),
        (np.full_like(f, 7), errors.CorrelationError, "constant"),
        (np.full(f.shape, np.nan), errors.CorrelationError, "no measured pixel"),
    ]:
        with pytest.raises(error, match=f"reference image .*{words}"):
            measure_displacement(bad, f)
        with pytest.raises(error, match=f"deformed image .*{words}"):
            measure_displacement(f, bad)
    with pytest.raises(errors.ImageError, match="must be equal"):
        measure_displacement(f, f[:-1])
    for setting, error, words in [
        ({"window": 65}, errors.CorrelationError, "larger than the image"),
        ({"window": 7}, errors.CorrelationError, "at least 8 px"),
        ({"spacing": 0}, errors.CorrelationError, "spacing = 0"),
        ({"mask": np.ones((3, 3))}, errors.ImageError, "mask has the shape"),
        ({"mask": np.zeros(f.shape)}, errors.ImageError, "excludes every pixel"),
        ({"initial": (np.zeros((3, 3)), np.zeros((3, 3)))}, errors.ImageError, "initial displacement"),
        ({"method": "affine"}, errors.CorrelationError, "method = 'affine'"),
    ]:
        with pytest.raises(error, match=words):
            measure_displacement(f, f, **setting)
