"""Commands say of a damaged recording what is whole, what is lost, and which command follows."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from fringedic.command.main import app
from fringedic.recording import BagReader, join
from fringedic.recording.writer import Split
from fringedic.wording.numbers import grouped

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"


@pytest.fixture(scope="module")
def damaged(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording whose last file is missing."""
    bag = tmp_path_factory.mktemp("damaged") / "bag"
    join([RECORDED], bag, split=Split(duration=4.0))
    sorted(bag.glob("*.mcap"))[-1].unlink()
    return bag


def said(*words: object) -> str:
    done = CliRunner().invoke(app, [*map(str, words)])
    assert done.exit_code == 0, done.output
    return " ".join(done.output.split())


@pytest.fixture(scope="module")
def losses(damaged: Path) -> str:
    """Return what every command has to say of the recording."""
    reader = BagReader(damaged)
    image = reader.find("camera/image_raw")["camera/image_raw"]
    frames, messages = reader.counts[image], sum(reader.counts.values())
    assert 0 < frames < 36
    lost = sum(reader.missing.values())
    name = sorted(file.name for file in damaged.glob("*.mcap"))[-1]
    last = f"bag_{int(name[4:-5]) + 1}.mcap"
    return (
        f"whole: {frames} of 36 frames, {grouped(messages)} of {grouped(messages + lost)} messages of all topics "
        f"lost: {36 - frames} frames, {lost - 36 + frames} other messages; {last} is missing"
    )


def test_info_names_recover(damaged: Path, losses: str) -> None:
    assert said("info", damaged).endswith(
        f"{losses} next: `fringedic recover {damaged}` writes a recording of what is whole"
    )


def test_recover_names_process(damaged: Path, losses: str, tmp_path: Path) -> None:
    saved = tmp_path / "saved"
    answer = said("recover", damaged, "--output", saved)
    assert answer.endswith(
        f"recording: {saved} {losses} next: `fringedic process {saved}` measures the recorded frames"
    )


def test_process_counts_whole_steps(damaged: Path, losses: str, tmp_path: Path) -> None:
    dataset = tmp_path / "whole.nc"
    answer = said("process", damaged, "--output", dataset)
    assert losses in answer
    verdict = r"9\d\.\d % of the points are confirmed within 3 sigma by an independent check"
    steps, following = (
        f"dataset: {dataset} whole: 1 of 1 steps",
        f"next: `fringedic report {dataset}` shows the results",
    )
    assert re.search(f"{re.escape(steps)} {verdict} {re.escape(following)}", answer)


def test_calibration_names_the_losses_of_its_recording(damaged: Path, losses: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["calibrate", "--from", str(damaged), "--output", str(tmp_path / "again")])
    assert losses in " ".join(done.output.split())


def test_list_of_topics_fits_an_ordinary_terminal() -> None:
    lines = CliRunner().invoke(app, ["info", str(RECORDED)], env={"COLUMNS": "80"}).output.splitlines()
    [line] = [line for line in lines if "/camera/image_raw " in line]
    assert re.fullmatch(r" /rig/camera/image_raw +sensor_msgs/Image +36", line.rstrip())
    assert "…" not in "".join(lines)


def test_whole_recording_loses_nothing() -> None:
    assert "whole: 36 frames, 2 313 messages of all topics lost: nothing next: `fringedic" in said("info", RECORDED)
