"""Object stores: the same results behind a connection with faults, and no more bytes than are needed."""

from __future__ import annotations

import http.client
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import fsspec
import numpy as np
import pytest
import yaml
from moto.server import ThreadedMotoServer
from running_system import ROOT

import fringedic
from fringedic.campaign import Campaign, CampaignStore, Receipt, Serial, load_campaign, status_of, update_plan
from fringedic.datasets.processing import PROCESSED_TOPICS
from fringedic.errors import CampaignError
from fringedic.recording import BagReader, BagWriter, Topic
from fringedic.recording.bag_files import open_file
from fringedic.recording.remote import RemoteRecording

RECORDED = ROOT / "ros2_ws" / "src" / "fringedic" / "test" / "recordings" / "version_0_1" / "bag"
pytestmark = [
    pytest.mark.usefixtures("collected_from_module", "collected"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),  # of packages that moto and s3fs use
    pytest.mark.filterwarnings("ignore::ResourceWarning"),  # of connections that were cut
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


class Proxy(ThreadingHTTPServer):
    """Passes requests on to an object store, with faults.

    Attributes
    ----------
    faults
        Whether every 40th request is answered by 503, the answer to every 25th one is cut in its middle, and that to
        every 15th one comes in pieces.
    fetched
        Bytes of the answers to requests for ranges of objects.
    ranges
        Number of these answers.
    """

    daemon_threads = True

    def __init__(self, target: tuple[str, int]) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.target = target
        self.faults = False
        self.requests = self.injected = self.fetched = self.ranges = 0

    def handle_error(self, *_: object) -> None:
        """The client has closed the connection."""


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: Proxy

    def handle_one_request(self) -> None:
        self.raw_requestline = self.rfile.readline(65537)
        if not self.raw_requestline or not self.parse_request():
            self.close_connection = True
            return
        self.server.requests += 1
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        if self.server.faults and self.server.requests % 40 == 0:
            self.server.injected += 1
            self.answer(503, [], b"<Error><Code>SlowDown</Code></Error>")
            return
        connection = http.client.HTTPConnection(*self.server.target)
        connection.request(self.command, self.path, body, dict(self.headers))
        answer = connection.getresponse()
        self.answer(answer.status, answer.getheaders(), answer.read())

    def answer(self, status: int, headers: list[tuple[str, str]], data: bytes) -> None:
        self.send_response_only(status)
        hidden = {"connection", "transfer-encoding", "content-length"}
        for name, value in headers:
            if name.lower() not in hidden:
                self.send_header(name, value)
        length = {name.lower(): value for name, value in headers}.get("content-length", str(len(data)))
        self.send_header("Content-Length", length if self.command == "HEAD" else str(len(data)))
        self.end_headers()
        if self.command == "HEAD":
            return
        cut = self.server.faults and self.command == "GET" and self.server.requests % 25 == 0
        if cut:
            self.server.injected += 1
            data, self.close_connection = data[: len(data) // 2], True
        if self.command == "GET" and status == 206:
            self.server.fetched += len(data)
            self.server.ranges += 1
        slow = self.server.faults and self.server.requests % 15 == 0
        for piece in in_pieces(data, 4 if slow else 1):
            time.sleep(0.05 if slow else 0.0)
            self.wfile.write(piece)

    def log_message(self, *_: object) -> None:
        """Nothing is printed."""


def in_pieces(data: bytes, count: int) -> list[bytes]:
    size = -(-len(data) // count)
    return [data[start : start + size] for start in range(0, len(data), size or 1)]


@pytest.fixture(scope="module")
def proxy() -> Iterator[Proxy]:
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    proxy = Proxy(server.get_host_and_port())
    thread = threading.Thread(target=proxy.serve_forever)
    thread.start()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{proxy.server_address[1]}")
        patch.setenv("AWS_ACCESS_KEY_ID", "test")
        patch.setenv("AWS_SECRET_ACCESS_KEY", "test")
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        files = fsspec.filesystem("s3")
        files.mkdir("laboratory")
        for name in ("plate-1", "plate-2"):
            files.put(str(RECORDED), f"laboratory/recordings/{name}/bag", recursive=True)
        yield proxy
    proxy.shutdown()
    thread.join()
    proxy.server_close()
    server.stop()


def campaign_in(folder: Path, **content: object) -> Campaign:
    (folder / "campaign.yaml").write_text(yaml.safe_dump(content))
    return load_campaign(folder)


def test_results_behind_a_bad_connection_are_those_of_the_desk(proxy: Proxy, tmp_path: Path) -> None:
    campaign = campaign_in(
        tmp_path, store="s3://laboratory/store", recordings=[{"path": "s3://laboratory/recordings/*"}]
    )
    plan = update_plan(campaign)
    assert [unit.name for unit in plan.units] == ["plate-1", "plate-2"]
    proxy.faults = True
    try:
        outcomes = list(Serial().outcomes(plan.units[:1]))
        assert all(isinstance(outcome, Receipt) for outcome in outcomes), outcomes
        assert proxy.injected > 5
        status = status_of(CampaignStore(campaign.store), plan)
        assert (list(status.done), [unit.name for unit in status.waiting]) == (["plate-1"], ["plate-2"])
        tree, catalogue = fringedic.open_campaign("s3://laboratory/store")
        assert catalogue.index.tolist() == ["plate-1"]
        found = tree["plate-1"].to_dataset().load()
    finally:
        proxy.faults = False
    file = fringedic.process_bag(RECORDED, output=tmp_path / "desk.nc")
    with fringedic.open_experiment(file) as desk:
        assert found.identical(desk.load())
    assert np.isfinite(found.w).mean() > 0.5


def test_only_the_index_and_the_needed_chunks_are_fetched(proxy: Proxy, tmp_path: Path) -> None:
    large = with_noise(tmp_path / "bag")
    fsspec.filesystem("s3").put(str(large), "laboratory/large/bag", recursive=True)
    (file,) = BagReader(large).files
    wanted = {f"/rig/{topic}" for topic in PROCESSED_TOPICS}
    index = open_file(file, check=False)
    chunks = [each for each in index.chunks if any(index.channels[number].topic in wanted for number in each.channels)]
    needed = sum(chunk.length for chunk in chunks) + 1_000_000
    proxy.fetched = proxy.ranges = 0
    with RemoteRecording("s3://laboratory/large/bag").copied(PROCESSED_TOPICS) as copy:
        copied, original = BagReader(copy), BagReader(RECORDED)
        assert [each.data for each in copied.raw(wanted)] == [each.data for each in original.raw(wanted)]
    assert file.stat().st_size > 5 * needed
    assert proxy.fetched <= 1.05 * needed
    assert proxy.ranges <= 1 + len(chunks)


def with_noise(target: Path) -> Path:
    """A recording with chunks of another topic between those of the measurement."""
    reader = BagReader(RECORDED)
    noise = np.random.default_rng(1).bytes(400_000)
    with BagWriter(target, flush_interval_s=3600) as writer:
        for topic in reader.topics.values():
            writer.add_recorded_topic(topic)
        writer.add_recorded_topic(Topic("/other/camera", "test/msg/Bytes", "uint8[] data", "ros2msg", "", ""))
        for number, message in enumerate(reader.stored()):
            writer.write(*message)
            if number % 75 == 0:
                writer.flush()
                writer.write("/other/camera", noise, message.log_time, message.publish_time)
                writer.flush()
    return target


def test_a_recording_that_was_cut_off_is_not_scanned(proxy: Proxy, tmp_path: Path) -> None:
    content = (RECORDED / "bag_0.mcap").read_bytes()
    fsspec.filesystem("s3").pipe("laboratory/cut/bag/bag_0.mcap", content[:-100] * 3)
    proxy.fetched = 0
    plan = update_plan(campaign_in(tmp_path, recordings=[{"path": "s3://laboratory/cut"}]))
    assert "run 'fringedic recover' on the computer where it lies" in plan.refused["cut"]
    assert 0 < proxy.fetched <= 1_000_000


def test_missing_credentials_are_named(proxy: Proxy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    monkeypatch.setenv("AWS_EC2_METADATA_DISABLED", "true")
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(tmp_path / "none"))
    fsspec.filesystem("s3").clear_instance_cache()
    with pytest.raises(CampaignError, match=r"the store s3://laboratory/store cannot be read: .*credentials"):
        fringedic.open_campaign("s3://laboratory/store")
    assert proxy.requests
