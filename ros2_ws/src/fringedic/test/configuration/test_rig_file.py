"""Rig files: what people write, in their units, and what they are told when it is wrong."""

import math
from dataclasses import replace

import pytest
import yaml

from fringedic.configuration.programme import Programme
from fringedic.configuration.rig_file import load_programme, load_rig_file
from fringedic.configuration.virtual_calibration import calibration_of
from fringedic.errors import ConfigurationError
from fringedic.metadata import Metadata, NoiseFloorMetadata
from fringedic.patterns.pattern import Orientation, PatternKind
from fringedic.rig.model import RigModel
from fringedic.virtual_rig import VirtualRig

VIRTUAL = """
namespace: rig
camera: {source: virtual, exposure_ms: 12, settle_ms: 5}
projector: {source: virtual}
sequence: {pitches_px: [100, 20], shifts: 5, orientation: horizontal}
calibration: virtual_rig
load_frame: {source: simulated, rate_hz: 200}
nodes:
  phase: {saturation_grey_level: 250}
  dic: {window: 24, spacing: 2}
virtual_rig: {preset: plate, size: tiny, seed: 3}
recording: {folder: out, derived: false, compression: none}
programme:
  experiment: plate
  ramp: {to_mm: 1.0, steps: 5, speed_mm_per_s: 2}
"""

CALIBRATED = """
camera: {source: files, files: images/*.tif}
calibration:
  identifier: bench 2
  camera:
    width_px: 640
    height_px: 480
    distance_mm: 400
    pixel_size_mm: 0.1
    tilt_x_degree: 2
  projector:
    width_px: 800
    height_px: 600
    position_mm: [-180, 1.5, 380]
    yaw_pitch_roll_degree: [1, -2, 90]
    focal_length_px: 3400
    principal_row_px: 310
"""


def write(tmp_path, text, name="RIG.yaml"):
    file = tmp_path / name
    file.write_text(text)
    return file


def changed(text, path, value):
    """The same file with another value at 'section.key'; '...' leaves the key out."""
    content = yaml.safe_load(text)
    *sections, key = path.split(".")
    section = content
    for name in sections:
        section = section[name]
    if value is ...:
        del section[key]
    else:
        section[key] = value
    return yaml.safe_dump(content)


def test_a_virtual_rig_is_described_once(tmp_path):
    file = write(tmp_path, VIRTUAL)
    rig = load_rig_file(file)
    assert rig.camera_size() == (160, 120)
    assert rig.projector_size() == (100, 75)
    assert rig.camera.exposure_time == pytest.approx(0.012)
    assert rig.camera.settle_time == pytest.approx(0.005)
    assert (rig.nodes.dic.window, rig.nodes.dic.spacing, rig.nodes.coupling.z_filter_px) == (24, 2, 2.0)
    assert rig.nodes.phase.saturation_grey_level == 250.0
    patterns = rig.patterns()
    assert len(patterns) == 10
    assert patterns[0].orientation == Orientation.HORIZONTAL
    assert [(each.pitch, each.shift) for each in patterns][4:6] == [(100.0, 5), (20.0, 1)]
    assert rig.virtual_configuration().seed == 3
    steps = rig.programme.load_steps()
    assert [step.position for step in steps] == pytest.approx([0, 0.25e-3, 0.5e-3, 0.75e-3, 1e-3])
    assert steps[0].speed == pytest.approx(2e-3)


def test_its_calibration_is_that_of_the_twin(tmp_path):
    rig = load_rig_file(write(tmp_path, VIRTUAL))
    calibration = calibration_of(rig.virtual_configuration())
    for name, value in VirtualRig(rig.virtual_configuration()).optics().items():
        assert getattr(calibration, name) == (tuple(value) if isinstance(value, list) else value), name
    assert calibration == rig.rig_model


@pytest.mark.parametrize(
    ("size", "pitches"), [("full", [800, 160, 40, 10]), ("small", [200, 40, 10]), ("tiny", [100, 20])]
)
def test_default_pitches_follow_the_projector(tmp_path, size, pitches):
    text = changed(changed(VIRTUAL, "virtual_rig.size", size), "sequence.pitches_px", ...)
    assert load_rig_file(write(tmp_path, text)).pitches() == pitches


def test_calibration_in_the_file_is_translated_to_si(tmp_path):
    file = write(tmp_path, CALIBRATED)
    model = load_rig_file(file).rig_model
    assert (model.identifier, model.source) == ("bench 2", str(file))
    assert (model.camera_distance, model.pixel_size) == pytest.approx((0.4, 1e-4))
    assert model.projector_position == pytest.approx((-0.18, 0.0015, 0.38))
    assert model.projector_rotation == pytest.approx((math.radians(1), math.radians(-2), math.pi / 2))
    assert model.camera_tilt_x == pytest.approx(math.radians(2))
    assert (model.principal_column, model.principal_row) == (319.5, 239.5)
    assert (model.projector_principal_column, model.projector_principal_row) == (399.5, 310.0)


