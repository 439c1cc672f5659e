"""A command goes on with the run of an earlier one: alone in its folder, and with the same settings."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from fringedic.configuration.programme import Programme
from fringedic.configuration.rig_file import load_rig_file
from fringedic.errors import ConfigurationError
from fringedic.frames.region import Region
from fringedic.recording import BagWriter
from fringedic_bringup.launch.graph import Graph, rig_graph
from fringedic_bringup.procedures.continuing import (
    RecordedSteps,
    continued,
    folder_of_one_command,
    recorded_steps,
    require_same_calibration,
    require_same_messages,
    require_same_settings,
)

RECORDED = Path(__file__).parents[2] / "fringedic" / "test" / "recordings" / "version_0_1" / "bag"
TINY = Path(__file__).parents[1] / "config" / "tiny.yaml"


def graph_of(folder: Path, **sections: object) -> Graph:
    """Return the nodes of the tiny rig with some sections of its file replaced."""
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load(TINY.read_text()) | sections))
    return rig_graph(load_rig_file(path), path, folder / "run", experiment="tiny")


def test_a_folder_belongs_to_one_command(tmp_path: Path) -> None:
    refused = pytest.raises(ConfigurationError, match="run is in use by another command")
    with folder_of_one_command(tmp_path / "run"), refused, folder_of_one_command(tmp_path / "run"):
        pass
    with folder_of_one_command(tmp_path / "run"):
        pass


@pytest.mark.parametrize(
    ("sections", "named"),
    [
        ({"sequence": {"pitches_px": [100.0, 20.0, 10.0], "shifts": 4}}, "experiment.pitches_px"),
        ({"nodes": {"dic": {"window": 24}}}, "dic.window"),
        ({"camera": {"source": "virtual", "exposure_ms": 12.0}}, "camera.exposure_ms"),
        ({"load_frame": {"source": "simulated", "rate_hz": 50.0}}, ""),
    ],
)
def test_settings_that_change_results_are_those_of_the_first_steps(
    sections: dict[str, object], named: str, tmp_path: Path
) -> None:
    logs = tmp_path / "run" / "logs"
    first = graph_of(tmp_path)
    logs.mkdir()
    for node in first.nodes:
        node.write_parameters(logs)
    require_same_settings(first, logs)
    changed = graph_of(tmp_path, **sections)
    if not named:
        require_same_settings(changed, logs)
        return
    with pytest.raises(ConfigurationError, match=rf"not those of its first steps \({named}\); undo the change"):
        require_same_settings(changed, logs)


@pytest.mark.parametrize("measured", [[0, 1, 3], []])
def test_the_first_step_after_measured_ones_takes_the_place_of_the_reference(
    measured: list[int], tmp_path: Path
) -> None:
    """Its nodes do not have the reference, which the recording still has; before the first one nothing is lost."""
    sensors = frozenset({""} if measured else ())
    graph = continued(graph_of(tmp_path), tmp_path / "run" / "bag", RecordedSteps(measured, 3, len(measured), sensors))
    parameters = {node.name: node.parameters for node in graph.nodes}
    assert (parameters["experiment"]["first_step"], parameters["experiment"]["reference_lost"]) == (4, bool(measured))


def test_a_refused_graph_leaves_the_calibration_of_the_run(tmp_path: Path) -> None:
    """It was replaced, so that the next attempt went on with another calibration."""
    graph_of(tmp_path)
    file = tmp_path / "run" / "calibration.yaml"
    file.write_text("of the first steps")
    Region(Region.rectangle((40, 30), (120, 90)).polygons, 640, 480).save(tmp_path / "part.png")
    with pytest.raises(ConfigurationError, match="drawn in an image of 640x480 px"):
        graph_of(tmp_path, region_file="part.yaml")
    assert file.read_text() == "of the first steps"


def test_settings_of_a_later_measurement_are_those_of_the_first_steps(tmp_path: Path) -> None:
    logs = tmp_path / "run" / "logs"
    recorded = {"recording": {"process": False}}
    first = graph_of(tmp_path, **recorded)
    logs.mkdir()
    for node in first.nodes:
        node.write_parameters(logs)
    require_same_settings(first, logs)
    with pytest.raises(ConfigurationError, match=r"not those of its first steps \(nodes, region_file or"):
        require_same_settings(graph_of(tmp_path, **recorded, nodes={"dic": {"window": 24}}), logs)


@pytest.mark.parametrize("content", ["", "{", "- 5", "/**: {ros__parameters: 5}", "window: 10"])
def test_a_damaged_file_of_the_settings_is_named(content: str, tmp_path: Path) -> None:
    graph, logs = graph_of(tmp_path), tmp_path / "run" / "logs"
    logs.mkdir()
    (logs / "dic.yaml").write_text(content)
    with pytest.raises(ConfigurationError, match=r"dic\.yaml is damaged"):
        require_same_settings(graph, logs)


def test_the_namespace_is_that_of_the_first_steps() -> None:
    """The recording would contain two rigs, so that no step could be processed."""
    programme = Programme.model_validate({"experiment": "plate", "steps": [{"position_mm": 0.0}] * 5})
    assert recorded_steps(RECORDED, programme, {"": "rig"}).measured == [0, 1, 2]
    for other in ("rig2", "", "laboratory/rig"):
        with pytest.raises(ConfigurationError, match=f"named /rig/experiment/step, .* namespace .* is '{other}'"):
            recorded_steps(RECORDED, programme, {"": other})


def test_messages_are_those_of_the_first_steps(tmp_path: Path) -> None:
    """The parts of the recording could not be joined after the test."""
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/rig/experiment/step", "fringedic_msgs/msg/StepStatus")
    require_same_messages(tmp_path / "bag")
    with pytest.raises(ConfigurationError, match=r"other messages \(fringedic_msgs/msg/\w+\); start a new run"):
        require_same_messages(RECORDED)


def test_another_calibration_is_refused_and_the_first_one_stays(tmp_path: Path) -> None:
    graph_of(tmp_path)
    file = tmp_path / "run" / "calibration.yaml"
    first = file.read_text()
    graph_of(tmp_path)
    require_same_calibration(file, first)
    file.write_text(f"{first}# another one\n")
    with pytest.raises(ConfigurationError, match=r"not that of its first steps, calibration\.yaml"):
        require_same_calibration(file, first)
    assert file.read_text() == first
