"""The pages of the nodes list their parameters as they are declared."""

from __future__ import annotations

from pathlib import Path

import pytest

from fringedic_ros.parameter_docs import documented

PAGES = Path(__file__).parents[4] / "docs" / "nodes"
DECLARATIONS = {
    "camera": "fringedic.settings.camera:CameraNodeSettings",
    "coupling": "fringedic.steps.parameters:CouplingParameters",
    "dic": "fringedic.steps.parameters:DicParameters",
    "experiment": "experiment_node.experiment_parameters:ExperimentParameters",
    "extensometer": "dic_node.extensometer_node:ExtensometerParameters",
    "live_view": "camera_node.live_view_node:LiveViewParameters",
    "load_frame": "load_frame_node.load_frame_node:LoadFrameParameters",
    "operator": "operator_node.operator_node:OperatorParameters",
    "phase": "fringedic.steps.parameters:PhaseParameters",
    "player": "player_node.player_node:PlayerParameters",
    "projector": "fringe_projector_node.projector_node:ProjectorParameters",
    "recorder": "recorder_node.recorder_node:RecorderParameters",
    "stage": "load_frame_node.stage_node:StageParameters",
}


@pytest.mark.parametrize(("page", "declaration"), DECLARATIONS.items(), ids=DECLARATIONS)
def test_page_is_up_to_date(page: str, declaration: str) -> None:
    path = PAGES / f"{page}.md"
    text = path.read_text()
    assert f"<!-- parameters: {declaration} -->" in text
    assert documented(text) == text, f"run python -m fringedic_ros.parameter_docs {path}"


def test_each_node_has_a_page() -> None:
    assert {path.stem for path in PAGES.glob("*.md")} == {"index", *DECLARATIONS}