def test_a_calibration_file_can_be_named_or_pasted(tmp_path):
    file = write(tmp_path, CALIBRATED)
    model = replace(load_rig_file(file).rig_model, camera_first_column=64)
    model.to_yaml(tmp_path / "bench.yaml")
    named = write(tmp_path, changed(CALIBRATED, "calibration", "bench.yaml"), "named.yaml")
    assert load_rig_file(named).rig_model == RigModel.from_yaml(tmp_path / "bench.yaml")
    content = yaml.safe_load((tmp_path / "bench.yaml").read_text())
    pasted = write(tmp_path, changed(CALIBRATED, "calibration", content), "pasted.yaml")
    again = load_rig_file(pasted).rig_model
    assert again.projector_rotation == pytest.approx(model.projector_rotation)
    assert (again.camera_first_column, again.camera_first_row) == (64, -1)
    assert (again.source, again.camera_distance) == (model.source, pytest.approx(model.camera_distance))
    other = {**content, "sensor": "right"}
    with pytest.raises(ConfigurationError, match=r"calibration: .*its content has changed since it was written"):
        load_rig_file(write(tmp_path, changed(CALIBRATED, "calibration", other), "right.yaml"))
    pasted = write(tmp_path, changed(CALIBRATED, "calibration", other | {"edited": True}), "right.yaml")
    again = load_rig_file(pasted).rig_model
    assert again.sensor == "right", "not that of the rig file"
    assert again.identifier == f"{model.identifier} (edited by hand)"


def test_a_rig_with_another_calibration_has_its_model(tmp_path):
    rig = load_rig_file(write(tmp_path, VIRTUAL))
    other = replace(rig.rig_model, identifier="measured")
    other.to_yaml(tmp_path / "measured.yaml")
    assert rig.with_calibration(tmp_path / "measured.yaml").rig_model == RigModel.from_yaml(tmp_path / "measured.yaml")
    assert rig.rig_model.identifier != "measured"


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("camera.exposure_mss", 3, r"camera\.exposure_mss: unknown key; known are source, width, .*exposure_ms"),
        ("colour", "red", r"colour: unknown key; known are namespace, sensor, camera, projector"),
        ("sensor", "", r"sensor: it has to be a name of letters, digits .*that begins with a letter \(it is ''\)$"),
        ("sensor", "../left", r"sensor: it has to be a name of letters, .* \(it is '../left'\)$"),
        ("sensor", 2, r"sensor: Input should be a valid string \(it is 2\)$"),
        ("nodes.dic.windw", 24, r"nodes\.dic\.windw: unknown key; known are window, spacing"),
        ("nodes.dic.window", 4, r"nodes\.dic\.window: Input should be greater than or equal to 8 \(it is 4\)"),
        ("nodes.dic.window", "24", r"nodes\.dic\.window: Input should be a valid integer \(it is '24'\)"),
        ("nodes.dic.method", "optical flow", r"nodes\.dic\.method: Input should be 'dense' or 'zoi'"),
        ("camera.exposure_ms", math.nan, r"camera\.exposure_ms: Input should be a finite number \(it is nan\)"),
        ("camera.exposure_ms", 0, r"camera\.exposure_ms: Input should be greater than 0"),
        ("camera", ..., r"camera: is missing"),
        (
            "camera.source",
            "webcam",
            r"camera: source 'webcam' is unknown; known are virtual, files, video, aravis, v4l2, topic",
        ),
        ("camera.source", "aravis", r"camera: source: aravis needs width and height"),
        ("projector.source", "display", r"projector: source: display needs width and height"),
        ("load_frame.source", "machine", r"load_frame: source: machine needs the key file"),
        (
            "load_frame.file",
            "machine.yaml",
            r"load_frame: source: simulated does not use file; remove it: the section vir",
        ),
        ("load_frame", {"source": "machine", "file": 5}, r"load_frame\.file: Input should be a valid string"),
        ("camera.source", "files", r"camera: source: files needs the key files"),
        ("camera.width", 640, r"camera is 640x120 px, the virtual rig's camera has 160x120 px"),
        ("sequence.pitches_px", [20, 100], r"sequence: pitches_px must become smaller"),
        ("sequence.shifts", 2, r"sequence\.shifts\.0: Input should be greater than or equal to 3"),
        ("namespace", "my rig", r"namespace: String should match pattern"),
        ("virtual_rig", ..., r"camera\.source: virtual needs the section virtual_rig, for example"),
        ("virtual_rig.preset", "wood", r"virtual_rig: preset 'wood' is unknown; choose from plate, skin"),
        (
            "nodes.coupling",
            {"watch_region_px": [0, 0, 8, 8]},
            r"nodes\.coupling\.watch_region_px is replaced by nodes\.coupling\.drift_marker_px",
        ),
        (
            "extensometer",
            {"first_px": [1, 2], "second_px": [3, 4], "pad_px": 48},
            r"extensometer\.pad_px is replaced by extensometer\.subset_px",
        ),
        (
            "specimen",
            {"extensometers_px": [[1, 2, 3, 4]]},
            r"specimen: extensometers_px with the order \[row, column, row, column\] is replaced by gauges_px with the "
            r"order \[column, row\]",
        ),
        ("calibration", "nowhere.yaml", r"calibration: there is no file .*nowhere\.yaml"),
        ("programme.steps", [{"position_mm": 0.0}], r"programme: give either steps, ramp or continuous"),
        ("programme.ramp.steps", 1, r"programme\.ramp\.steps: Input should be greater than or equal to 2"),
        ("programme.experiment", "a/b", r"programme\.experiment: String should match pattern"),
    ],
)
def test_what_is_wrong_is_named_with_file_and_key(tmp_path, path, value, message):
    file = write(tmp_path, changed(VIRTUAL, path, value))
    with pytest.raises(ConfigurationError, match=f"^{file}: .*{message}"):
        load_rig_file(file)


