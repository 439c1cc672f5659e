"""Processes that a fork server starts, as they look from outside."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from fringedic.errors import ProcessError
from fringedic_ros.node_server import NodeServer, can_fork

NODE = f"""#!{sys.executable}
import os, sys, time
if __name__ == "__main__":
    print(sys.argv[1:], "numba" in sys.modules, os.environ["PLACE"], flush=True)
    if sys.argv[1] == "wait":
        try:
            time.sleep(600)
        except KeyboardInterrupt:
            sys.exit(7)
    sys.exit(int(sys.argv[1]))
"""


@pytest.fixture
def node(tmp_path: Path) -> Path:
    path = tmp_path / "node"
    path.write_text(NODE)
    path.chmod(0o755)
    return path


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[NodeServer]:
    server = NodeServer(
        {**os.environ, "PLACE": "rig", "OPENBLAS_NUM_THREADS": "1"}, tmp_path_factory.mktemp("s") / "log"
    )
    yield server
    server.close()


def written(log: Path, words: str) -> None:
    """Wait for words in a log."""
    end = time.monotonic() + 60
    while words not in log.read_text():
        assert time.monotonic() < end, log.read_text()
        time.sleep(0.01)


def test_a_fork_is_a_process_like_any_other(server: NodeServer, node: Path, tmp_path: Path) -> None:
    log = tmp_path / "node.log"
    log.write_text("before\n")
    ended = server.start([str(node), "3", "a word"], log)
    waits = server.start([str(node), "wait"], tmp_path / "other.log")
    assert ended.wait(60) == 3
    assert log.read_text() == "before\n['3', 'a word'] True rig\n"
    written(tmp_path / "other.log", "wait")
    assert waits.poll() is None
    words = Path(f"/proc/{waits.pid}/cmdline").read_bytes().rstrip(b"\0").split(b"\0")
    assert words == [each.encode() for each in (sys.executable, str(node), "wait")]
    assert Path(f"/proc/{waits.pid}/comm").read_text() == "node\n"
    assert os.getsid(waits.pid) == waits.pid, "Ctrl-C in a terminal reaches the command alone"
    with pytest.raises(subprocess.TimeoutExpired):
        waits.wait(0.01)
    waits.send_signal(signal.SIGINT)
    assert waits.wait(60) == 7
    waits.send_signal(signal.SIGINT)  # to nobody, as the process has ended


def test_a_killed_process_has_the_signal_as_its_code(server: NodeServer, node: Path, tmp_path: Path) -> None:
    process = server.start([str(node), "wait"], tmp_path / "node.log")
    process.kill()
    assert process.wait(60) == -signal.SIGKILL


def test_the_end_of_the_server_ends_its_processes_and_is_told(node: Path, tmp_path: Path) -> None:
    server = NodeServer({**os.environ, "PLACE": "rig", "OPENBLAS_NUM_THREADS": "1"}, tmp_path / "server.log")
    process = server.start([str(node), "wait"], tmp_path / "node.log")
    written(tmp_path / "node.log", "wait")
    parent = int(Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()[1])
    os.kill(parent, signal.SIGKILL)
    assert process.wait(60) == -signal.SIGTERM
    assert not server.runs
    with pytest.raises(ProcessError, match="the process that starts the nodes has ended"):
        server.start([str(node), "wait"], tmp_path / "node.log")
    server.close()


def test_only_scripts_of_this_python_are_forked(node: Path) -> None:
    assert can_fork(node)
    assert not can_fork(Path("/bin/sh"))
