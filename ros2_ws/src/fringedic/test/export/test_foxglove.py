"""A recording for Foxglove, read by a client of its protocol."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from served import free_port
from viewer import WAIT_S, Viewer, viewing

from fringedic.errors import OperatorError, RecordingError
from fringedic.export.foxglove import RecordingPlayer, TopicServer
from fringedic.recording import BagWriter, Topic

MS = 1_000_000
START = 1_000_000 * MS


def cdr(value: int) -> bytes:
    return bytes([0, 1, 0, 0, value])


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording with a calibration at its start and a force every 100 ms."""
    path = tmp_path_factory.mktemp("recorded") / "bag"
    with BagWriter(path) as writer:
        for name in ("/calibration", "/force"):
            writer.add_recorded_topic(Topic(name, "bench_msgs/msg/Value", "uint8 value", "ros2msg", "", ""))
        writer.write("/calibration", cdr(99), log_time=START, publish_time=START)
        for number in range(5):
            time = START + (1 + 100 * number) * MS
            writer.write("/force", cdr(number), log_time=time, publish_time=time)
    return path


@contextmanager
def playing(recording: Path) -> Iterator[Viewer]:
    player, ended = RecordingPlayer(recording, 0), threading.Event()

    def spin() -> None:
        while not ended.is_set():
            player.spin_once()

    thread = threading.Thread(target=spin)
    thread.start()
    try:
        with viewing(player.server.url) as viewer:
            yield viewer
    finally:
        ended.set()
        thread.join()
        player.close()


def test_recording_is_played_with_its_definitions_and_times(recording: Path) -> None:
    with playing(recording) as viewer:
        viewer.watch("/calibration", "/force")
        assert viewer.topics["/force"]["schema"] == "uint8 value"
        assert viewer.topics["/force"]["schemaName"] == "bench_msgs/msg/Value"
        assert viewer.topics["/force"]["encoding"] == "cdr"
        found = list(viewer.received(6))
        forces = [(data, time) for topic, data, time in found if topic == "/force"]
        assert forces == [(cdr(number), START + (1 + 100 * number) * MS) for number in range(5)]
        assert ("/calibration", cdr(99), START) in found
        while not viewer.ended:
            viewer.read(WAIT_S)
        assert set(viewer.info["capabilities"]) == {"time", "playbackControl"}, "nothing that changes a rig"


def test_after_a_jump_the_last_messages_before_it_are_shown(recording: Path) -> None:
    with playing(recording) as viewer:
        viewer.watch("/calibration", "/force")
        list(viewer.received(6))
        viewer.control(play=False, seek=START + 250 * MS)
        assert sorted(data[-1] for _, data, _ in viewer.received(2)) == [2, 99]
        viewer.control(play=True, seek=START + 250 * MS)
        assert sorted(data[-1] for _, data, _ in viewer.received(4)) == [2, 3, 4, 99]


def test_a_port_in_use_and_a_missing_recording_are_named(tmp_path: Path) -> None:
    server = TopicServer(port := free_port(), "first")
    try:
        with pytest.raises(OperatorError, match=rf"port {port}: Foxglove cannot be served .*--port"):
            TopicServer(port, "second")
    finally:
        server.close()
    with pytest.raises(RecordingError, match="no such recording"):
        RecordingPlayer(tmp_path / "nothing", port)
