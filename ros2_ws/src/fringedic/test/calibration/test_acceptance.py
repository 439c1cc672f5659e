"""Acceptance test with balls, ball bar and plane before a virtual rig, whose sizes are exact."""

import math
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from fringedic.calibration.acceptance import (
    Acceptance,
    AcceptanceError,
    Artefact,
    Artefacts,
    Place,
    fit_sphere,
    measure_place,
    unsuitable,
)
from fringedic.calibration.acceptance_sentences import acceptance_text, place_in_words
from fringedic.calibration.virtual_artefacts import measure_virtual_artefact
from fringedic.configuration.rig_file import RigFile
from fringedic.errors import CalibrationError
from fringedic.report.acceptance import write_acceptance_page

ARTEFACTS = Artefacts(diameter=12e-3, spacing=30e-3, volume=(55e-3, 40e-3, 20e-3))
NOISE = 27e-6  # of z of a pixel; the distances of a cap scatter less
PLACES = ARTEFACTS.places()


@pytest.fixture(scope="module")
def rig():
    return RigFile.model_validate(
        {
            "camera": {"source": "virtual"},
            "projector": {"source": "virtual"},
            "calibration": "virtual_rig",
            "virtual_rig": {"preset": "plate", "size": "small"},
            "sequence": {"pitches_px": [200.0, 40.0, 10.0]},
            "acceptance": {
                "ball_diameter_mm": 12.0,
                "bar_spacing_mm": 30.0,
                "volume_mm": [55.0, 40.0, 20.0],
                "sphere_spacing_um": 20.0,
                "probing_size_um": 60.0,
            },
        }
    )


@pytest.fixture(scope="module")
def model(rig):
    return rig.rig_model


def shape_of(rig, model, place):
    return measure_virtual_artefact(rig.virtual_configuration(), rig.patterns(), model, place, ARTEFACTS)


def result_at(number, rig, model, calibration=None):
    shape = shape_of(rig, calibration or model, PLACES[number])
    return measure_place(PLACES[number], shape, ARTEFACTS)


@pytest.fixture(scope="module")
def results(rig, model):
    return tuple(result_at(number, rig, model) for number in (0, 5, 15, 22))


def test_a_sphere_is_fitted_by_its_distances():
    random = np.random.default_rng(4)
    angle, height = random.uniform(0, 2 * np.pi, 3000), random.uniform(0.6, 1.0, 3000)
    side = np.sqrt(1 - height**2)
    direction = np.stack([side * np.cos(angle), side * np.sin(angle), height])
    noise = random.normal(0, 1e-5, 3000)
    sphere = fit_sphere(np.array([[0.02], [-0.01], [0.005]]) + (6e-3 + noise) * direction)
    # of a cap, the radius is correlated with the height of the centre and known far worse than a point over sqrt(n)
    assert sphere.radius == pytest.approx(6e-3, abs=2e-5)
    assert sphere.centre == pytest.approx([0.02, -0.01, 0.005], abs=2e-5)
    assert sphere.distances.std() == pytest.approx(1e-5, rel=0.05)


def test_errors_are_those_of_the_noise(results):
    ball, corner, bar, plane = (each.errors for each in results)
    for each in (ball, corner):
        assert abs(each[AcceptanceError.SIZE]) < 45e-6
        assert 4 * NOISE < each[AcceptanceError.FORM] < 9 * NOISE
    assert abs(bar[AcceptanceError.SPACING]) < 8e-6
    assert 4 * NOISE < plane[AcceptanceError.FLATNESS] < 7 * NOISE
    assert results[2].place.rotation[1] > math.radians(10)


def test_balls_are_where_they_were_placed(rig, model):
    place = PLACES[6]
    shape = shape_of(rig, model, place)
    residuals = measure_place(place, shape, ARTEFACTS).residuals
    # the highest point of the ball is above its centre
    assert shape.z.max() == pytest.approx(place.centre[2] + 6e-3, abs=6 * NOISE)
    assert np.abs(residuals[0] - place.centre[0]).max() < 6e-3


