"""The thread that writes a recording reports whatever ends it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from fringedic.recording.reader import BagReader
from fringedic.recording.topics import Topic
from fringedic.recording.writer import BagWriter
from recorder_node.writing_thread import ReceivedMessage, WritingThread


class FailingWriter(BagWriter):
    """Fails at the third message with an error that nobody expects."""

    def write(self, *message: Any, **options: Any) -> None:
        if self.message_count == 2:
            raise ValueError("an error that nobody expects")
        super().write(*message, **options)


@pytest.mark.parametrize("together", [True, False])
def test_unexpected_error_ends_the_recording_with_its_reason(tmp_path: Path, *, together: bool) -> None:
    writer = FailingWriter(tmp_path / "bag")
    writer.add_recorded_topic(Topic("/force", "bench_msgs/msg/Force", "uint8 newton", "ros2msg", "", ""))
    thread = WritingThread(writer, flush_interval_s=0.05)
    messages = [ReceivedMessage("/force", bytes([0, 1, 0, 0, number]), number, number, number) for number in range(5)]
    for batch in [messages] if together else [[message] for message in messages]:
        thread.put(batch)
    ends = time.monotonic() + 180
    while thread.error is None and time.monotonic() < ends:
        time.sleep(0.01)
    thread.close()
    assert str(thread.error) == "an error that nobody expects"
    assert [message.sequence for message in BagReader(tmp_path / "bag").stored()] == [0, 1]
