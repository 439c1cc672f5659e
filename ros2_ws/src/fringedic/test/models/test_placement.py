"""Alignment of a model with a measured surface against the known transformation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fringedic.errors import ModelError
from fringedic.models import Model, Placement, PointPair, place_model

SPACING = 0.2e-3
NOISE = 20e-6
X, Y = np.meshgrid(SPACING * np.arange(-60.0, 60.0), SPACING * np.arange(45.0, -45.0, -1))
TURN = Rotation.from_euler("xyz", [3.0, -4.0, 10.0], degrees=True).as_matrix()
SHIFT = np.array([1e-3, -2e-3, 0.5e-3])


def sheet(height, size: float = 20e-3, number: int = 161) -> Model:
    """A shell z = height(x, y) of triangles."""
    x, y = np.meshgrid(*2 * [np.linspace(-size, size, number)], indexing="ij")
    nodes = np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3)
    first = (np.arange(number - 1)[:, None] * number + np.arange(number - 1)).ravel()
    quads = np.stack([first, first + number, first + number + 1, first + 1], axis=1)
    triangles = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return Model("sheet.vtu", nodes, triangles, False, np.empty(0), np.empty((0, len(nodes), 3)))


def hill(x, y):
    return 1.5e-3 * np.exp(-((x - 2e-3) ** 2 + (y + 3e-3) ** 2) / (6e-3) ** 2) + 20 * x * y + 15 * x**2 * (1 + 40 * y)


def seen(height, turn=TURN, shift=SHIFT) -> np.ndarray:
    """Return the surface under the grid of the camera, found by iteration."""
    z = np.zeros_like(X)
    for _ in range(100):
        own = (np.stack([X, Y, z], axis=-1) - shift) @ turn
        z = z + (height(own[..., 0], own[..., 1]) - own[..., 2]) / turn[2, 2]
    return np.stack([X, Y, z])


def clicked(error: float = 0.0, seed: int = 0) -> list[PointPair]:
    generator = np.random.default_rng(seed)
    corners = [(-9e-3, -6e-3), (9e-3, -5e-3), (1e-3, 7e-3), (5e-3, 5e-3)]
    own = np.array([(x, y, hill(x, y)) for x, y in corners])
    measured = own @ TURN.T + SHIFT + generator.normal(0, error, own.shape)
    return [PointPair(tuple(m), tuple(o)) for m, o in zip(measured, own, strict=True)]


def error_of(placed: Placement) -> np.ndarray:
    """Return the motion (6,) from the truth to a placement about its centre."""
    turn = placed.rotation @ TURN.T
    moved = placed.translation - (turn @ (SHIFT - placed.centre) + placed.centre)
    return np.concatenate([moved, Rotation.from_matrix(turn).as_rotvec()])


def test_transformation_is_recovered_within_its_uncertainty():
    surface, model = seen(hill), sheet(hill, number=241)
    scores = []
    for seed in range(6):
        noisy = surface + np.random.default_rng(seed).normal(0, NOISE, X.shape) * np.array([0, 0, 1])[:, None, None]
        placed = place_model(noisy, model, clicked(SPACING, seed), spacing=SPACING)
        error = error_of(placed)
        scores.append(error @ np.linalg.solve(placed.covariance, error))
        assert placed.residual == pytest.approx(NOISE, rel=0.1)
        assert placed.free is None
    assert 2.5 < np.mean(scores) < 10.5  # chi square of 6 degrees of freedom, mean of 6: 6 +- 1.4


def test_what_only_the_surface_has_does_not_move_the_model():
    surface = seen(hill)
    surface[2, 20:40, 30:55] += 3e-3  # a clip
    placed = place_model(surface, sheet(hill), clicked(), spacing=SPACING)
    assert np.abs(error_of(placed)[:3]).max() < 2e-6


def test_covariance_accounts_for_correlated_noise():
    from scipy.ndimage import gaussian_filter

    surface, model = seen(hill), sheet(hill, number=241)
    scores = []
    for seed in range(6):
        noise = gaussian_filter(np.random.default_rng(seed).normal(size=X.shape), 2.0)
        noisy = surface.copy()
        noisy[2] += NOISE * noise / noise.std()
        placed = place_model(noisy, model, clicked(SPACING, seed), spacing=SPACING)
        error = error_of(placed)
        scores.append(error @ np.linalg.solve(placed.covariance, error))
    assert 2.5 < np.mean(scores) < 10.5


@pytest.mark.parametrize(
    ("height", "shape", "translations", "rotations"),
    [
        (lambda x, y: 0 * x * y, "a plane", 2, 1),
        (lambda x, y: np.sqrt((40e-3) ** 2 - x**2 + 0 * y) - 40e-3, "a cylinder", 1, 1),
        (lambda x, y: np.sqrt((40e-3) ** 2 - x**2 - y**2) - 40e-3, "a sphere", 0, 3),
    ],
)
def test_directions_that_the_shape_does_not_determine_are_named(height, shape, translations, rotations):
    surface = seen(height, np.eye(3), np.zeros(3))
    surface[2] += np.random.default_rng(1).normal(0, NOISE, X.shape)
    free = place_model(surface, sheet(height), spacing=SPACING).free
    assert free is not None
    assert (free.shape, len(free.translations), len(free.rotations)) == (shape, translations, rotations)
    if shape == "a cylinder":
        assert np.allclose(free.translations[0], (0, 1, 0), atol=0.01)
        assert np.allclose(free.rotations[0], (0, 1, 0), atol=0.01)


def test_pairs_place_a_plane_with_their_uncertainty():
    def plane(x, y):
        return 0 * x * y

    surface = seen(plane, np.eye(3), np.zeros(3))
    surface[2] += np.random.default_rng(1).normal(0, NOISE, X.shape)
    corners = [(-9e-3, -6e-3, 0.0), (9e-3, -5e-3, 0.0), (1e-3, 7e-3, 0.0), (5e-3, 5e-3, 0.0)]
    pairs = [PointPair(each, each) for each in corners]
    for sigma, expected in ((None, SPACING / 2), (10e-6, 5e-6)):
        placed = place_model(surface, sheet(plane), pairs, spacing=SPACING, pair_sigma=sigma)
        assert np.sqrt(np.diag(placed.covariance)[:2]) == pytest.approx([expected, expected], rel=0.1)


def test_a_mirrored_mesh_is_refused():
    model = sheet(lambda x, y: -hill(x, y))
    pairs = [PointPair(pair.measured, (*pair.model[:2], -pair.model[2])) for pair in clicked()[:3]]
    with pytest.raises(ModelError, match="mirror"):
        place_model(seen(hill), model, pairs, spacing=SPACING)


def test_wrong_unit_of_the_mesh_shows_in_the_pairs():
    pairs = [PointPair(pair.measured, tuple(25.4 * each for each in pair.model)) for pair in clicked()]
    with pytest.raises(ModelError, match=r"miss each other by .* mm: check their order and the unit"):
        place_model(seen(hill), sheet(hill), pairs, spacing=SPACING)


def test_model_beside_the_surface_and_pairs_on_a_line_are_refused():
    far = sheet(lambda x, y: hill(x, y))
    surface = seen(hill) + np.array([1.0, 0, 0])[:, None, None]
    with pytest.raises(ModelError, match="misses the measured surface"):
        place_model(surface, far, spacing=SPACING)
    line = [PointPair((x, 0, 0), (x, 0, 0)) for x in (0, 1e-2, 2e-2)]
    with pytest.raises(ModelError, match="not on a line"):
        place_model(seen(hill), sheet(hill), line, spacing=SPACING)


def test_principal_axes_find_an_elongated_part_in_any_position_and_count_what_fits_as_well():
    turn = Rotation.from_euler("xyz", [5.0, -3.0, 160.0], degrees=True).as_matrix()
    surface = seen(hill, np.eye(3), np.zeros(3))
    model = sheet(hill, number=161)
    inside = (np.abs(model.nodes[:, 0]) < 12.2e-3) & (np.abs(model.nodes[:, 1]) < 9.2e-3)
    triangles = model.triangles[inside[model.triangles].all(axis=1)]
    moved = replace(model, nodes=(model.nodes - SHIFT) @ turn, triangles=np.ascontiguousarray(triangles))
    placed = place_model(surface, moved, spacing=SPACING, start="principal axes")
    assert np.allclose(placed.rotation, turn, atol=1e-3)
    assert placed.alternatives == 0
    flat = replace(moved, nodes=(model.nodes * [1, 1, 0] - SHIFT) @ turn)
    plane = seen(lambda x, y: 0 * x * y, np.eye(3), np.zeros(3))
    plane[2] += np.random.default_rng(1).normal(0, NOISE, X.shape)
    assert place_model(plane, flat, spacing=SPACING, start="principal axes").alternatives == 3
    with pytest.raises(ModelError, match="principal axes; both have to show the same part"):
        place_model(surface, replace(moved, nodes=1e-3 * moved.nodes), spacing=SPACING, start="principal axes")


def test_edges_and_one_pair_place_a_plane():
    def plane(x, y):
        return 0 * x * y

    surface = seen(plane, np.eye(3), np.zeros(3))
    surface[2] += np.random.default_rng(1).normal(0, NOISE, X.shape)
    shift, along = np.array([0.3e-3, -0.2e-3, 0.0]), (1.0, 0.0, 0.0)
    corner, on_edge = (-10e-3, 7e-3, 0.0), (-1e-3, 7e-3, 0.0)
    edge = [PointPair((x, 7e-3, 0.0), tuple(on_edge - shift), None, along) for x in (-8e-3, 9e-3)]
    one = place_model(surface, sheet(plane), edge, spacing=SPACING)
    assert one.undetermined.shape == (6, 1)
    assert np.allclose(np.abs(one.undetermined[:3, 0]), [1, 0, 0], atol=1e-3)
    assert one.translation[1] == pytest.approx(shift[1], abs=1e-6)
    both = place_model(surface, sheet(plane), [*edge, PointPair(corner, tuple(corner - shift))], spacing=SPACING)
    assert both.undetermined.shape == (6, 0)
    assert both.translation[:2] == pytest.approx(shift[:2], abs=1e-6)
    assert np.sqrt(both.covariance[0, 0]) == pytest.approx(SPACING, rel=0.3)
