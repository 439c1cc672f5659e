"""A recording for Foxglove, read by a client of its protocol."""

from __future__ import annotations

import asyncio
import json
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import psutil
import pytest
from served import free_port
from viewer import WAIT_S, Viewer, viewing
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from fringedic.errors import OperatorError, RecordingError
from fringedic.export import foxglove
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


@pytest.fixture(scope="module")
def server() -> Iterator[TopicServer]:
    """Return a server with a topic, for viewers that change nothing."""
    server = TopicServer(0, "guarded")
    server.offer("/force", "bench_msgs/msg/Value", "uint8 value")
    yield server
    server.close()


def connected(server: TopicServer, origin: str | None = None, url: str | None = None) -> ClientConnection:
    return connect(url or server.url, subprotocols=["foxglove.sdk.v1"], origin=origin)  # type: ignore[list-item, arg-type]


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "https://app.foxglove.dev.evil.example",
        "http://localhost.evil.example",
        "null",
        "file:///x",
    ],
)
def test_web_pages_of_others_are_refused_even_with_the_token(server: TopicServer, origin: str) -> None:
    with pytest.raises(InvalidStatus, match="403") as refused:
        connected(server, origin)
    assert refused.value.response.body == b"Web pages other than Foxglove's are refused.\n"


@pytest.mark.parametrize(
    "origin", [None, "https://app.foxglove.dev", "https://studio.foxglove.dev", "file://", "http://localhost:8080"]
)
def test_foxglove_and_pages_of_this_computer_are_served(server: TopicServer, origin: str | None) -> None:
    with connected(server, origin) as viewer:
        assert json.loads(viewer.recv(WAIT_S))["op"] == "serverInfo"
        assert json.loads(viewer.recv(WAIT_S))["channels"][0]["topic"] == "/force"


def test_other_computers_do_not_reach_the_port(server: TopicServer) -> None:
    port = urlsplit(server.url).port
    listening = [each.laddr for each in psutil.Process().net_connections() if each.status == psutil.CONN_LISTEN]
    assert [place.ip for place in listening if place.port == port] == ["127.0.0.1"]


@pytest.mark.parametrize("query", ["", "?token=", "?token=wrong", "?token=%C3%A9"])
def test_other_users_of_the_computer_have_no_token(server: TopicServer, query: str) -> None:
    with pytest.raises(InvalidStatus, match="403"):
        connected(server, url=f"{server.url.partition('?')[0]}{query}")


def test_what_is_not_of_the_protocol_is_answered_by_a_sentence(
    server: TopicServer, caplog: pytest.LogCaptureFixture
) -> None:
    with connected(server) as viewer:
        viewer.recv(WAIT_S), viewer.recv(WAIT_S)
        wrong = [{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 7}]}, {"op": "unsubscribe"}, [], 1]
        nan = struct.pack("<BBfBQI", 3, 0, float("nan"), 0, 0, 0)
        for message in (*map(json.dumps, wrong), "{", "[" * 100_000, b"\x03", nan):
            viewer.send(message)
            assert json.loads(viewer.recv(WAIT_S))["message"] == "The message is not of the protocol."
        viewer.socket.sendall(b"\x81\x82" + bytes(4) + b"\xff\xfe")  # a text that is no UTF-8
        with pytest.raises(ConnectionClosed) as closed:
            viewer.recv(WAIT_S)
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 1007
    assert not caplog.records


def test_a_silent_connection_is_ended(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(foxglove, "SILENT_S", 0.2)
    server = TopicServer(0, "impatient")
    try:
        port = int(urlsplit(server.url).port or 0)
        with socket.create_connection(("127.0.0.1", port), timeout=WAIT_S) as silent:
            assert silent.recv(1) == b""
    finally:
        server.close()
    assert not caplog.records


def test_a_slow_viewer_misses_messages_and_no_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foxglove, "BACKLOG", 10)
    viewer = foxglove.Viewer()
    sent: list[bytes | str] = []
    viewer.say({"op": "status"})
    for number in range(5):
        viewer.put(b"\x01" + bytes([number]))
    viewer.put(b"\x05state")

    class Connection:
        async def send(self, payload: bytes | str) -> None:
            sent.append(payload)

    async def receive() -> None:
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(viewer.send_all(Connection()), 0.1)

    asyncio.run(receive())
    assert sent == ['{"op": "status"}', b"\x05state"]
