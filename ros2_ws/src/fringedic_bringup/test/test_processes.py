"""The processes of a graph: addresses and shared memory that they use, and that they leave nothing behind."""

from __future__ import annotations

import gc
import mmap
import os
import re
import signal
import socket
import struct
import time
from contextlib import suppress
from pathlib import Path

import pytest

from fringedic.configuration.programme import Programme
from fringedic.errors import NodeDiedError, ProcessError
from fringedic_bringup.client import RigClient
from fringedic_bringup.launch import processes
from fringedic_bringup.launch.environment import node_environment, private_domain
from fringedic_bringup.launch.graph import COMPOSED, Graph, NodeEntry, rig_graph
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_bringup.procedures.driving import drive
from fringedic_bringup.procedures.run import load_rig
from fringedic_ros.middleware.fast_dds import SHARED_MEMORY, remove_stale_segments
from fringedic_ros.presence import is_announced

TINY = Path(__file__).parent.parent / "config" / "tiny.yaml"


class Silent:
    """Progress that is not shown."""

    def stage(self, text: str) -> None: ...

    def step(self, number: int, last: int, text: str, frame: int = 0, frames: int = 0) -> None: ...

    def part(self, number: int, parts: int, text: str, frame: int = 0, frames: int = 0) -> None: ...

    def note(self, text: str) -> None: ...


def shared_memory_of(pid: int) -> set[str]:
    """Return the Fast DDS segments whose lock file a process holds open."""
    opened = (os.readlink(link) for link in Path(f"/proc/{pid}/fd").iterdir() if link.is_symlink())
    return {
        Path(path).name.removesuffix("_el")
        for path in opened
        if path.startswith(("/dev/shm/fastrtps_", "/dev/shm/fastdds_"))
    }


def users(segment: str) -> dict[str, str]:
    """Return the files of `/proc` that name a segment, maps and open files, with the command of their process."""
    found: dict[str, str] = {}
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            command = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            if segment in (process / "maps").read_text():
                found[f"{process}/maps"] = command
            found |= {str(link): command for link in (process / "fd").iterdir() if segment in os.readlink(link)}
    return found


def test_a_node_that_cannot_start_fails_the_run_with_the_end_of_its_log(tmp_path: Path) -> None:
    with private_domain() as domain:
        graph = Graph("rig", (NodeEntry("camera", "camera_node", "camera", {"source": "files", "files": "nowhere"}),))
        with RunningGraph(graph, tmp_path, domain=domain) as running:
            end = time.monotonic() + 180
            while running.exit_code("camera") is None:
                assert time.monotonic() < end, "the node does not end"
                time.sleep(0.1)
            with pytest.raises(NodeDiedError) as caught:
                running.check()
    assert "camera ended with exit code 1" in str(caught.value)
    assert "nowhere" in str(caught.value)


def test_a_node_is_started_again_with_its_changes(tmp_path: Path) -> None:
    """The load frame node does not end then when its machine does not answer."""
    entry = NodeEntry(
        "camera", "camera_node", "camera", {"source": "files", "files": "nowhere"}, {"files": "elsewhere"}
    )
    with private_domain() as domain, RunningGraph(Graph("rig", (entry,)), tmp_path, domain=domain) as running:
        running.kill(["camera"])
        assert "nowhere" in (tmp_path / "camera.yaml").read_text()
        running.restart("camera")
        assert "elsewhere" in (tmp_path / "camera.yaml").read_text()


