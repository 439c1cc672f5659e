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
    "experiment": "fringedic.settings.experiment:ExperimentNodeSettings",
    "extensometer": "fringedic.settings.extensometer:ExtensometerNodeSettings",
    "live_view": "camera_node.live_view_node:LiveViewParameters",
    "load_frame": "fringedic.settings.load_frame:LoadFrameNodeSettings",
    "operator": "operator_node.operator_node:OperatorParameters",
    "phase": "fringedic.steps.parameters:PhaseParameters",
    "player": "player_node.player_node:PlayerParameters",
    "projector": "fringedic.settings.projector:ProjectorNodeSettings",
    "recorder": "fringedic.settings.recorder:RecorderNodeSettings",
    "signals": "fringedic.settings.signals:SignalsNodeSettings",
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
