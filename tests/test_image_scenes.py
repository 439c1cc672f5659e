"""The random scenes of benchmarks/anybodys_images.py: images and displacements are exact."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from scipy.ndimage import distance_transform_edt

import fringedic.correlation.closure  # noqa: F401 (its first import changes the environment: not inside of a test)

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
# plain, two with a part, an occluder, a crack across the image, a crack with a tip
SCENES = (5, 1, 6, 8, 11, 56)


@pytest.fixture(autouse=True)
def benchmarks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))


def test_a_pixel_is_the_mean_of_the_spots_over_its_area():
    """Every spot is summed at 16 x 16 points of each pixel, after the map was written down by hand."""
    from image_scenes.layers import Layer, View
    from image_scenes.motions import Affine, Sequence, Wave
    from image_scenes.textures import Spots

    spots = Spots.speckle(4.0, (-20, 50, -20, 50), np.random.default_rng(1))
    gradient = np.array([[1.1, 0.5], [-0.4, 0.9]])
    motion = Sequence((Affine(gradient, (12.0, 10.0), (2.3, -1.4)), Wave((0.8, -0.5), (0.05, 0.1), 0.3)))
    places = np.arange(20 * 16) / 16 + 1 / 32 - 0.5
    y, x = (each[..., None] for each in np.meshgrid(places, places, indexing="ij"))
    wave = np.sin(0.05 * x + 0.1 * y + 0.3)
    offset = x - 0.8 * wave - 2.3 - 12, y + 0.5 * wave + 1.4 - 10
    back = np.linalg.inv(gradient)
    at_x, at_y = (back[k, 0] * offset[0] + back[k, 1] * offset[1] + (12, 10)[k] for k in range(2))
    ink = np.zeros(at_x.shape[:2])
    for spot_x, spot_y, square, density in spots.spots:
        distance = ((at_x - spot_x) ** 2 + (at_y - spot_y) ** 2)[..., 0] / square
        ink += density * np.clip(1 - distance, 0, None) ** 3
    exact = np.exp(-ink).reshape(20, 16, 20, 16).mean(axis=(1, 3))
    for samples, tolerance in ((2, 0.005), (3, 0.001)):
        image = View((20, 20), (Layer(spots, motion),), samples).image(moved=True)
        assert np.abs(image - exact).max() < tolerance
    assert exact.std() > 0.1


def test_a_translation_by_whole_pixels_shifts_the_image():
    from image_scenes.layers import Layer, View
    from image_scenes.motions import Affine
    from image_scenes.textures import Skin

    skin = Skin(12.0, (-30, 90, -30, 90), np.random.default_rng(2))
    view = View((48, 56), (Layer(skin, Affine(np.eye(2), (27.5, 23.5), (7.0, -5.0))),))
    reference, deformed = (view.image(moved=moved) for moved in (False, True))
    assert np.abs(deformed[:-5, 7:] - reference[5:, :-7]).max() < 1e-9
    truth = view.truth()
    assert (truth.x == 7).all()
    assert (truth.y == -5).all()
    assert truth.visible.sum() == (48 - 5) * (56 - 7)
    assert truth.visible[5:, :-7].all()


@pytest.mark.parametrize("number", SCENES)
def test_the_material_is_where_the_truth_places_it(number: int):
    """The displacement maps forward, the images are rendered by inverse maps; both find the same brightness."""
    from image_scenes.scenes import Scene

    view = Scene.random(number).view
    truth = view.truth(8)
    y, x = np.mgrid[: view.shape[0] : 8, : view.shape[1] : 8].astype(float)
    to_x, to_y = x + truth.x, y + truth.y
    whole = truth.visible.copy()  # without pixels on the edges of a surface, which are mixtures
    for layer in view.layers:
        for covered in (layer.cover(x, y), layer.cover(*layer.motion.inverse(to_x, to_y))):
            whole &= (covered == 0) | (covered == 1)
    before = view.brightness(x[whole], y[whole], moved=False)
    after = view.brightness(to_x[whole], to_y[whole], moved=True)
    assert whole.sum() > 0.3 * whole.size
    assert before.std() > 0.01
    assert np.abs(after - before).max() < 1e-6


@pytest.mark.parametrize("number", [1, 6, 11, 47])
def test_what_a_part_or_a_crack_reveals_is_not_what_the_reference_shows(number: int):
    """Otherwise a rim that stands still, or moves as the rest does, would explain the deformed image as well."""
    from image_scenes.layers import View
    from image_scenes.motions import STILL
    from image_scenes.scenes import Scene
    from image_scenes.textures import Plain

    view = Scene.random(number).view
    behind = len(view.layers) - 1
    # every surface with a brightness of its own number: which one is seen in the deformed image
    marked = View(view.shape, tuple(replace(each, texture=Plain(k)) for k, each in enumerate(view.layers)))
    y, x = np.mgrid[: view.shape[0], : view.shape[1]].astype(float)
    revealed = np.abs(marked.brightness(x, y, moved=True) - behind) < 1e-9
    assert revealed.sum() > 100
    after = view.brightness(x[revealed], y[revealed], moved=True)
    motions = [each.motion for each in view.layers] + [STILL]
    for at in (motion.inverse(x[revealed], y[revealed]) for motion in motions):
        before = view.brightness(*at, moved=False)
        assert np.sqrt(np.mean((after - before) ** 2)) > 0.8 * before.std()


@pytest.mark.parametrize("number", SCENES)
def test_pixels_within_two_pixels_of_a_border_are_mixed(number: int):
    from image_scenes.scenes import Scene

    truth = Scene.random(number).view.truth()
    surfaces = np.unique(truth.layer)
    if len(surfaces) == 1:
        assert not truth.mixed.any()
        return
    # the border is half a pixel before the next pixel of another surface
    away = np.max([distance_transform_edt(truth.layer == each) for each in surfaces], axis=0)
    assert truth.mixed[away <= 2].all()
    inner = np.s_[3:-3, 3:-3]  # a border may be just outside of the image
    assert not truth.mixed[inner][away[inner] > 2.5].any()


@pytest.mark.parametrize("number", SCENES)
def test_a_scene_is_made_again_from_its_number(number: int):
    from image_scenes.scenes import Scene

    first, second = Scene.random(number), Scene.random(number)
    assert first.words == second.words
    assert (first.view.truth(16).x == second.view.truth(16).x).all()
    window = np.mgrid[100:120, 200:240].astype(float)
    assert (first.view.brightness(*window, moved=True) == second.view.brightness(*window, moved=True)).all()


def test_a_lattice_repeats_with_its_periods():
    from image_scenes.scenes import Scene

    found = [scene for scene in map(Scene.random, range(60)) if scene.lattice is not None]
    assert {scene.texture for scene in found} == {"grid", "weave", "dots"}
    y, x = np.mgrid[100:140, 100:140] + 0.3
    for scene in found:
        texture = scene.surface
        for period in scene.lattice:
            assert np.abs(texture.at(x + period[0], y + period[1]) - texture.at(x, y)).max() < 1e-9
            assert np.abs(texture.at(x + 0.4 * period[0], y + 0.4 * period[1]) - texture.at(x, y)).max() > 0.01


@pytest.fixture
def lattice_scene():
    """Return a scene whose surface is a perfect lattice, and its true displacement as a result."""
    from image_scenes.outcomes import SPACING
    from image_scenes.scenes import Scene

    scene = next(each for each in map(Scene.random, range(60)) if each.lattice is not None and each.kind == "plain")
    truth = scene.view.truth(SPACING)
    size = truth.x.shape
    parts = {
        "displacement_x": truth.x,
        "displacement_y": truth.y,
        "valid": np.ones(size, bool),
    }
    positions = {"row": SPACING * np.arange(size[0]), "column": SPACING * np.arange(size[1])}
    return scene, xr.Dataset({name: (("row", "column"), part) for name, part in parts.items()}, positions)


def test_a_displacement_by_whole_periods_is_right_if_the_result_states_them(lattice_scene):
    from image_scenes.outcomes import SPACING, repeated_truth

    scene, field = lattice_scene
    truth = scene.view.truth(SPACING)
    y, x = np.meshgrid(field.row.values.astype(float), field.column.values.astype(float), indexing="ij")
    period = scene.lattice[0] - 2 * scene.lattice[1]
    there = scene.view.layers[0].motion.forward(x + period[0], y + period[1])
    field["displacement_x"].values[:], field["displacement_y"].values[:] = there[0] - x, there[1] - y
    assert repeated_truth(scene, truth, field) is truth
    for stated, right in (
        (scene.lattice, True),
        (scene.lattice[::-1], True),
        (scene.lattice[0] - 2 * scene.lattice[1], True),  # one direction alone
        (scene.lattice[0], False),
        (2 * scene.lattice, False),
        (0.6 * scene.lattice, False),
    ):
        found = repeated_truth(scene, truth, field.assign_attrs(repeats_px=stated.ravel().tolist()))
        assert (np.abs(found.x - field.displacement_x.values).max() < 1e-6) == right


def test_outcomes_follow_from_the_shares_of_the_points():
    from image_scenes.outcomes import judge_refusal, judge_result

    scene, stripes = (SimpleNamespace(hopeless=name == "stripes", texture=name) for name in ("speckle", "stripes"))
    assert judge_result(scene, 0.9, 0.95, 0.9995) == "right"
    assert judge_result(scene, 0.5, 0.5, 1.0) == "lost"
    assert judge_result(scene, 0.9, 0.95, 0.99) == "partially wrong"
    assert judge_result(scene, 0.9, 0.95, 0.2) == "wrong"
    assert judge_result(stripes, 0.001, 0.0, 0.0) == "refused"
    assert judge_result(stripes, 0.5, 1.0, 0.1) == "wrong"
    everywhere, nowhere = np.ones((4, 4), bool), np.zeros((4, 4), bool)
    assert judge_refusal(scene, everywhere, "the texture has one direction") == "lost"
    assert judge_refusal(scene, nowhere, "the texture is too faint") == "refused"
    assert judge_refusal(stripes, everywhere, "the texture has one direction") == "refused"
    assert judge_refusal(stripes, everywhere, "the images do not correlate") == "other reason"


def test_points_that_the_closure_refutes_are_not_valid(monkeypatch: pytest.MonkeyPatch):
    """Scene 5 is measured, then an object covers a square of its deformed image."""
    from image_scenes import outcomes
    from image_scenes.scenes import Scene

    scene = Scene.random(5)
    pair, truth = scene.render(), scene.view.truth(outcomes.SPACING)
    field = outcomes.measure_displacement(pair.reference, pair.deformed, window=32, spacing=4)
    inside = field.valid.values & truth.visible
    row, column = (int(np.median(each)) for each in np.nonzero(inside))
    to = [int(each) for each in (4 * row + truth.y[row, column], 4 * column + truth.x[row, column])]
    pair.deformed[to[0] - 40 : to[0] + 40, to[1] - 40 : to[1] + 40] = 250
    monkeypatch.setattr(Scene, "render", lambda _: pair)
    monkeypatch.setattr(outcomes, "measure_displacement", lambda *_, **__: field)
    result = outcomes.measure(5)
    assert result.refuted > 100
    assert result.valid + result.refuted == field.valid.values.sum()
    assert result.needless > 0.9 * result.refuted
