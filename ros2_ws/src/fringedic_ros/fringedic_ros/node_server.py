"""Starts nodes as copies of one process that has imported their libraries (a fork server).

The libraries of a node (NumPy, pandas, SciPy, Numba) take a processor some seconds to import, and a rig has ten nodes.
One process imports them, and each node is a fork of it. A node remains a process of its own, with its own log, signals,
exit code and command line; only its executable has to be a Python script of this environment.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import NoReturn

from fringedic.errors import ProcessError

# Not rclpy: its middleware starts threads, which a fork does not copy.
LIBRARIES = (
    "cv2",
    "fringedic.calibration.session",
    "fringedic.configuration.rig_file",
    "fringedic.steps.displacement_tracker",
    "fringedic.steps.phase",
    "fringedic.steps.shape_tracker",
    "fringedic.virtual_rig",
)
_COMMAND_BYTES = 4096  # room for the longest command line of a node
_MESSAGE_BYTES = 1 << 16
_START_S = 120.0  # until the libraries are imported, on a busy computer
_PR_SET_NAME, _PR_SET_PDEATHSIG = 15, 1


class ForkedProcess:
    """A process that a `NodeServer` has started, with the methods of `subprocess.Popen` that need no pipe."""

    def __init__(self, server: NodeServer, pid: int, handle: int) -> None:
        self.pid = pid
        self._server = server
        self._handle = handle  # file descriptor of the process, which no other process with this number can have

    def __del__(self) -> None:
        os.close(self._handle)

    def poll(self) -> int | None:
        """Return the exit code, negative after a signal; None while the process runs."""
        return self._server.exit_code(self.pid, self._handle)

    def wait(self, timeout: float) -> int:
        """Return the exit code after the end of the process.

        Raises
        ------
        subprocess.TimeoutExpired
            The process runs after `timeout` [s].
        """
        select.select([self._handle], [], [], timeout)
        while (code := self.poll()) is None:
            if not select.select([self._handle], [], [], 0)[0]:
                raise subprocess.TimeoutExpired(str(self.pid), timeout)
            self._server.receive(1.0)  # it has ended, and its code comes at once
        return code

    def send_signal(self, number: signal.Signals) -> None:
        """Send a signal, unless the process has ended."""
        if self.poll() is None:
            signal.pidfd_send_signal(self._handle, number)

    def kill(self) -> None:
        """End the process by SIGKILL."""
        self.send_signal(signal.SIGKILL)


class NodeServer:
    """A process with imported libraries, which starts nodes as copies of itself; they end with it.

    Parameters
    ----------
    environment
        Environment of all nodes.
    log
        File for what the server itself writes, which is a traceback or nothing.
    """

    def __init__(self, environment: Mapping[str, str], log: Path) -> None:
        self._log = log
        self._channel, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._codes: dict[int, int] = {}
        self._started: list[ForkedProcess] = []
        # /proc shows the memory of the arguments, which has the size of the first ones
        room = "-" * _COMMAND_BYTES
        with other, log.open("ab") as file:
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__, str(other.fileno()), room],
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                env=dict(environment),
                pass_fds=[other.fileno()],
                start_new_session=True,  # Ctrl-C reaches the command alone, which ends its nodes in order
                preexec_fn=die_with_parent,
            )

    @property
    def runs(self) -> bool:
        """Whether the process of the server runs."""
        return self._process.poll() is None

    def start(self, command: Sequence[str], log: Path) -> ForkedProcess:
        """Start a process with the script and the arguments of a command; its output is appended to a file.

        Raises
        ------
        ProcessError
            The server does not run.
        """
        with log.open("ab") as file:
            try:
                socket.send_fds(self._channel, [json.dumps(list(command)).encode()], [file.fileno()])
            except OSError:
                self._fail()
        while not self._started:
            if not self.receive(_START_S):
                self._fail()
        return self._started.pop()

    def exit_code(self, pid: int, handle: int) -> int | None:
        """Return the exit code of a process; None while it runs. One that ended with its server was terminated."""
        while self.receive(0.0):
            pass
        if pid not in self._codes and not self.runs and select.select([handle], [], [], 0)[0]:
            return -signal.SIGTERM
        return self._codes.get(pid)

    def receive(self, timeout_s: float) -> bool:
        """Take one message of the server, which may come within `timeout_s`; return whether one came."""
        if not select.select([self._channel], [], [], timeout_s)[0]:
            return False
        data, handles, *_ = socket.recv_fds(self._channel, _MESSAGE_BYTES, 1)
        if not data:
            return False
        message = json.loads(data)
        if handles:
            self._started.append(ForkedProcess(self, message["pid"], handles[0]))
        else:
            self._codes[message["pid"]] = message["code"]
        return True

    def close(self) -> None:
        """End the server; a node that it has started and that still runs is terminated."""
        self._channel.close()
        self._process.wait()

    def _fail(self) -> NoReturn:
        raise ProcessError(f"the process that starts the nodes has ended:\n{self._log.read_text(errors='replace')}")


def can_fork(executable: Path) -> bool:
    """Return whether an executable is a script of this Python, and the system can watch forks of others."""
    if not hasattr(os, "pidfd_open"):
        return False
    with executable.open("rb") as file:
        return file.readline().decode(errors="replace").strip() == f"#!{sys.executable}"


def die_with_parent() -> None:
    """Request Linux to end this process when the one that started it ends for any reason."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _serve(channel: socket.socket) -> list[str]:
    """Start a process for every command that comes; return in each of them, with its command."""
    ended, wakes = os.pipe()
    os.set_blocking(ended, False)
    os.set_blocking(wakes, False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wakes)
    while True:
        ready, _, _ = select.select([channel.fileno(), ended], [], [])
        if ended in ready:
            os.read(ended, 4096)
            _report_ends(channel)
        if channel.fileno() in ready:
            data, descriptors, *_ = socket.recv_fds(channel, _MESSAGE_BYTES, 1)
            if not data:
                sys.exit(0)
            (log,) = descriptors
            pid = os.fork()
            if pid == 0:
                signal.set_wakeup_fd(-1)
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                for descriptor in (ended, wakes, channel.detach()):
                    os.close(descriptor)
                _become(command := json.loads(data), log)
                return command
            os.close(log)
            handle = os.pidfd_open(pid)
            socket.send_fds(channel, [json.dumps({"pid": pid}).encode()], [handle])
            os.close(handle)


