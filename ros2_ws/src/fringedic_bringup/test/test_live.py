"""`fringedic live`: what it says of known figures, and the command through real nodes on the virtual rig."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from fringedic.errors import RigFileError
from fringedic.rig_file import load_rig_file
from fringedic_bringup.graph import live_graph
from fringedic_bringup.live import show_live
from fringedic_bringup.live_display import Pattern, block, drawing, sparkline, words
from fringedic_msgs.msg import LiveView

TINY = Path(__file__).parent.parent / "config" / "tiny.yaml"


def figures(**changes: float) -> LiveView:
    """Figures of a good view: 8 bits, grey levels from 40 to 200."""
    histogram = np.zeros(256, int)
    histogram[40:200] = 100
    values = {"focus": 0.874, "mean": 120.0, "speckle_size": 4.2, "modulation": 60.0, "noise": 1.8, "full_scale": 255.0}
    return LiveView(histogram=histogram.tolist(), width=640, height=480, **(values | changes))


def test_a_good_view_needs_nothing() -> None:
    assert all(line.good for line in words(figures(), Pattern.FRINGES))
    text = block(figures(), Pattern.FRINGES, "bench")
    assert "focus       87 % of best" in text
    assert "4.2 px: good (3 to 7 px)" in text


@pytest.mark.parametrize(
    ("changes", "name", "advice"),
    [
        ({"saturated": 0.02}, "saturated", "expose less"),
        ({"dark": 0.3}, "black", "more light"),
        ({"speckle_size": 1.9}, "speckles", "alias"),
        ({"speckle_size": 12.0}, "speckles", "finer pattern"),
        ({"speckle_size": float("nan")}, "speckles", "no pattern"),
        ({"modulation": 9.0}, "fringes", "sharpen the projector"),
        ({"noise": float("nan")}, "noise", "something moves"),
        ({"full_scale": 4095.0, "modulation": 900.0}, "", ""),
    ],
)
def test_what_is_not_good_says_what_to_do(changes: dict[str, float], name: str, advice: str) -> None:
    bad = [line for line in words(figures(**changes), Pattern.FRINGES) if not line.good]
    assert [line.name for line in bad] == ([name] if name else [])
    assert all(advice in line.verdict for line in bad)


def test_dark_images_ask_for_light() -> None:
    view = figures()
    view.histogram = [1000] * 60 + [0] * 196
    assert any("longer exposure" in line.verdict for line in words(view, Pattern.WHITE))


def test_lines_on_a_dark_ground_need_no_light() -> None:
    dark = figures(dark=0.5, speckle_size=float("nan"), mean=5.0)
    assert all(line.good for line in words(dark, Pattern.FOCUS))


def test_drawing_is_large() -> None:
    console = Console(width=100, force_terminal=False)
    with console.capture() as capture:
        console.print(drawing(figures(), Pattern.WHITE, "bench"))
    text = capture.get()
    assert "██████  ██████" in text, "digits of five lines"
    assert "█" * 70 + "░" * 10 in text, "the bar of 87 %"
    assert "FRINGES" not in text
    spark = sparkline(figures().histogram, 80)
    assert len(spark) == 80
    assert spark[:12].isspace() and "█" in spark


def test_nodes_of_the_live_view(tmp_path: Path) -> None:
    graph = live_graph(load_rig_file(TINY), TINY, [8, 8, 64, 48])
    assert sorted(graph.names) == ["camera", "live_view", "projector", "stage"]
    view = next(node for node in graph.nodes if node.name == "live_view")
    assert view.parameters == {"full_scale_grey_level": 255.0, "region_px": [8, 8, 64, 48]}


def test_command_looks_through_the_nodes_of_a_rig() -> None:
    program = "from fringedic_bringup.command import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program, "live", str(TINY), "--pattern", "fringes", "--region", "8,8,128,96"],
        env=dict(os.environ),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    print(done.stdout)
    assert done.returncode == 0, done.stderr
    assert "tiny, projector shows fringes: 128x96 px from column 8, row 8" in done.stdout
    said = {line[:12].strip(): line[12:] for line in done.stdout.splitlines()[1:]}
    assert 90 <= int(said["focus"].split()[0]) <= 100
    assert float(said["noise"].split()[0]) > 0.5
    assert float(said["fringes"].split()[1]) > 20


def test_wrong_region_is_one_sentence() -> None:
    with pytest.raises(RigFileError, match="320,240,640,480"):
        show_live(load_rig_file(TINY), TINY, Pattern.WHITE, Console(), region="3,4,5", once=True)
