"""The server as attackers, browsers and slow networks meet it."""

from __future__ import annotations

import asyncio
import http.client
import json
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
import pytest
from certificate import write_certificate
from served import TOKEN, Site, SmallRig, free_port, served
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection
from websockets.typing import Origin

from fringedic.errors import OperatorError
from fringedic.report.page_server import server as page_server
from fringedic.report.page_server.app import LARGEST_BODY, STATE_PERIOD_S
from fringedic.report.page_server.server import Address, PageServer, listen

START = {"procedure": "run"}


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    with served(tmp_path) as running:
        yield running


@pytest.fixture
def cookie(site: Site) -> str:
    return site.login()


@pytest.fixture(scope="module")
def quiet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """Return a server for requests that change nothing."""
    with served(tmp_path_factory.mktemp("page")) as running:
        yield running


@pytest.fixture(scope="module")
def visitor(quiet: Site) -> str:
    return quiet.login()


def test_token_is_exchanged_for_a_strict_cookie_and_leaves_the_address_bar(quiet: Site) -> None:
    answer = quiet.request("GET", f"/?token={TOKEN.replace(' ', '%20')}")
    assert (answer.status, answer.headers["location"]) == (303, "/")
    attributes = answer.headers["set-cookie"].lower()
    assert "httponly" in attributes
    assert "samesite=strict" in attributes
    assert str(quiet.port) in attributes.partition("=")[0], "other ports of this computer share the cookies"


def test_the_printed_address_opened_again_keeps_the_session(quiet: Site, visitor: str) -> None:
    again = quiet.request("GET", f"/?token={TOKEN.replace(' ', '%20')}", Cookie=visitor)
    assert (again.status, "set-cookie" in again.headers) == (303, False)
    assert quiet.request("GET", "/?token=wrong", Cookie=visitor).status == 403


@pytest.mark.parametrize("path", ["/?token=wrong", "/", "/page/main.js", "/maps/0/u", "/files/run/report.html"])
def test_nothing_is_served_without_the_token(quiet: Site, path: str) -> None:
    answer = quiet.request("GET", path)
    assert answer.status == 403
    assert "address" in answer.body.decode()


def test_session_of_another_start_is_told_what_to_do(quiet: Site) -> None:
    answer = quiet.get("/", f"fringedic_{quiet.port}=0123456789abcdef.{'0' * 64}")
    assert answer.status == 403
    assert "open the address that fringedic has printed" in answer.body.decode()


def test_every_answer_has_a_strict_policy(quiet: Site, visitor: str) -> None:
    for path in ("/", "/page/main.js", "/maps/0/u", "/nowhere"):
        policy = quiet.get(path, visitor).headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy


def test_other_names_of_this_computer_are_refused(quiet: Site, visitor: str) -> None:
    """A name of another site that resolves to this address (DNS rebinding)."""
    assert quiet.request("GET", "/", Cookie=visitor, Host=f"attacker.example:{quiet.port}").status == 403
    assert quiet.request("GET", "/", Cookie=visitor, Host=f"localhost:{quiet.port}").status == 200


@pytest.mark.parametrize("origin", ["http://attacker.example", "null", "https://127.0.0.1", ""])
def test_commands_and_streams_of_other_sites_are_refused(site: Site, cookie: str, origin: str) -> None:
    headers = {"Cookie": cookie, "Content_Type": "application/json"} | ({"Origin": origin} if origin else {})
    assert site.request("POST", "/do/start", json.dumps(START), **headers).status == 403
    with pytest.raises(InvalidStatus, match="403"):
        site.stream(cookie, origin or "http://127.0.0.1")
    assert not site.rig.commands


def test_form_of_a_page_is_refused_even_with_the_right_origin(site: Site, cookie: str) -> None:
    headers = {"Cookie": cookie, "Origin": site.origin, "Content_Type": "application/x-www-form-urlencoded"}
    with site.stream(cookie):
        answer = site.request("POST", "/do/start", "procedure=run", **headers)
    assert (answer.status, answer.message) == (409, "a command has to be JSON")


@pytest.mark.parametrize(
    "path",
    [
        "/page/../app.py",
        "/page/%2e%2e/app.py",
        "/page/..%2fapp.py",
        "/page//etc/passwd",
        "/files/run/..%2f..%2fetc%2fpasswd",
        "/files/../run/x.png",
        "/files/other/report.html",
    ],
)
def test_no_file_outside_the_folders_is_served(quiet: Site, visitor: str, path: str) -> None:
    assert quiet.get(path, visitor).status in (404, 405)


