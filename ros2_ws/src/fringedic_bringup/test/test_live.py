"""`fringedic live`: its display of known figures, and the command with real nodes on the virtual rig."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from rich.console import Console

from fringedic.configuration.rig_file import load_rig_file
from fringedic_bringup.display.live import block, drawing, sparkline
from fringedic_bringup.launch.graph import live_graph
from fringedic_bringup.setup_patterns import LivePattern
from fringedic_msgs.msg import LiveView

TINY = Path(__file__).parent.parent / "config" / "tiny.yaml"


def figures(**changes: float) -> LiveView:
    """Figures of a good view: 8 bits, grey levels from 40 to 200."""
    histogram = np.zeros(256, int)
    histogram[40:200] = 100
    values = {"focus": 0.874, "mean": 120.0, "speckle_size": 4.2, "modulation": 60.0, "noise": 1.8, "full_scale": 255.0}
    return LiveView(histogram=histogram.tolist(), width=640, height=480, **(values | changes))


def test_block_has_one_line_per_figure() -> None:
    text = block(figures(), LivePattern.FRINGES, "bench")
    assert "focus       87 % of best" in text
    assert "speckles    4.2 px: good (3 to 7 px)" in text
    assert max(len(line) for line in text.splitlines()) < 80


def test_drawing_is_large() -> None:
    console = Console(width=100, force_terminal=False)
    with console.capture() as capture:
        console.print(drawing(figures(), LivePattern.WHITE, "bench"))
    text = capture.get()
    assert "██████  ██████" in text, "digits of five lines"
    assert "█" * 70 + "░" * 10 in text, "the bar of 87 %"
    assert "FRINGES" not in text
    spark = sparkline(figures().histogram, 80)
    assert len(spark) == 80
    assert spark[:12].isspace()
    assert "█" in spark


def test_nodes_of_the_live_view() -> None:
    graph = live_graph(load_rig_file(TINY), [8, 8, 64, 48])
    assert sorted(graph.names) == ["camera", "live_view", "projector", "stage"]
    view = next(node for node in graph.nodes if node.name == "live_view")
    assert view.parameters == {"full_scale_grey_level": 255.0, "region_px": [8, 8, 64, 48]}


def test_command_prints_the_figures_of_a_rig() -> None:
    program = "from fringedic.command.main import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program, "live", str(TINY), "--pattern", "fringes", "--region", "8,8,128,96"],
        env=dict(os.environ),
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "tiny, projector shows fringes: 128x96 px from column 8, row 8" in done.stdout
    printed = {line[:12].strip(): line[12:] for line in done.stdout.splitlines()[1:]}
    assert 90 <= int(printed["focus"].split()[0]) <= 100
    assert float(printed["noise"].split()[0]) > 0.5
    assert float(printed["fringes"].split()[1]) > 20
