"""Prediction of the uncertainties of a planned rig, beside what the virtual rig measures."""

import math
from dataclasses import replace

import numpy as np
import pytest

from fringedic.configuration.rig_file import RigFile
from fringedic.configuration.yaml_section import validate
from fringedic.correlation import measure_displacement
from fringedic.errors import ConfigurationError, RigSetupError
from fringedic.patterns import fringe_sequence
from fringedic.patterns.pattern import Orientation
from fringedic.phase.demodulation import absolute_phase
from fringedic.planning import PlannedRig, make_plan
from fringedic.planning.motion_limit import motion_limit
from fringedic.planning.plan import PlanChange, field_uncertainty, plane_noise, recommend_angle
from fringedic.planning.plan_warnings import PlanProblem, PlanWarning, depth_of_field, find_warnings, fringe_period
from fringedic.planning.planned_patch import Patch
from fringedic.planning.planned_rig import pixel_ripple
from fringedic.planning.sentences import faster_motion_sentence, plan_text, plan_warning_sentence
from fringedic.report.plan import write_plan_page
from fringedic.settings.experiment import SequenceSettings
from fringedic.surface import couple
from fringedic.virtual_rig import VirtualRig

PITCHES = [400.0, 80.0, 12.0]
COMPONENTS = {
    "camera_pixel_um": 5.0,
    "focal_length_mm": 25.0,
    "camera_distance_mm": 400.0,
    "throw_ratio": 6.0,
    "projector_distance_mm": 420.0,
    "speckle_um": 320.0,
}


def rig_file(**plan: object) -> RigFile:
    content = {
        "camera": {"source": "aravis", "width": 480, "height": 360},
        "projector": {"source": "display", "width": 400, "height": 300},
        "sequence": {"pitches_px": PITCHES, "shifts": 4},
        "nodes": {"dic": {"window": 28, "spacing": 4}, "coupling": {"strain_window_px": 65}},
        "plan": COMPONENTS | plan,
    }
    return validate(RigFile, content, "rig.yaml")


@pytest.fixture(scope="module")
def planned() -> PlannedRig:
    return PlannedRig.of(rig_file())


@pytest.fixture(scope="module")
def plan(planned):
    return make_plan(planned)


def problems(rig: RigFile) -> set[PlanProblem]:
    planned = PlannedRig.of(rig)
    predicted = Patch.at(planned, 240, 180).uncertainty()
    return {each.problem for each in find_warnings(planned, predicted)}


def test_prediction_is_what_the_virtual_rig_measures(planned):
    twin = VirtualRig(planned.configuration)
    truth = twin.truth(1e-4)
    rows, columns = twin.projector_shape
    sequence = fringe_sequence(columns, rows, PITCHES, [4, 4, 4])
    shapes, textures = [], []
    for step, position in enumerate((0.0, 1e-4)):
        frames = np.array([twin.expose(image, position, 100 * step + k) for k, image in enumerate(sequence)])
        phase = absolute_phase(frames, sequence.patterns, noise=planned.noise)
        shapes.append(planned.model.reconstruct(phase.phase, PITCHES[-1], phase.sigma))
        textures.append(phase.texture)
    field = measure_displacement(*textures, window=planned.dic.window, spacing=planned.dic.spacing)
    cloud = couple(*shapes, field, z_filter=planned.coupling.z_filter_px)
    inner = {"row": slice(40, -40), "column": slice(40, -40)}
    exact = truth.sel(row=cloud.row, column=cloud.column)
    cut = {"row": slice(10, -10), "column": slice(10, -10)}
    errors = {"z": (shapes[0].z - truth.z).isel(inner)}
    errors |= {name: (cloud[name] - exact[name]).isel(cut) for name in "uvw"}
    predicted = field_uncertainty(planned, margin=40).sigma
    for name, error in errors.items():
        assert predicted[name] / float(np.sqrt((error**2).mean())) == pytest.approx(1.0, abs=0.1), name


def test_phase_follows_the_number_of_frames_and_the_modulation(planned):
    more = replace(planned, patterns=tuple(each for each in planned.patterns for _ in (0, 1)))
    assert plane_noise(more) == pytest.approx(plane_noise(planned) / math.sqrt(2), rel=1e-6)
    blurred = PlannedRig.of(rig_file(projector_blur_px=1.6))
    loss = math.exp(-2 * (math.pi / PITCHES[-1]) ** 2 * (1.6**2 - 0.6**2))
    assert plane_noise(planned) / plane_noise(blurred) == pytest.approx(loss, rel=1e-6)