def test_report_runs_in_a_sandbox(quiet: Site, visitor: str) -> None:
    (quiet.rig.folder / "report.html").write_text("<script>1</script>")
    (quiet.rig.folder / "bag.mcap").write_text("recording")
    answer = quiet.get("/files/run/report.html", visitor)
    assert answer.status == 200
    assert answer.headers["content-security-policy"].startswith("sandbox allow-scripts; default-src 'none'")
    assert quiet.get("/files/run/bag.mcap", visitor).status == 404


def test_only_the_driver_gives_commands_and_everybody_may_request_a_hold(site: Site, cookie: str) -> None:
    other = site.login()
    with site.stream(cookie) as first, site.stream(other):
        first.recv(5)
        assert site.post("start", START, cookie).message == "started"
        refused = site.post("start", START, other)
        assert (refused.status, refused.message) == (409, "browser 1 (127.0.0.1) drives: ask for the wheel first.")
        assert site.post("hold", {}, other).message == "there is no machine"
        assert site.post("wheel", {"action": "ask"}, other).status == 200
        assert site.post("wheel", {"action": "give"}, cookie).status == 200
        assert site.post("start", START, other).status == 200
        assert site.post("start", START, cookie).status == 409
    assert [type(each).__name__ for each in site.rig.commands] == ["Start", "Hold", "Start"]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("start", {"procedure": "format the disk"}, "procedure: Input should be 'timing'"),
        ("start", {"procedure": "check", "options": {"distance_mm": float("nan")}}, "options.distance_mm"),
        ("start", {"procedure": "noise", "options": {"steps": [3]}}, "options.steps"),
        ("start", {"procedure": "noise", "options": {str(key): 1 for key in range(99)}}, "options: Dictionary should"),
        ("start", START | {"extra": 1}, "extra: Extra inputs are not permitted"),
        ("control", {}, "command: Field required"),
        ("shutdown", {}, "shutdown: there is no such command"),
        ("start", START | {"text": "x" * LARGEST_BODY}, "the text is longer than 500 kB: shorten it"),
    ],
)
def test_wrong_commands_are_refused_by_a_sentence(
    site: Site, cookie: str, name: str, content: object, words: str
) -> None:
    with site.stream(cookie) as stream:
        stream.recv(5)
        answer = site.post(name, content, cookie)
    assert answer.status == 409
    assert answer.message.startswith(words)
    assert not site.rig.commands


def test_tile_contains_the_float32_values_and_their_geometry(quiet: Site, visitor: str) -> None:
    answer = quiet.get("/maps/1/u", visitor)
    geometry = [int(answer.headers[f"x-{key}"]) for key in ("rows", "columns", "spacing")]
    assert geometry == [4, 5, 8]
    expected = np.tile(1e-5 * np.arange(5, dtype=np.float32), (4, 1))
    np.testing.assert_array_equal(np.frombuffer(answer.body, "<f4").reshape(4, 5), expected)
    cloud = np.frombuffer(quiet.get("/cloud/1/u", visitor).body, "<f4").reshape(-1, 7)
    np.testing.assert_array_equal(cloud[:, 3], expected.ravel())


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("/maps/7/u", "step 7 has no map u: choose a step and a map of the lists"),
        ("/maps/1/e_11", "step 1 has no map e_11"),
        ("/maps/1/..%2f0%2fu", ""),
        ("/cloud/1/phase", "step 1 has no map phase"),
        ("/line/1/u?from=0,0&to=900,0", "the line from [0.0, 0.0] to [900.0, 0.0] px (column, row) leaves the result"),
        ("/line/1/u?from=0,0", "to is '': give a number"),
        ("/gauge?from=nan,0&to=1,1&subset=9", "from is 'nan': give a number"),
        ("/gauge?from=0,0&to=0,0&subset=1", "both gauge subsets"),
    ],
)
def test_impossible_maps_and_probes_are_refused_by_a_sentence(quiet: Site, visitor: str, path: str, words: str) -> None:
    answer = quiet.get(path, visitor)
    assert answer.status in (404, 409)
    assert not words or answer.message.startswith(words)