MACHINE = {"source": "machine", "file": "machine.yaml"}
V4L2 = {"source": "v4l2", "camera": "/dev/video0", "width": 640, "height": 480}
TOPIC = {"source": "topic", "topic": "/cam/image_raw", "width": 640, "height": 480}


@pytest.mark.parametrize(
    ("section", "content", "message"),
    [
        ("load_frame", MACHINE | {"force_sign": -1}, r"source: machine does not use force_sign; .*negative scale"),
        ("load_frame", MACHINE | {"motion_span_s": 1.0}, r"does not use motion_span_s; .*machine file"),
        ("load_frame", {"source": "simulated", "joint": "ram"}, r"source: simulated does not use joint; .*virtual_rig"),
        ("load_frame", {"source": "external", "position_tolerance_mm": 0.1}, r"does not use position_tolerance_mm"),
        ("load_frame", {"source": "external", "force_sign": -1}, r"does not use force_sign; .*specimen\.force_sign"),
        (
            "camera",
            V4L2 | {"gain_db": 6.0, "trigger": "external_edge", "first_row": 200},
            r"source: v4l2 does not use first_row, gain_db, trigger; .*v4l2-ctl",
        ),
        ("camera", TOPIC | {"packet_size_byte": 1500}, r"does not use packet_size_byte; .*driver"),
        ("camera", {"source": "virtual", "stamp_of": "start"}, r"does not use stamp_of; .*virtual_rig"),
        ("camera", {"source": "files", "files": "a", "camera": "b"}, r"source: files does not use camera"),
        ("projector", {"source": "virtual", "display": 1}, r"source: virtual does not use display"),
    ],
)
def test_a_key_of_another_source_is_refused(tmp_path, section, content, message):
    """A machine that counts tension as negative was measured with the wrong sign, in spite of force_sign."""
    with pytest.raises(ConfigurationError, match=f"RIG.yaml: {section}: .*{message}"):
        load_rig_file(write(tmp_path, changed(VIRTUAL, section, content)))


def test_a_key_of_another_source_may_have_its_default_value(tmp_path):
    """Files that state every key stay valid, and a source can be exchanged in them."""
    sections = {"load_frame": {"force_sign": 1, **MACHINE}, "camera": {"trigger": "software", "gain_db": 0, **TOPIC}}
    text = VIRTUAL
    for section, content in sections.items():
        text = changed(text, section, content)
    rig = load_rig_file(write(tmp_path, text))
    assert (rig.load_frame.source, rig.camera.source) == ("machine", "topic")


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (
            "calibration.camera.distance",
            3,
            r"calibration\.camera\.distance: unknown key; known are width_px, height_px",
        ),
        ("calibration.camera.distance_mm", ..., r"calibration\.camera\.distance_mm: is missing"),
        ("calibration.projector.position_mm", [1.0, 2.0], r"calibration\.projector\.position_mm: .*at least 3"),
        ("calibration.camera.pixel_size_mm", 0.0, r"calibration\.camera\.pixel_size_mm: .*greater than 0"),
        ("calibration.projector.position_mm", [1.0, 2.0, -3.0], r"the projector has to be above the reference plane"),
    ],
)
def test_a_wrong_calibration_is_named_with_file_and_key(tmp_path, path, value, message):
    file = write(tmp_path, changed(CALIBRATED, path, value))
    with pytest.raises(ConfigurationError, match=f"^{file}: .*{message}"):
        load_rig_file(file)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty or has no 'key: value'; keys are namespace, sensor, camera"),
        ("a: [1", "is not YAML"),
        ("- a", "is empty"),
    ],
)
def test_files_that_are_no_rig_files(tmp_path, text, message):
    with pytest.raises(ConfigurationError, match=message):
        load_rig_file(write(tmp_path, text))


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(ConfigurationError, match="cannot be read: No such file"):
        load_rig_file(tmp_path / "nothing.yaml")