def test_a_wrong_scale_is_a_spacing_error(rig, model, results):
    longer = replace(model, pixel_size=1.002 * model.pixel_size)
    wrong = result_at(10, rig, model, longer)
    assert wrong.errors[AcceptanceError.SPACING] == pytest.approx(0.002 * 30e-3, abs=10e-6)
    right = Acceptance(ARTEFACTS, rig.acceptance.limits, results)
    assert right.passed
    failed = Acceptance(ARTEFACTS, rig.acceptance.limits, (*results, wrong))
    assert failed.exceeded == (AcceptanceError.SPACING,)
    assert acceptance_text(failed).startswith("FAILED: sphere-spacing error exceeds")


def test_a_bent_shape_is_a_flatness_error(rig, model):
    shape = shape_of(rig, model, PLACES[18])
    bent = shape.assign(z=shape.z + 3e-4 * (shape.x / 0.0275) ** 2)
    errors = [measure_place(PLACES[18], each, ARTEFACTS).errors[AcceptanceError.FLATNESS] for each in (shape, bent)]
    assert errors[1] - errors[0] > 2e-4


def test_what_is_missing_fails_its_limit(rig, results):
    without_bar = Acceptance(ARTEFACTS, rig.acceptance.limits, results[:2])
    assert without_bar.exceeded == (AcceptanceError.SPACING,)
    assert Acceptance(ARTEFACTS, {}, results).passed


def test_a_plane_is_no_ball(rig, model):
    shape = shape_of(rig, model, PLACES[18])
    with pytest.raises(CalibrationError, match="ball"):
        measure_place(PLACES[0], shape, ARTEFACTS)
    with pytest.raises(CalibrationError, match="light it better"):
        measure_place(PLACES[0], shape.where(False), ARTEFACTS)
    with pytest.raises(CalibrationError, match="on the plane"):
        measure_place(PLACES[18], shape.where(False), ARTEFACTS)


@pytest.mark.parametrize(("asked", "was"), [(1, 0), (9, 0), (11, 10), (14, 13), (15, 10), (19, 18), (21, 19), (22, 20)])
def test_an_artefact_that_was_not_moved(asked, was, rig, model):
    shape = shape_of(rig, model, PLACES[was])
    with pytest.raises(CalibrationError, match=rf"mm away from it and nearer to place {was + 1}"):
        measure_place(PLACES[asked], shape, ARTEFACTS)


def test_places_need_not_be_exact(rig, model):
    beside = replace(PLACES[15], centre=(2e-3, -2e-3, 1e-3))
    shape = shape_of(rig, model, beside)
    assert abs(measure_place(PLACES[15], shape, ARTEFACTS).errors[AcceptanceError.SPACING]) < 10e-6


def test_places_fill_the_volume():
    assert [sum(each.artefact is kind for each in PLACES) for kind in Artefact] == [10, 7, 6]
    half = np.array(ARTEFACTS.volume) / 2
    for place in PLACES:
        margin = 6e-3 if place.artefact is Artefact.BALL else 0.0
        assert (np.abs(place.centre) <= half - margin + 1e-12).all()
    assert not unsuitable(ARTEFACTS)
    assert list(unsuitable(replace(ARTEFACTS, diameter=2e-3, spacing=10e-3))) == [Artefact.BALL, Artefact.BALL_BAR]
    assert place_in_words(Place(Artefact.PLANE, (0.001, 0.0, 0.0), (0.1, 0.0, 0.0))).endswith("+6 degree about x")


def test_page_contains_errors_and_residuals(rig, results, tmp_path):
    small = replace(ARTEFACTS, diameter=2e-3)
    acceptance = Acceptance(small, rig.acceptance.limits, results)
    file = write_acceptance_page(acceptance, tmp_path / "a.html", rig="bench", created=datetime(2026, 1, 2, tzinfo=UTC))
    page = file.read_text(encoding="utf-8")
    assert page.count("data:image/png") == 2
    assert "VDI/VDE 2634 part 2" in page
    assert "The ball of 2 mm is not" in page
