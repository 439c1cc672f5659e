"""Ports in shared memory: of a node that is started again, and of one that stands still."""

from __future__ import annotations

import mmap
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
import pytest
from rclpy.node import Node
from std_msgs.msg import Int64

from fringedic_ros.middleware.fast_dds import (
    AUTOMATIC,
    NUMBERS,
    SHARED_MEMORY,
    VARIABLE,
    choose_participant_number,
    memory_of_port,
    name_of_version,
    port_exists,
)
from fringedic_ros.spinning import Spinning

STOOD_STILL_S = 2.5  # a busy computer lets threads wait as long
STOPS = 3  # how long a port counts as alive without a sign depends on when it was looked at last
RECEIVED_S = 30.0  # on a busy computer; on a port without publishers nothing is ever received
READER = """
from fringedic_ros.main import run
from rclpy.node import Node
from std_msgs.msg import Int64
def make():
    node = Node("reader")
    node.create_subscription(Int64, "counted", lambda message: print(message.data, flush=True), 10)
    return node
run(make)
"""


@contextmanager
def reader(log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a node that writes the numbers which it receives into a file."""
    with log.open("w") as out, subprocess.Popen([sys.executable, "-c", READER], stdout=out) as process:
        try:
            yield process
        finally:
            process.kill()


def receives(log: Path) -> bool:
    end = time.monotonic() + RECEIVED_S
    while not (received := any(line.isdecimal() for line in log.read_text().splitlines())) and time.monotonic() < end:
        time.sleep(0.05)
    return received


def own_port(pid: int) -> Path:
    """Return the memory of a process's port for user data; it has the lock open. Ports below serve the graph."""
    opened = [os.readlink(link) for link in Path(f"/proc/{pid}/fd").iterdir() if link.is_symlink()]
    locked = [found for path in opened if (found := re.fullmatch(r"(/dev/shm/fast(?:rtps|dds)_port(\d+))_el", path))]
    (port,) = [found[1] for found in locked if int(found[2]) >= 7400]
    return Path(port)


def let_its_listener_neither_wait_nor_process(port: Path) -> None:
    """Change the state of the only listener of a port, as an interruption between two messages leaves it.

    1024 states of 20 bytes stand before the name of the memory; the lowest bit of one says that it is in use.
    """
    with port.open("r+b") as file, mmap.mmap(file.fileno(), 0) as memory:
        state = memory.find(f"{name_of_version(os.environ)}\0".encode()) - 1024 * 20
        assert memory[state] & 1, "the layout of another version of Fast DDS"
        memory[state] = 1


@pytest.fixture
def counting(spinning: Spinning) -> None:
    """Publish what the reader reads."""
    node = spinning.add(Node("counter"))
    publisher = node.create_publisher(Int64, "counted", 10)
    node.create_timer(0.05, lambda: publisher.publish(Int64(data=1)))


@pytest.mark.usefixtures("counting")
def test_a_node_receives_whose_predecessor_was_killed_between_two_messages(tmp_path: Path) -> None:
    with reader(tmp_path / "first") as killed:
        assert receives(tmp_path / "first")
        os.kill(killed.pid, signal.SIGSTOP)
        let_its_listener_neither_wait_nor_process(own_port(killed.pid))
    with reader(tmp_path / "second"):
        assert receives(tmp_path / "second")


@pytest.mark.usefixtures("counting")
def test_the_port_of_a_node_that_stood_still_is_not_replaced(tmp_path: Path) -> None:
    with reader(tmp_path / "log") as stopped:
        assert receives(tmp_path / "log")
        port = own_port(stopped.pid)
        before = port.stat().st_ino
        for _ in range(STOPS):
            os.kill(stopped.pid, signal.SIGSTOP)
            time.sleep(STOOD_STILL_S)
            os.kill(stopped.pid, signal.SIGCONT)
            (tmp_path / "log").write_text("")
            assert receives(tmp_path / "log")
            assert port.stat().st_ino == before


def test_a_number_is_chosen_whose_port_does_not_exist(domain: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, str(AUTOMATIC))
    memories = [memory_of_port(domain, number) for number in range(NUMBERS)]
    assert memories[3].name.endswith(f"_port{7400 + 250 * domain + 2 * 3 + 11}")
    left = [memory.with_name(f"{memory.name}_el") for memory in memories]
    made = [path for path in left if not path.exists()]
    try:
        for path in made:
            path.touch()
        assert choose_participant_number(domain) == AUTOMATIC
        made[7].unlink()
        assert choose_participant_number(domain) == left.index(made[7])
        assert os.environ[VARIABLE] == str(left.index(made[7]))
    finally:
        for path in made:
            with suppress(FileNotFoundError):
                path.unlink()
    assert not port_exists(domain, left.index(made[7]))


SENDING = 32768  # first port that Linux assigns by itself; Fast DDS sends from such ones
OPEN_ALL = """
import os, sys
os.setgroups([]); os.setgid(65534); os.setuid(65534)
for path in sys.argv[1:]:
    for flags in (os.O_RDONLY, os.O_RDWR):
        try:
            os.open(path, flags)
        except PermissionError:
            continue
        print(path)
"""


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
@pytest.mark.usefixtures("counting")
def test_another_user_cannot_open_the_memory_of_a_node(tmp_path: Path) -> None:
    with reader(tmp_path / "log") as process:
        assert receives(tmp_path / "log")
        maps = Path(f"/proc/{process.pid}/maps").read_text()
        used = sorted(set(re.findall(r"/dev/shm/fast(?:rtps|dds)_\w+", maps)))
        assert len(used) >= 3, "its memory, that of its ports, and that of the publisher"
        receiving = [each.laddr for each in psutil.Process(process.pid).net_connections() if each.laddr.port < SENDING]
        opened = subprocess.run([sys.executable, "-c", OPEN_ALL, *used], stdout=subprocess.PIPE, text=True, check=True)
    assert {address.ip for address in receiving} == {"127.0.0.1"}
    assert not opened.stdout, "setup/environment.sh loads private_memory.so"


@pytest.mark.parametrize("distribution", ["jazzy", "kilted"])
def test_only_the_owner_may_read_memory_with_the_name_of_each_version(distribution: str) -> None:
    """`private_memory.so` takes away the permission that the middleware gives to others."""
    memory = SHARED_MEMORY / f"{name_of_version({'ROS_DISTRO': distribution})}_00000000000000dd"
    try:
        with memory.open("wb") as file:
            os.fchmod(file.fileno(), 0o644)
        assert memory.stat().st_mode & 0o777 == 0o600
    finally:
        memory.unlink()