def test_profile_and_extensometer_equal_those_of_the_library(quiet: Site, visitor: str) -> None:
    line = json.loads(quiet.get("/line/1/u?from=0,0&to=32,0", visitor).body)
    assert len(line["position"]) == 33
    np.testing.assert_allclose(line["value"], 1e-5 * np.arange(33) / 8, rtol=1e-6)
    np.testing.assert_allclose(line["sigma"], 1e-7)
    readings = json.loads(quiet.get("/gauge?from=0,0&to=32,0&subset=1", visitor).body)
    assert [each["step"] for each in readings] == [0, 1]
    assert readings[1]["strain"] == pytest.approx(0.01)
    assert readings[1]["sigma_strain"] == pytest.approx(2**0.5 * 1e-7 / 4e-3)


def test_stream_starts_with_the_state_and_follows_its_changes(site: Site, cookie: str) -> None:
    with site.stream(cookie) as stream:
        found = {}
        while {"rig", "wheel"} - found.keys():
            message = json.loads(stream.recv(5))
            found[message["topic"]] = message["data"]
        assert found["rig"] == {"kind": "rig", "force": None}, "JSON has no NaN"
        assert found["wheel"]["drives"]
        site.rig.state = {"rig": {"kind": "rig", "force": 1.5}}
        while (message := json.loads(stream.recv(5)))["topic"] != "rig" or message["data"]["force"] is None:
            pass  # the wheel, or the state before
        assert message["data"]["force"] == 1.5
        site.server.publish("image", lambda: b"picture")
        assert stream.recv(5) == b"picture"


def test_a_state_that_returns_reaches_a_client_that_came_in_between(site: Site, cookie: str) -> None:
    """What was published last, before this client came, is no news for the server but for the client."""

    def force(stream: ClientConnection) -> float:
        while (message := json.loads(stream.recv(5)))["topic"] != "rig":
            pass
        return float(message["data"]["force"] or 0)

    states = [{"rig": {"kind": "rig", "force": force}} for force in (1.0, 2.0)]
    site.rig.state = states[0]
    with site.stream(cookie) as stream:
        while force(stream) != 1.0:
            pass
        time.sleep(3 * STATE_PERIOD_S)
    time.sleep(3 * STATE_PERIOD_S)
    site.rig.state = states[1]
    with site.stream(cookie) as stream:
        assert force(stream) == 2.0
        site.rig.state = states[0]
        while force(stream) != 1.0:
            pass


def test_stuck_client_does_not_delay_another_nor_fill_the_memory(site: Site, cookie: str) -> None:
    made = []

    def picture(number: int) -> bytes:
        made.append(number)
        return bytes(200_000) + number.to_bytes(4, "little")

    with stuck(site, cookie), site.stream(site.login()) as quick:
        for number in range(100):
            site.server.publish("image", lambda number=number: picture(number))  # type: ignore[misc]
            while not isinstance(received := quick.recv(5), bytes):
                pass
            assert int.from_bytes(received[-4:], "little") == number
    assert len(made) == 100


