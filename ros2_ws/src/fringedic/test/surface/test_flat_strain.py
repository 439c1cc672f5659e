"""Strain of flat specimens in three measures, against closed forms of homogeneous deformations."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from fringedic.surface import flat_strain

ROW, COLUMN = np.meshgrid(np.arange(0, 160, 4), np.arange(0, 200, 4), indexing="ij")
MEASURES = ("green-lagrange", "logarithmic", "engineering")
INNER = np.s_[8:-8, 8:-8]


def turn(degrees: float) -> np.ndarray:
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[cosine, -sine], [sine, cosine]])


def deformed(gradient: np.ndarray, noise: float = 0.0, seed: int = 1) -> xr.Dataset:
    """The displacement in the image of a deformation gradient in x (right) and y (up), with white noise [px]."""
    u, v = np.einsum("ij,jrc->irc", gradient - np.eye(2), np.stack([COLUMN - 100.0, 80.0 - ROW]))
    generator = np.random.default_rng(seed)
    maps = {"displacement_x": u, "displacement_y": -v}
    fields = {name: (("row", "column"), each + generator.normal(0, noise, u.shape)) for name, each in maps.items()}
    sigma = np.full(u.shape, max(noise, 1e-3))
    fields |= dict.fromkeys(("sigma_x", "sigma_y"), (("row", "column"), sigma))
    return xr.Dataset(fields, {"row": ROW[:, 0], "column": COLUMN[0]}, {"window_px": 8, "method": "dense"})


def components(gradient: np.ndarray, measure: str) -> np.ndarray:
    strain = flat_strain(deformed(gradient), window=41, measure=measure)
    return np.array([float(strain[name][INNER].median()) for name in ("e_xx", "e_yy", "e_xy", "e_1", "e_2")])


@pytest.mark.parametrize("angle", [0.0, 30.0, 170.0])
@pytest.mark.parametrize("stretch", [0.7, 1.0, 1.001, 1.6])
def test_a_stretch_has_its_closed_form_whatever_the_rotation(stretch: float, angle: float):
    exact = {"green-lagrange": (stretch**2 - 1) / 2, "logarithmic": np.log(stretch), "engineering": stretch - 1}
    for measure, along in exact.items():
        found = components(turn(angle) @ np.diag([stretch, 1.0]), measure)
        assert found[:3] == pytest.approx([along, 0.0, 0.0], abs=2e-6), measure
        assert found[3:] == pytest.approx([max(along, 0), min(along, 0)], abs=2e-6), measure


@pytest.mark.parametrize("angle", [0.0, 30.0])
@pytest.mark.parametrize("shear", [0.02, 0.8])
def test_simple_shear_has_its_closed_forms(shear: float, angle: float):
    """U = [[2, g], [g, 2 + g^2]] / sqrt(4 + g^2); its stretches are exp(+-asinh(g / 2)), their axes turned by phi."""
    root, size, phi = np.sqrt(4 + shear**2), np.arcsinh(shear / 2), 0.5 * np.arctan2(2, -shear)
    exact = {
        "green-lagrange": (0.0, shear**2 / 2, shear / 2),
        "logarithmic": (size * np.cos(2 * phi), -size * np.cos(2 * phi), size * np.sin(2 * phi)),
        "engineering": (2 / root - 1, (2 + shear**2) / root - 1, shear / root),
    }
    for measure, values in exact.items():
        found = components(turn(angle) @ np.array([[1.0, shear], [0.0, 1.0]]), measure)
        assert found[:3] == pytest.approx(values, abs=2e-6), measure


@pytest.mark.parametrize("measure", MEASURES)
@pytest.mark.parametrize(
    "gradient", [np.eye(2), np.diag([1.5, 0.8]), turn(30) @ [[1.0, 0.8], [0.0, 1.0]], [[1.3, 0.3], [0.1, 0.7]]]
)
def test_scatter_is_the_stated_standard_deviation(gradient: np.ndarray, measure: str):
    """Over many draws of errors that are independent from point to point, as a window of 1 px makes them."""
    found = [
        flat_strain(deformed(np.asarray(gradient), 0.02, seed).assign_attrs(window_px=1), window=41, measure=measure)
        for seed in range(60)
    ]
    for name in ("e_xx", "e_yy", "e_xy"):
        values = np.stack([each[name].values[INNER] for each in found])
        stated = float(found[0][f"sigma_{name}"][INNER].median())
        assert float(np.sqrt(values.var(axis=0, ddof=1).mean())) == pytest.approx(stated, rel=0.05), name


@pytest.mark.parametrize("measure", MEASURES)
def test_measure_and_tensor_shear_are_named(measure: str):
    strain = flat_strain(deformed(np.eye(2)), window=41, measure=measure)
    assert strain.attrs["strain_measure"] == measure
    assert strain.attrs["shear_strain"] == "tensor, half the engineering shear"
    assert strain.e_xy.long_name.lower().startswith(f"{measure} strain")
    assert "tensor shear" in strain.e_xy.long_name