def test_a_programme_can_be_written_out(tmp_path):
    steps = "[{position_mm: 0}, {position_mm: 0.5, mode: white, hold_s: 2}, {set_reference: true}]"
    text = f"experiment: skin\nsteps: {steps}"
    programme = load_programme(write(tmp_path, text))
    first, second, third = programme.load_steps()
    assert (first.position, first.mode, first.set_reference) == (0.0, "fringes", False)
    assert (second.position, second.mode, second.hold_s) == (pytest.approx(0.5e-3), "white", 2.0)
    assert (third.position, third.set_reference) == (None, True)
    assert Programme(ramp={"from_mm": 1.0, "to_mm": 0.0, "steps": 3}).load_steps()[1].position_mm == 0.5
    repeated = Programme(ramp={"from_mm": 1.0, "to_mm": 2.0, "steps": 3, "repeats_at_rest": 2}).load_steps()
    assert [step.position_mm for step in repeated] == [1.0, 1.0, 1.0, 1.5, 2.0]


def test_a_wrong_step_is_named(tmp_path):
    with pytest.raises(
        ConfigurationError, match=r"steps\.1\.speed: unknown key; known are position_mm, speed_mm_per_s"
    ):
        load_programme(write(tmp_path, "steps: [{position_mm: 0}, {position_mm: 1, speed: 3}]"))


def test_a_gray_code_can_tell_the_orders(tmp_path):
    coded = VIRTUAL.replace("shifts: 5,", "shifts: 5, fringe_order: gray_code,")
    patterns = load_rig_file(write(tmp_path, coded)).patterns()
    assert [each.kind for each in patterns] == [PatternKind.GRAY_CODE] * 4 + [PatternKind.FRINGES] * 5
    assert {(each.pitch, each.orientation) for each in patterns} == {(20.0, Orientation.HORIZONTAL)}


def test_one_image_has_to_be_wanted(tmp_path):
    one = VIRTUAL.replace("shifts: 5,", "shifts: 5, fringe_order: one_image, grey_frame: true,")
    with pytest.raises(ConfigurationError, match=r"set nodes\.phase\.relative_phase: accept"):
        load_rig_file(write(tmp_path, one))
    patterns = load_rig_file(write(tmp_path, changed(one, "nodes.phase.relative_phase", "accept"))).patterns()
    assert [(each.kind, each.pitch) for each in patterns] == [(PatternKind.GREY, 0.0), (PatternKind.FRINGES, 20.0)]


def test_nodes_that_do_not_run_share_no_process(tmp_path):
    composed = changed(VIRTUAL, "nodes.composed", True)
    load_rig_file(write(tmp_path, composed))
    with pytest.raises(ConfigurationError, match=r"nodes\.composed: true .* recording\.process: false"):
        load_rig_file(write(tmp_path, changed(composed, "recording.process", False)))


def test_every_pattern_is_taken_at_every_exposure_time(tmp_path):
    exposed = VIRTUAL.replace("shifts: 5,", "shifts: 5, exposures_ms: [4.0, 16.0],")
    rig, once = (load_rig_file(write(tmp_path, text)) for text in (exposed, VIRTUAL))
    assert rig.sequence.exposure_times == [0.004, 0.016]
    assert rig.patterns() == [each for each in once.patterns() for _ in range(2)]
    with pytest.raises(ConfigurationError, match="exposures_ms must differ"):
        load_rig_file(write(tmp_path, exposed.replace("16.0", "4.0")))


def test_the_noise_floor_of_its_file_is_recorded(tmp_path):
    noise = NoiseFloorMetadata(steps=3, window_px=24, spatial={"displacement_x_px": 0.01})
    (tmp_path / "noise.yaml").write_text(yaml.safe_dump(noise.model_dump()))
    path = write(tmp_path, VIRTUAL + "noise_floor_file: noise.yaml\n")
    recorded = Metadata.from_text(load_rig_file(path).metadata().to_text())
    assert recorded.noise == noise
    (tmp_path / "noise.yaml").write_text("window: 3")
    with pytest.raises(ConfigurationError, match="no noise floor"):
        load_rig_file(path).metadata()