def test_silent_connections_without_a_token_are_ended(
    site: Site, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Some send nothing, others never end their request, also after one that was complete."""
    monkeypatch.setattr(page_server, "SILENT_S", 1.0)
    with ExitStack() as open_ones:
        silent = []
        for number in range(200):
            connection = socket.create_connection(("127.0.0.1", site.port), timeout=10)
            silent.append(open_ones.enter_context(connection))
            if number % 2:
                connection.sendall(b"GET / HTTP/1.1\r\nHost: slow\r\n")
        refused = socket.create_connection(("127.0.0.1", site.port), timeout=10)
        open_ones.enter_context(refused)
        refused.sendall(b"GET / HTTP/1.1\r\nHost: slow\r\n\r\n")
        assert b"HTTP/1.1 403" in refused.recv(4096)
        refused.sendall(b"GET / HTTP/1.1\r\n")
        assert site.login(), "the others are served meanwhile"
        for connection in silent[::2]:
            assert b"408 Request Timeout" in received(connection)
        for connection in silent[1::2]:
            with suppress(ConnectionResetError):  # where it was ended before it had sent its part
                assert b"408 Request Timeout" in received(connection)
        assert b"408 Request Timeout" in received(refused)
    assert not caplog.records


def received(connection: socket.socket) -> bytes:
    """Return everything until the end of a connection."""
    return b"".join(iter(lambda: connection.recv(4096), b""))


def test_a_text_that_is_no_text_has_no_effect(site: Site, cookie: str, caplog: pytest.LogCaptureFixture) -> None:
    with site.stream(cookie) as stream:
        stream.socket.sendall(b"\x81\x82" + bytes(4) + b"\xff\xfe")
        site.rig.state = {"rig": {"kind": "rig", "force": 2.5}}
        while json.loads(stream.recv(5))["data"].get("force") != 2.5:
            pass
    assert not caplog.records


def stuck(site: Site, cookie: str) -> socket.socket:
    """Return a connection to the stream that never reads."""
    connection = socket.socket()
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    connection.connect(("127.0.0.1", site.port))
    lines = (
        "GET /stream HTTP/1.1",
        f"Host: 127.0.0.1:{site.port}",
        f"Origin: {site.origin}",
        f"Cookie: {cookie}",
        "Upgrade: websocket",
        "Connection: Upgrade",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==",
    )
    connection.sendall("\r\n".join((*lines, "", "")).encode())
    wait_until(lambda: bool(site.server.hub.clients))
    return connection


def wait_until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_server_ends_while_a_connection_is_closing(site: Site, cookie: str) -> None:
    """A browser has closed its connection before it received all messages."""
    sent = threading.Event()

    def picture() -> bytes:
        sent.set()
        return bytes(10_000_000)

    with stuck(site, cookie) as connection:
        site.server.publish("image", picture)
        assert sent.wait(10)
        connection.sendall(b"\x88\x82" + bytes(4) + b"\x03\xe8")  # closed for no special reason
        wait_until(lambda: not site.server.hub.clients)
        running = threading.active_count()
        site.server.close()
        assert threading.active_count() == running - 1


def test_a_port_in_use_is_named(quiet: Site) -> None:
    with pytest.raises(
        OperatorError, match=rf"127.0.0.1 port {quiet.port}: the page cannot be served .*another --port"
    ):
        listen("127.0.0.1", quiet.port)


def test_address_for_people() -> None:
    assert Address("127.0.0.1", 8080, "abc").url == "http://127.0.0.1:8080/?token=abc"
    assert Address("::1", 8080, "abc", Path("c"), Path("k")).url == "https://[::1]:8080/?token=abc"
    assert Address("192.168.1.5", 80, "x").hosts()[0].endswith(":80")


def test_page_is_encrypted_with_certificate_files(tmp_path: Path) -> None:
    certificate, key = write_certificate(tmp_path)
    trusted = ssl.create_default_context(cafile=certificate)
    address = Address("127.0.0.1", free_port(), "secret", certificate, key)
    server = PageServer(SmallRig(tmp_path), address)
    try:
        secure = http.client.HTTPSConnection(address.host, address.port, timeout=10, context=trusted)
        secure.request("GET", "/?token=secret")
        cookie = secure.getresponse().headers["set-cookie"]
        secure.close()
        assert "Secure" in cookie
        assert address.url.startswith("https://")
        plain = http.client.HTTPConnection(address.host, address.port, timeout=10)
        plain.request("GET", "/?token=secret")
        with pytest.raises((http.client.HTTPException, ConnectionError)):
            plain.getresponse()
        plain.close()
        place, headers = f"{address.host}:{address.port}", {"Cookie": cookie.partition(";")[0]}
        assert asyncio.run(first_topic(place, headers, trusted)) == "rig"
    finally:
        server.close()


async def first_topic(place: str, headers: dict[str, str], trusted: ssl.SSLContext) -> str:
    """Return the topic of the first message; in one thread, because two may not use a connection of OpenSSL at once."""
    origin = Origin(f"https://{place}")
    async with connect(f"wss://{place}/stream", additional_headers=headers, origin=origin, ssl=trusted) as stream:
        return str(json.loads(await asyncio.wait_for(stream.recv(), 10))["topic"])


def test_a_certificate_that_is_none_is_named(tmp_path: Path) -> None:
    (tmp_path / "page.crt").write_text("nothing")
    address = Address("127.0.0.1", free_port(), "secret", tmp_path / "page.crt", tmp_path / "page.crt")
    with pytest.raises(OperatorError, match=r"page.crt.*no TLS certificate with its key"):
        PageServer(SmallRig(tmp_path), address)