def _report_ends(channel: socket.socket) -> None:
    while True:
        try:
            pid, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return
        if pid == 0:
            return
        channel.send(json.dumps({"pid": pid, "code": os.waitstatus_to_exitcode(status)}).encode())


def _become(command: list[str], log: int) -> None:
    """Give this process the session, the output and the names of a node."""
    os.setsid()
    die_with_parent()
    os.dup2(log, 1)
    os.dup2(log, 2)
    os.close(log)
    words = [sys.executable, *command]
    sys.argv = command
    fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
    start, end = int(fields[45]), int(fields[46])  # arg_start and arg_end of proc(5)
    line = "\0".join(words).encode()[: end - start - 1]
    ctypes.memmove(start, line.ljust(end - start, b"\0"), end - start)
    ctypes.CDLL(None).prctl(_PR_SET_NAME, Path(command[0]).name.encode()[:15], 0, 0, 0)


def main() -> None:
    """Import the libraries, then start nodes; run one of them in each process."""
    channel = socket.socket(fileno=int(sys.argv[1]))
    for name in LIBRARIES:
        importlib.import_module(name)
    with suppress(
        ImportError
    ):  # of an extra; where it is installed, xarray imports it with the first dataset of a process
        importlib.import_module("dask.array")
    assert len(os.listdir("/proc/self/task")) == 1, "a fork copies one thread"
    command = _serve(channel)
    runpy.run_path(command[0], run_name="__main__")


if __name__ == "__main__":
    main()
