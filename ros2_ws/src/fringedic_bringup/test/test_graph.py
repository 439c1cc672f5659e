"""From a rig file to the nodes and their parameters."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from fringedic.configuration.rig_file import load_rig_file
from fringedic.configuration.rig_sensors import load_rig_sensors
from fringedic.errors import ConfigurationError
from fringedic.rig.model import RigModel
from fringedic.sensors.poses import SensorPose
from fringedic.sensors.registration import Registration
from fringedic.settings.parameters import from_parameters
from fringedic.settings.signals import SignalsNodeSettings, signal_settings
from fringedic_bringup.launch.graph import calibration_graph, exposing_graph, live_graph, projecting_graph, rig_graph
from fringedic_bringup.launch.launch_arguments import LaunchArguments, launched_rig

CONFIG = Path(__file__).parents[1] / "config"
REAL_RIG = """
namespace: bench
camera: {source: aravis, camera: 192.168.1.20, width: 1280, height: 960, first_row: 64, exposure_ms: 16.7, gain_db: 3}
projector: {source: display, display: 1, width: 1920, height: 1080}
sequence: {pitches_px: [1920, 120, 20], shifts: 4}
load_frame: {source: machine, file: frame.yaml, rate_hz: 500, position_tolerance_mm: 0.02, hold_required: false,
  load_drift_n: 2.5}
"""


def test_real_devices_get_the_parameters_of_the_rig_file(tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    path.write_text(REAL_RIG)
    graph = rig_graph(load_rig_file(path), path, tmp_path / "out", experiment="tension")
    nodes = {node.name: dict(node.parameters) for node in graph.nodes}
    assert graph.namespace == "bench"
    assert "stage" not in nodes, "the stage belongs to the virtual rig"
    camera = nodes["camera"]
    assert camera["source"] == "aravis"
    region = [camera[name] for name in ("first_column", "first_row", "width", "height")]
    assert (camera["camera"], region) == ("192.168.1.20", [0, 64, 1280, 960])
    experiment = nodes["experiment"]
    assert (experiment["camera_first_column_px"], experiment["camera_first_row_px"]) == (0, 64)
    assert (camera["exposure_ms"], camera["gain_db"], camera["trigger"]) == (16.7, 3.0, "software")
    projector = {"source": "display", "display": 1, "width": 1920, "height": 1080}
    assert projector.items() <= nodes["projector"].items()
    file = str(tmp_path / "frame.yaml")
    machine = {"source": "machine", "rate_hz": 500.0, "position_tolerance_mm": 0.02, "file": file}
    assert machine.items() <= nodes["load_frame"].items()
    assert (experiment["hold_required"], experiment["load_drift_n"]) == (False, 2.5)
    assert "hold_required" not in nodes["load_frame"], "a parameter of the experiment node"
    again = {node.name: node.changes_at_restart for node in graph.nodes if node.changes_at_restart}
    assert again == {"load_frame": {"machine_required": False}}, "a machine that does not answer does not end it again"


def test_signals_have_a_node_and_a_required_one_is_one_of_the_experiment(tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    declared = """
signals:
  grip: {topic: /thermo/temperature, field: temperature, unit: degC, required: true}
  meter: {source: instrument, file: meter.yaml, required: true}
