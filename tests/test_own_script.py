"""The scripts of the page on the command, with the nodes of the tiny rig, and a campaign that follows its recording."""

from __future__ import annotations

import re
import subprocess
from contextlib import ExitStack, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import pytest
from running_system import CONFIG, ROOT, wait_until

from fringedic.campaign import CampaignStore, load_campaign, process_unit, status_of, update_plan
from fringedic.recording.reader import BagReader

pytestmark = pytest.mark.slow
STEPS = 4


@dataclass(frozen=True)
class ScriptRun:
    """Folder of the campaign with the recording, and what the script printed."""

    folder: Path
    printed: str


@pytest.fixture(scope="module")
def script_run(domain: str, tmp_path_factory: pytest.TempPathFactory) -> ScriptRun:
    """Run the scripts while a campaign measures their steps; the recorder ends when all are measured."""
    assert domain
    folder, printed = tmp_path_factory.mktemp("script"), StringIO()
    (folder / "campaign.yaml").write_text("recordings: [{path: plate}]")
    script, plain, start = printed_scripts()
    start = start.replace("plate.yaml", str(CONFIG / "tiny.yaml")).replace("recordings/plate-7", str(folder / "plate"))
    with ExitStack() as ended:
        campaigns: list[subprocess.Popen[bytes]] = []

        def run_scripts(_prompt: str) -> None:
            """Take the place of the person who runs scripts and then presses Enter."""
            wait_until((folder / "plate" / "bag" / "metadata.yaml").exists, "the recording")
            follow = ["fringedic", "campaign", "run", str(folder), "--follow"]
            campaigns.append(ended.enter_context(subprocess.Popen(follow, stdout=subprocess.DEVNULL)))
            with redirect_stdout(printed):
                exec(script, {})
                exec(plain, {})
            wait_until(lambda: measured(folder) == STEPS, "the campaign's last step")
            assert not (folder / "plate" / "bag" / "manifest.sha256").exists(), "the recorder goes on"

        exec(start, {"input": run_scripts})
        assert campaigns[0].wait(300) == 0
    return ScriptRun(folder, printed.getvalue())


def printed_scripts() -> list[str]:
    """Return the scripts of the page: with the client of the rig, with rclpy alone, and the start of the nodes."""
    page = (ROOT / "docs" / "command.md").read_text()
    titles = ("Your own script", "A client in plain rclpy", "Nodes from Python")
    sections = [re.split(rf"^#+ {title}$", page, flags=re.MULTILINE)[1] for title in titles]
    return [re.findall(r"```python\n(.*?)```", section, re.DOTALL)[0] for section in sections]


def measured(folder: Path) -> int:
    """Number of steps that the campaign has measured of the recording that is being made."""
    marker = CampaignStore(str(folder / "store")).read("begun/plate.json")
    return 0 if marker is None else int(marker["steps"])


def test_the_printed_script_moves_and_measures(script_run: ScriptRun) -> None:
    lines = [line.split() for line in script_run.printed.splitlines()]
    assert [line[0] for line in lines] == ["0", "1", "2", "3"]
    assert lines.pop() == ["3", "0"], "the step of the client in plain rclpy, without an error"
    forces = [float(line[1]) for line in lines]
    assert forces == pytest.approx([0, 200, 400], abs=60), "the plate's grips are 2000 N/mm stiff, with some play"
    assert float(lines[2][3]) > float(lines[1][3]) > 0
    recorded = BagReader(script_run.folder / "plate" / "bag")
    (states,) = recorded.find("load_frame/state").values()
    samples = [message for _, message, _ in recorded.messages([states])]
    assert 500 < max(sample.force for sample in samples) < 650, "the move ended at its force"
    assert samples[-1].position < 0.45e-3, "and before its position"


def test_a_campaign_measures_while_the_recorder_goes_on(script_run: ScriptRun) -> None:
    campaign = load_campaign(script_run.folder)
    store, plan = CampaignStore(campaign.store), update_plan(campaign)
    followed = status_of(store, plan).done["plate"]
    assert (followed.figures["steps"], followed.figures["failed_steps"]) == (STEPS, 0)
    store.remove("receipts")
    assert process_unit(plan.units[0]).digest == followed.digest
