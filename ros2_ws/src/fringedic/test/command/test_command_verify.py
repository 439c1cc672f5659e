"""``fringedic verify`` ends with the count of the frames, and with the exit code 1 if something is lost."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from fringedic.command.main import app
from fringedic.recording.reader import BagReader
from fringedic.recording.writer import BagWriter

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Copy the recording into chunks of a hundred messages."""
    reader = BagReader(RECORDED)
    with BagWriter(tmp_path / "bag") as writer:
        for topic in reader.topics.values():
            writer.add_recorded_topic(topic)
        for number, message in enumerate(reader.stored()):
            writer.write(*message)
            if number % 100 == 0:
                writer.flush()
    return tmp_path / "bag"


def command(name: str, bag: Path) -> Result:
    return CliRunner().invoke(app, [name, str(bag)])


def test_complete_recording(bag: Path) -> None:
    done = command("verify", bag)
    assert done.exit_code == 0
    assert done.stdout.splitlines()[-1] == "36 of 36 frames, 0 lost"


def test_damaged_recording_is_recovered_without_its_damaged_part(bag: Path) -> None:
    file = bag / "bag_0.mcap"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    done = command("verify", bag)
    assert done.exit_code == 1
    assert "1 chunk left out because of a wrong checksum" in done.stdout
    frames, _, all_frames, *_ = done.stdout.splitlines()[-1].split()
    assert 0 < int(frames) < int(all_frames) == 36

    recovered = " ".join(command("recover", bag).stdout.split())
    assert f"lost: {36 - int(frames)} frames, " in recovered
    assert command("verify", bag.with_name("bag_recovered")).stdout.splitlines()[-1].startswith(f"{frames} of ")
    assert f"{file.name} has changed since the recording was closed" in done.stdout