def test_ripple_of_a_sharp_projector_is_that_of_its_pixels():
    pitch, blur, fine = 10.0, 0.3, 64
    pixels = fringe_sequence(400, 16, [400.0, pitch], [4, 4])
    kernel = np.exp(-0.5 * (np.arange(-4 * fine, 4 * fine + 1) / (blur * fine)) ** 2)
    frames = [np.convolve(np.repeat(image[0].astype(float), fine), kernel / kernel.sum(), "same") for image in pixels]
    levels = np.array(frames[4:])[:, 100 * fine : 300 * fine]
    place = (np.arange(100 * fine, 300 * fine) + 0.5) / fine - 0.5
    shifts = 2 * np.pi * np.arange(1, 5) / 4
    wrapped = np.angle(np.tensordot(np.exp(1j * shifts), levels, axes=1))
    error = np.angle(np.exp(1j * (wrapped - 2 * np.pi * (place - 199.5) / pitch)))
    assert float(np.sqrt(np.mean(error**2))) == pytest.approx(pixel_ripple(pitch, blur), rel=0.15)


def test_sources_and_changes(plan):
    for shares in plan.shares.values():
        assert sum(shares.values()) == pytest.approx(1.0)
    assert plan.shares["z"][plan.dominant("u")[0]] == pytest.approx(0.0, abs=1e-6)  # the texture gives no height
    half = plan.changes[PlanChange.TWICE_THE_FRAMES]
    assert half["z"] == pytest.approx(math.sqrt(0.5), rel=1e-3)
    assert plan.best_change("e_11")[0] is PlanChange.WIDER_STRAIN_WINDOW


def test_fringes_run_across_the_line_to_the_projector(planned, plan):
    assert plan.recommended_orientation is Orientation.VERTICAL
    with pytest.raises(RigSetupError, match=r"set sequence\.orientation to horizontal"):
        make_plan(PlannedRig.of(rig_file(projector_side="above")))
    oblique = replace(planned, model=replace(planned.model, projector_position=(0.10, 0.14, 0.38)))
    plan = make_plan(oblique)
    assert plan.recommended_orientation is Orientation.HORIZONTAL
    assert plan.directions[Orientation.HORIZONTAL] == pytest.approx(0.10 / 0.14, rel=0.1)


def test_recommended_angle_leaves_light_on_slopes(plan):
    flat, steep = (recommend_angle(PlannedRig.of(rig_file(slope_degree=each))) for each in (0.0, 50.0))
    assert flat > math.radians(40)
    assert steep == pytest.approx(math.radians(30))
    noise = dict(plan.angles)
    assert noise[math.radians(10)] > 2 * noise[math.radians(30)]


def test_a_wide_opening_limits_the_angle():
    # the depth of the surface along the projector's axis grows with the angle
    sharp, wide = (
        recommend_angle(PlannedRig.of(rig_file(projector_aperture_mm=each, slope_degree=0.0))) for each in (0.0, 60.0)
    )
    assert wide < sharp - math.radians(10)


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"depth_mm": 200.0}, PlanProblem.CAMERA_DEPTH),
        ({"projector_aperture_mm": 60.0}, PlanProblem.PROJECTOR_DEPTH),
        ({"speckle_um": 100.0}, PlanProblem.SMALL_SPECKLES),
        ({"speckle_um": 900.0}, PlanProblem.LARGE_SPECKLES),
        ({"speckle_um": 500.0}, PlanProblem.FEW_SPECKLES),
        ({"throw_ratio": 2.0}, PlanProblem.PROJECTOR_PIXELS),
        ({"projector_blur_px": 0.3}, PlanProblem.PIXEL_RIPPLE),
        ({"slope_degree": 70.0}, PlanProblem.SHADOW),
        ({"throw_ratio": 15.0}, PlanProblem.FIELD),
        ({"full_well_electrons": 40.0, "speckle_floor": 0.02}, PlanProblem.ORDERS),
    ],
)
def test_every_warning_has_its_cause(changes, problem):
    assert problem in problems(rig_file(**changes))


def test_a_good_rig_has_no_warning():
    assert not problems(rig_file())