def test_a_rig_whose_nodes_run_already_is_not_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They take no lease when `ros2 launch` starts them; two load frame nodes would move the machine."""
    monkeypatch.setattr(processes, "ENDING_S", 0.2)
    graph = Graph("rig", (NodeEntry("load_frame", "load_frame_node", "load_frame"),))
    with private_domain() as domain, RunningGraph(graph, tmp_path, domain=domain, owner=False) as launched:
        end = time.monotonic() + 180
        while not is_announced(domain, "/rig/load_frame"):
            launched.check()
            assert time.monotonic() < end, "the node is not announced"
            time.sleep(0.1)
        with pytest.raises(ProcessError, match=r"rig 'rig' in ROS domain .* runs already, .*: load_frame; end it"):
            RunningGraph(graph, tmp_path / "second", domain=domain).__enter__()
        with RunningGraph(Graph("other", graph.nodes), tmp_path / "other", domain=domain):
            pass
        launched.kill(["load_frame"])
        with RunningGraph(graph, tmp_path / "second", domain=domain):
            pass


def ending_graph(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> RunningGraph:
    """Return the graph of one node that ends by SIGKILL alone, with short waits before."""
    executable = folder / "stubborn"
    executable.write_text("#!/bin/sh\ntrap '' INT TERM\ntouch \"$0.ready\"\nwhile true; do sleep 0.1; done\n")
    executable.chmod(0o755)
    monkeypatch.setattr(processes, "_executable", lambda _: executable)
    monkeypatch.setattr(processes, "GRACE_S", {signal.SIGINT: 0.2, signal.SIGTERM: 0.2, signal.SIGKILL: 5.0})
    monkeypatch.setattr(processes, "RECORDER_GRACE_S", processes.GRACE_S | {signal.SIGINT: 4.0})
    return RunningGraph(Graph("rig", (NodeEntry(name, "package", name),)), folder, owner=False)


def await_ready(folder: Path) -> None:
    end = time.monotonic() + 60
    while not (folder / "stubborn.ready").exists():
        assert time.monotonic() < end, "the node does not start"
        time.sleep(0.01)


@pytest.mark.parametrize(("name", "long"), [("recorder", True), ("live_view", False)])
def test_only_a_recorder_has_the_time_to_close_a_recording(
    name: str, long: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with ending_graph(name, tmp_path, monkeypatch):
        await_ready(tmp_path)
        begun = time.monotonic()
    assert (time.monotonic() - begun > 4.0) == long


def test_repeated_interruptions_do_not_prolong_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    interruptions = 0

    def interrupt(*_: object) -> None:
        nonlocal interruptions
        with suppress(KeyError):  # the node has ended
            if running.exit_code("recorder") is None and interruptions < 30:
                interruptions += 1
                raise KeyboardInterrupt

    before = signal.signal(signal.SIGALRM, interrupt)
    try:
        running = ending_graph("recorder", tmp_path, monkeypatch).__enter__()
        await_ready(tmp_path)
        signal.setitimer(signal.ITIMER_REAL, 0.3, 0.3)
        with pytest.raises(KeyboardInterrupt):
            running.__exit__(None, None, None)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert 1 < interruptions < 30, "the node ended while the interruptions went on"


def udp_addresses(pid: int, ports: range) -> set[str]:
    """Addresses at which a process has bound one of these ports."""
    sockets = set()
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        with suppress(FileNotFoundError):
            sockets.update(re.findall(r"socket:\[(\d+)\]", str(descriptor.readlink())))
    addresses = set()
    for line in Path(f"/proc/{pid}/net/udp").read_text().splitlines()[1:]:
        fields = line.split()
        address, port = fields[1].split(":")
        if fields[9] in sockets and int(port, 16) in ports:
            addresses.add(socket.inet_ntoa(struct.pack("=I", int(address, 16))))
    return addresses


@pytest.mark.slow
def test_a_graph_leaves_no_process_and_no_shared_memory(tmp_path: Path) -> None:
    rig, programme = load_rig(TINY, None, None)
    one = Programme.model_validate({"experiment": "one", "steps": [{"position_mm": 0.1}]})
    with private_domain() as domain:
        graph = rig_graph(rig, TINY, tmp_path / "run")
        with RunningGraph(graph, tmp_path / "run" / "logs", domain=domain) as running:
            pids = [running.pid(name) for name in graph.names]
            (report,), *_ = drive(running, one, Silent(), domain=domain)
            # ports are numbered through all domains, so that others may use some of the same
            owned = {name for pid in pids for name in shared_memory_of(pid) if "port" not in name}
            largest = max((SHARED_MEMORY / name).stat().st_size for name in owned)
            os.kill(running.pid("phase"), signal.SIGKILL)
        assert not report.error
        assert programme.experiment == "tiny"
    assert largest >= int(node_environment()["FRINGEDIC_SEGMENT_BYTES"])  # as asked for, not the middleware's default
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
    left = owned & {path.name for path in SHARED_MEMORY.iterdir()}
    assert not left, f"used by {[users(name) for name in left]}"


def test_a_client_that_has_ended_keeps_no_shared_memory() -> None:
    def mapped() -> set[str]:
        return set(re.findall(r"fast(?:rtps|dds)_[0-9a-f]{16}", Path("/proc/self/maps").read_text()))

    gc.disable()  # the memory has to be released without the collector
    before = mapped()  # by participants of this process that wait for the collector
    try:
        with private_domain() as domain, RigClient(domain=domain):
            used = mapped() - before
        assert used
        assert not used & mapped()
    finally:
        gc.enable()


@pytest.mark.parametrize("version", ["fastrtps", "fastdds"])
def test_shared_memory_in_use_is_left_alone_and_the_rest_removed(version: str) -> None:
    used, stale = SHARED_MEMORY / f"{version}_00000000000000aa", SHARED_MEMORY / f"{version}_00000000000000bb"
    for path in (used, stale, used.with_name(f"{used.name}_el"), stale.with_name(f"{stale.name}_el")):
        path.write_bytes(b"segment")
    try:
        with used.open("r+b") as file, mmap.mmap(file.fileno(), 0):
            remove_stale_segments()  # a test that runs at the same time may do it instead
            assert used.exists()
            assert used.with_name(f"{used.name}_el").exists()
            assert not stale.exists()
            assert not stale.with_name(f"{stale.name}_el").exists()
        remove_stale_segments()
        assert not used.exists()
    finally:
        for path in SHARED_MEMORY.glob(f"{version}_00000000000000*"):
            path.unlink(missing_ok=True)


@pytest.mark.parametrize("version", ["fastrtps", "fastdds"])
def test_the_port_of_a_killed_node_stays_for_its_successor_while_its_domain_is_used(version: str) -> None:
    killed, other = (SHARED_MEMORY / f"{version}_port{7400 + 250 * 225 + number}" for number in (10, 12))
    try:
        for path in (killed, other):
            path.write_bytes(b"port")
        with other.open("r+b") as file, mmap.mmap(file.fileno(), 0):
            remove_stale_segments()
            assert killed.exists()
        remove_stale_segments()
        assert not killed.exists()
        assert not other.exists()
    finally:
        for path in (killed, other):
            path.unlink(missing_ok=True)


def test_nodes_listen_to_this_computer_alone(tmp_path: Path) -> None:
    graph = Graph("rig", (NodeEntry("coupling", "coupling_node", "coupling"),))
    with private_domain() as domain, RunningGraph(graph, tmp_path, domain=domain) as running:
        # the ports of this domain by the DDS interoperability standard
        ports = range(7400 + 250 * domain, 7400 + 250 * (domain + 1))
        end = time.monotonic() + 180
        while not (addresses := udp_addresses(running.pid("coupling"), ports)):
            running.check()
            assert time.monotonic() < end, "the node does not listen at all"
            time.sleep(0.05)
        assert addresses == {"127.0.0.1"}


def test_nodes_of_one_process_end_and_start_together(tmp_path: Path) -> None:
    names = ["phase", "dic", "coupling"]
    entries = tuple(NodeEntry(name, "fringedic_bringup", COMPOSED, process=COMPOSED) for name in names)
    with private_domain() as domain, RunningGraph(Graph("rig", entries), tmp_path, domain=domain) as running:
        (first,) = {running.pid(name) for name in names}
        running.kill(["dic"])
        assert list(running.dead()) == names
        for name in names:
            running.restart(name)
        (second,) = {running.pid(name) for name in names}
        assert first != second
        assert not running.dead()
        assert {running.log(name).name for name in names} == {"processing.log"}


def test_an_executable_that_is_not_installed_is_named(tmp_path: Path) -> None:
    graph = Graph("rig", (NodeEntry("camera", "camera_node", "periscope"),))
    with pytest.raises(ProcessError, match="camera_node periscope"), RunningGraph(graph, tmp_path):
        pass


def test_replays_at_the_same_time_get_domains_of_their_own() -> None:
    with private_domain() as first, private_domain() as second:
        assert first != second
