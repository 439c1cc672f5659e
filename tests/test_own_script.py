"""The script of the page on the command, with the nodes of the tiny rig."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from running_system import CONFIG, ROOT

from fringedic.recording.reader import BagReader
from fringedic_bringup.launch.graph import rig_graph
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.procedures.run import load_rig


@pytest.mark.slow
def test_the_printed_script_moves_and_measures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = (ROOT / "docs" / "command.md").read_text()
    (script,) = re.findall(r"```python\n(from fringedic_bringup\.client import RigClient.*?)```", page, re.DOTALL)
    rig, _ = load_rig(CONFIG / "tiny.yaml", None, None)
    with RunningGraph(rig_graph(rig, CONFIG / "tiny.yaml", tmp_path, experiment="script"), tmp_path / "logs"):
        exec(script, {})
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [line[0] for line in lines] == ["0", "1", "2"]
    forces = [float(line[1]) for line in lines]
    assert forces == pytest.approx([0, 200, 400], abs=60), "the plate's grips are 2000 N/mm stiff, with some play"
    assert float(lines[2][3]) > float(lines[1][3]) > 0
    recorded = BagReader(tmp_path / "bag")
    (states,) = recorded.find("load_frame/state").values()
    last = [message for _, message, _ in recorded.messages([states])][-1]
    assert 500 < last.force < 650
    assert last.position < 0.45e-3, "the move to a force ended before its position"