def test_fine_fringes_are_named():
    rig = rig_file()
    fine = rig.model_copy(update={"sequence": rig.sequence.model_copy(update={"pitches_px": [400.0, 40.0, 5.0]})})
    assert PlanProblem.FRINGE_PROJECTOR in problems(fine)
    near = PlannedRig.of(rig_file(throw_ratio=15.0))
    assert fringe_period(near) < fringe_period(PlannedRig.of(rig))


def test_depth_of_field_is_that_of_a_thin_lens():
    planned = PlannedRig.of(rig_file(f_number=4.0))
    m = 25.0 / 375.0
    assert depth_of_field(planned) == pytest.approx(2 * 4.0 * 5e-6 * (1 + m) / m**2)
    # a point at the edge of this depth is blurred over one pixel: aperture f / N, image distance f (1 + m)
    off = depth_of_field(planned) / 2
    focused, beyond = (1 / (1 / 0.025 - 1 / each) for each in (0.4, 0.4 + off))
    assert (0.025 / 4.0) * abs(focused - beyond) / beyond == pytest.approx(5e-6, rel=0.05)


def test_text_and_page_contain_figures_and_warnings(plan, tmp_path):
    plan = replace(plan, warnings=(PlanWarning(PlanProblem.CAMERA_DEPTH, 0.01, 0.02),))
    text = plan_text(plan)
    sentences = [plan_warning_sentence(each) for each in plan.warnings]
    assert all(each in text for each in sentences)
    assert f"{1e6 * plan.centre.sigma['z']:.3g} µm" in text
    page = write_plan_page(plan, tmp_path / "plan.html", rig="bench").read_text(encoding="utf-8")
    assert page.count("data:image/png") == 2
    assert "depth of field" in page


def test_what_cannot_be_planned_is_one_sentence():
    bare = RigFile.model_validate({"camera": {"source": "aravis", "width": 480, "height": 360}})
    with pytest.raises(ConfigurationError, match="no section plan"):
        PlannedRig.of(bare, "bench.yaml")
    with pytest.raises(ConfigurationError, match="gives no image"):
        rig_file(camera_distance_mm=20.0)
    rig = rig_file()
    with pytest.raises(ConfigurationError, match="no projector"):
        PlannedRig.of(rig.model_copy(update={"projector": None}))
    unsized = rig.camera.model_copy(update={"width": 0})
    with pytest.raises(ConfigurationError, match="width and height"):
        PlannedRig.of(rig.model_copy(update={"camera": unsized}))
    repeating = rig.sequence.model_copy(update={"pitches_px": [60.0, 12.0]})
    with pytest.raises(RigSetupError, match="pitch"):
        PlannedRig.of(rig.model_copy(update={"sequence": repeating}))
    exposures = rig.sequence.model_copy(update={"exposures_ms": [1.0, 4.0]})
    with pytest.raises(RigSetupError, match="one exposure time"):
        PlannedRig.of(rig.model_copy(update={"sequence": exposures}))


def test_a_virtual_rig_is_a_plan_too():
    virtual = {"preset": "plate", "size": "small", "camera": {"lens": {"k1": -0.1}}}
    content = {"camera": {"source": "virtual"}, "projector": {"source": "virtual"}, "virtual_rig": virtual}
    planned = PlannedRig.of(RigFile.model_validate(content))
    assert planned.components is None
    assert math.isinf(depth_of_field(planned))
    assert 0.01 < planned.noise.shot < 0.03


def test_a_known_direction_and_a_shorter_exposure_allow_a_faster_motion(planned):
    exposed = replace(planned, exposure_time=0.02)
    one_way = motion_limit(replace(exposed, sequence=SequenceSettings(motion_fringes=[-0.28, 0.0])))
    both = motion_limit(exposed)
    assert one_way.speed / both.speed == pytest.approx(2 * math.pi * 0.28 / 0.6)
    assert both.per_frame == pytest.approx(0.6 / (2 * math.pi) * fringe_period(exposed))
    assert max(one_way.condition, both.condition) < 10
    assert 0.9 < one_way.contrast < both.contrast
    sentence = faster_motion_sentence(exposed)
    assert "finest pitch of 24 projector px: x 2" in sentence
    assert "an exposure of 10 ms: x 1.31" in sentence, "(22 + 20) / (22 + 10)"
    assert "where the direction is known: x 2.93" in sentence
    assert "exposure" not in faster_motion_sentence(replace(planned, exposure_time=math.nan))