"""
    queries = "{torque: {query: 'T?', unit: Nm}, angle: {query: 'A?', unit: deg}}"
    (tmp_path / "meter.yaml").write_text(f"protocol: scpi\nresource: ASRL/dev/ttyS9\nsignals: {queries}\n")
    path.write_text(REAL_RIG + declared)
    rig = load_rig_file(path)
    nodes = {node.name: dict(node.parameters) for node in rig_graph(rig, path, tmp_path / "out").nodes}
    assert nodes["experiment"]["required_signals"] == ["grip", "torque", "angle"]
    settings = from_parameters(SignalsNodeSettings, nodes["signals"])
    assert settings.signals["meter"]["file"] == str(tmp_path / "meter.yaml")
    assert signal_settings(settings.signals) == rig.signals
    calibrating = {node.name: node.parameters for node in calibration_graph(rig, tmp_path / "out").nodes}
    assert "signals" not in calibrating
    assert "required_signals" not in calibrating["experiment"]
    path.write_text(REAL_RIG)
    assert "signals" not in [node.name for node in rig_graph(load_rig_file(path), path, tmp_path / "out").nodes]


@pytest.mark.parametrize(
    ("digits", "own", "level"),
    [("Mono12", "", 4095.0), ("Mono10", "", 1023.0), ("Mono8", "", 0.0), ("Mono16", "", 0.0), ("Mono12", "900", 900.0)],
)
def test_phase_knows_the_grey_level_of_saturated_pixels(digits: str, own: str, level: float, tmp_path: Path) -> None:
    """Images of 12 bits have the type of 16, so that no saturated pixel was found."""
    path = tmp_path / "bench.yaml"
    text = REAL_RIG.replace("source: aravis,", f"source: aravis, pixel_format: {digits},")
    path.write_text(text + (f"nodes: {{phase: {{saturation_grey_level: {own}}}}}\n" if own else ""))
    rig = load_rig_file(path)
    for graph in (rig_graph(rig, path, tmp_path / "out"), calibration_graph(rig, tmp_path / "out")):
        [phase] = [node.parameters for node in graph.nodes if node.name == "phase"]
        assert phase["saturation_grey_level"] == level


@pytest.mark.parametrize("source", ["topic, topic: /cam/image_raw", "files, files: images", "video, files: test.mkv"])
@pytest.mark.parametrize(("digits", "level"), [(", pixel_format: Mono12", 4095.0), ("", 0.0)])
def test_stored_and_foreign_images_saturate_at_the_stated_bits(
    source: str, digits: str, level: float, tmp_path: Path
) -> None:
    path = tmp_path / "bench.yaml"
    path.write_text(
        f"camera: {{source: {source}{digits}, width: 640, height: 480}}\n"
        "projector: {source: display, width: 640, height: 480}\nsequence: {pitches_px: [640, 80, 20], shifts: 4}\n"
    )
    rig = load_rig_file(path)
    [phase] = [node.parameters for node in rig_graph(rig, path, tmp_path / "out").nodes if node.name == "phase"]
    assert phase["saturation_grey_level"] == level


def test_processing_nodes_share_a_process_when_the_rig_file_composes_them(tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    path.write_text(REAL_RIG + "nodes: {composed: true, dic: {window: 24}}\n")
    graph = rig_graph(load_rig_file(path), path, tmp_path / "out")
    assert [node.name for node in graph.processes["processing"]] == ["phase", "dic", "coupling"]
    assert [name for name, nodes in graph.processes.items() if len(nodes) == 1] == [
        name for name in graph.names if name not in ("phase", "dic", "coupling")
    ]
    dic = next(node for node in graph.nodes if node.name == "dic")
    assert yaml.safe_load(dic.write_parameters(tmp_path).read_text())["/**/dic"]["ros__parameters"]["window"] == 24
    assert dic.changed_parameters(tmp_path) == set()


def test_a_part_of_a_shared_process_is_refused(tmp_path: Path) -> None:
    arguments = LaunchArguments(rig="tiny", folder=str(tmp_path / "run"), composed=True, nodes="camera,dic")
    with pytest.raises(ConfigurationError, match="phase, dic, coupling share the process processing; name all of them"):
        launched_rig(arguments)


def test_a_calibration_needs_absolute_phases(tmp_path: Path) -> None:
    """All planes could be wrong by the same number of fringes, which a fit takes for the place of the projector."""
    path = tmp_path / "bench.yaml"
    path.write_text(REAL_RIG + "nodes: {phase: {relative_phase: accept}}\n")
    graph = calibration_graph(load_rig_file(path), tmp_path / "out")
    [phase] = [node.parameters for node in graph.nodes if node.name == "phase"]
    assert phase["relative_phase"] == "refuse"


def test_recorder_gets_the_limits_of_its_files(tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    for section, split in (
        ("", (0.0, 0.0)),
        ("recording: {split_gb: 4}\n", (4.0, 0.0)),
        ("recording: {split_minutes: 2.5}\n", (0.0, 2.5)),
    ):
        path.write_text(REAL_RIG + section)
        rig = load_rig_file(path)
        graph = rig_graph(rig, path, tmp_path / "out", experiment="tension")
        recorder = next(node.parameters for node in graph.nodes if node.name == "recorder")
        assert (recorder["split_gb"], recorder["split_minutes"]) == split
        limits = rig.recording.split
        assert (limits.size, limits.duration) == (1e9 * split[0] or math.inf, 60 * split[1] or math.inf)


def test_other_cameras_get_the_parameters_of_the_rig_file(tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    size = "width: 640, height: 480"
    for section, expected in (
        (
            f"source: v4l2, camera: /dev/video2, stamp_of: start, {size}",
            {"camera": "/dev/video2", "stamp_of": "start", "width": 640, "height": 480, "pixel_format": "Mono8"},
        ),
        (f"source: topic, topic: /cam/image_raw, {size}", {"topic": "/cam/image_raw", "stamp_of": "end"}),
        ("source: video, files: test.mkv", {"files": str(tmp_path / "test.mkv")}),
    ):
        camera_line = next(line for line in REAL_RIG.splitlines() if line.startswith("camera:"))
        path.write_text(REAL_RIG.replace(camera_line, f"camera: {{{section}}}"))
        graph = rig_graph(load_rig_file(path), path, tmp_path / "out", experiment="tension")
        camera = dict(next(node.parameters for node in graph.nodes if node.name == "camera"))
        assert expected.items() <= camera.items()


def test_controller_gets_its_topics(tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    path.write_text(
        REAL_RIG.replace("source: machine, file: frame.yaml", "source: controller, joint: ram, force_sign: -1")
    )
    graph = rig_graph(load_rig_file(path), path, tmp_path / "out", experiment="tension")
    load_frame = dict(next(node.parameters for node in graph.nodes if node.name == "load_frame"))
    expected = {"source": "controller", "rate_hz": 500.0, "wrench_topic": "/wrench", "joint": "ram", "force_sign": -1}
    assert expected.items() <= load_frame.items()


def test_extensometer_gets_its_pads_a_free_run_and_white_light(tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    path.write_text(REAL_RIG + "extensometer: {first_px: [320, 480], second_px: [960, 470], rate_hz: 20}\n")
    graph = rig_graph(load_rig_file(path), path, tmp_path / "out", experiment="tension")
    nodes = {node.name: dict(node.parameters) for node in graph.nodes}
    assert nodes["extensometer"] == {
        "first_px": [320, 480],
        "second_px": [960, 470],
        "subset_px": 48,
        "largest_sigma_ustrain": 1e3,
        "frame_timeout_s": 0.15,
    }
    assert nodes["camera"]["frame_rate_hz"] == 20
    assert nodes["experiment"]["white_between_steps"] is True


def test_every_node_gets_the_frame_prefix_of_the_rig_file(tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    for prefix, expected in (("", None), ("frame_prefix: left\n", "left"), ('frame_prefix: ""\n', "")):
        path.write_text(REAL_RIG + prefix)
        rig = load_rig_file(path)
        for graph in (rig_graph(rig, path, tmp_path / "out"), live_graph(rig), exposing_graph(rig)):
            assert {node.parameters.get("frame_prefix") for node in graph.nodes} == {expected}


def test_a_named_sensor_is_a_namespace_of_its_nodes_which_know_it(tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    for key, namespace, expected in (("sensor: left\n", "bench/left", "left"), ("sensor: sensor\n", "bench", None)):
        path.write_text(REAL_RIG + key)
        rig = load_rig_file(path)
        for graph in (rig_graph(rig, path, tmp_path / "out"), live_graph(rig), projecting_graph(rig)):
            assert graph.namespace == namespace
            assert {node.parameters.get("sensor") for node in graph.nodes} == {expected}


def test_the_calibration_of_a_run_has_the_name_of_its_sensor_and_one_of_another_is_refused(tmp_path: Path) -> None:
    path, virtual = tmp_path / "rig.yaml", CONFIG / "tiny.yaml"
    path.write_text(virtual.read_text() + "sensor: left\n")
    graph = rig_graph(load_rig_file(path), path, tmp_path / "out")
    file = tmp_path / "out" / "calibration.left.yaml"
    assert {node.name: node.parameters.get("calibration_file") for node in graph.nodes}["experiment"] == str(file)
    assert RigModel.from_yaml(file).sensor == "left"
    others = path.read_text().replace("calibration: virtual_rig", f"calibration: {file}").replace("left\n", "right\n")
    path.write_text(others)
    with pytest.raises(ConfigurationError, match=r"that of the sensor 'left', this is the sensor 'right': use the cal"):
        rig_graph(load_rig_file(path), path, tmp_path / "again")


def test_sensors_have_their_own_nodes_and_one_load_frame(tmp_path: Path) -> None:
    path = CONFIG / "two_sensors.yaml"
    left, right = load_rig_sensors(path).rigs
    pose = SensorPose((0.0, 0.1, 0.0), (0.03, 0.0, 0.0))
    registration = Registration(
        reference="left",
        poses={"left": SensorPose(), "right": pose},
        covariance=np.eye(6),
        directions={},
        shared={},
        calibrations={},
        chi_square=0.0,
        freedom=0,
        residuals=(),
    )
    graph = rig_graph(left, path, tmp_path, others=[right], registration=registration)
    nodes = {node.name: node for node in graph.nodes}
    own = ("phase", "dic", "coupling", "projector", "stage", "camera", "experiment")
    assert list(nodes) == ["recorder", "load_frame", *(f"{sensor}/{name}" for sensor in graph.sensors for name in own)]
    assert nodes["recorder"].parameters["sensors"] == graph.sensors == ["left", "right"]
    assert nodes["load_frame"].remappings == {}
    assert nodes["load_frame"].parameters["frame_prefix"] == "rig/left"
    assert nodes["right/experiment"].remappings["load_frame/state"] == "/rig/load_frame/state"
    placed = {name: nodes[f"{name}/experiment"].parameters for name in graph.sensors}
    assert placed["left"]["common_frame"] == ""
    assert placed["right"]["common_frame"] == "rig/left/reference_plane"
    assert placed["right"]["pose_in_common_frame"] == [0.03, 0.0, 0.0, 0.0, 0.1, 0.0]
    assert all(each["dark_between_steps"] for each in placed.values())
    assert {file.name for file in tmp_path.glob("calibration*")} == {"calibration.left.yaml", "calibration.right.yaml"}
    file = nodes["right/phase"].write_parameters(tmp_path)
    assert file == tmp_path / "right" / "phase.yaml"
    assert nodes["right/phase"].changed_parameters(tmp_path) == set()
