"""Starts the node processes of a graph, checks that they run and ends them together."""

from __future__ import annotations

import ctypes
import fcntl
import itertools
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from fringedic.errors import NodeDiedError, ProcessError
from fringedic_bringup.launch.address import own_address
from fringedic_bringup.launch.graph import Graph, NodeEntry
from fringedic_bringup.launch.lease import RigLease
from fringedic_bringup.launch.rig_files import configuration

# Wait after each signal, in which a node finishes its current work.
GRACE_S = {signal.SIGINT: 15.0, signal.SIGTERM: 5.0, signal.SIGKILL: 5.0}
# The recorder writes its backlog and closes the recording: half a gigabyte takes a slow disk two minutes.
RECORDER_GRACE_S = GRACE_S | {signal.SIGINT: 120.0}
SHARED_MEMORY = Path("/dev/shm")
# Of each node, for the images that it sends. A container may have only 64 MB for all nodes of two runs.
SEGMENT_BYTES = 16_000_000
SEGMENTS = 32
BETWEEN_CHECKS_S = 0.2
_SEGMENT = re.compile(r"(?:sem\.)?(?P<name>fastrtps_(?:port\d+|[0-9a-f]{16}))(?:(?P<lock>_[es]l)|_mutex)?")
# The ports of domains above 101 overlap those that Linux assigns to outgoing connections.
PRIVATE_DOMAINS = range(62, 102)
_taken = itertools.count(os.getpid())


class RunningGraph:
    """The processes of one graph; leaving the context manager ends them all.

    Parameters
    ----------
    graph
        The nodes, started in this order. The first one (the recorder) is ended last, so that it receives everything
        that the others publish.
    logs
        Folder for the files ``<node>.log`` and ``<node>.yaml`` (parameters) of each node.
    domain
        ROS_DOMAIN_ID of all nodes; None takes the one of the environment.
    environment
        Further environment variables.
    owner
        Whether these nodes own the rig, which has one owner; False for nodes that look at the rig of another.

    Raises
    ------
    ProcessError
        The executable of a node is not installed, or another process has the rig; nothing was started.
    """

    def __init__(
        self,
        graph: Graph,
        logs: Path,
        *,
        domain: int | None = None,
        environment: Mapping[str, str] | None = None,
        owner: bool = True,
    ) -> None:
        self.graph = graph
        self.logs = Path(logs)
        self.environment = node_environment(domain) | dict(environment or {})
        self._owner = owner
        self._lease = RigLease(int(self.environment.get("ROS_DOMAIN_ID") or 0), graph.namespace, self.logs.parent)
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._may_end: set[str] = set()

    def __enter__(self) -> RunningGraph:
        executables = {entry.name: _executable(entry) for entry in self.graph.nodes}
        if self._owner:
            self._lease.__enter__()
        try:
            self.logs.mkdir(parents=True, exist_ok=True)
            for entry in self.graph.nodes:
                self._start(entry, executables[entry.name])
        except BaseException:
            self.__exit__(*sys.exc_info())
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.stop()
        if self._owner:
            self._lease.__exit__(kind, error, traceback)

    def pid(self, name: str) -> int:
        """Return the process id of a node."""
        return self._processes[name].pid

    def log(self, name: str) -> Path:
        """Return the path of a node's log."""
        return self.logs / f"{name}.log"

    def expect_end(self, name: str) -> None:
        """Allow a node to end by itself with exit code 0."""
        self._may_end.add(name)

    def exit_code(self, name: str) -> int | None:
        """Return the exit code of a node; None while it runs."""
        return self._processes[name].poll()

    def dead(self) -> dict[str, str]:
        """Return the nodes that should run and have ended, with the reason of each."""
        codes = {name: process.poll() for name, process in self._processes.items()}
        return {
            name: _ending(code)
            for name, code in codes.items()
            if code is not None and not (code == 0 and name in self._may_end)
        }

    def check(self) -> None:
        """Raise an error when a node has ended that should run.

        Raises
        ------
        NodeDiedError
            The message contains the end of the node's log.
        """
        for name, how in self.dead().items():
            raise NodeDiedError(f"{name} {how}. The end of {self.log(name)}:\n{self.log_tail(name)}")

    def log_tail(self, name: str, lines: int = 20) -> str:
        """Return the last lines of a node's log."""
        path = self.log(name)
        text = path.read_text(errors="replace") if path.exists() else ""
        return "\n".join(f"  {line}" for line in text.splitlines()[-lines:])

    def restart(self, name: str, **changes: Any) -> None:
        """Start a node that has ended once more, with these parameters changed; its log continues in the same file."""
        entry = next(each for each in self.graph.nodes if each.name == name)
        entry = replace(entry, parameters={**entry.parameters, **changes})
        self._start(entry, _executable(entry))

    def kill(self, names: Iterable[str]) -> None:
        """Kill nodes that do not answer; `dead` contains them then."""
        processes = [self._processes[name] for name in names if name in self._processes]
        for process in processes:
            process.kill()
        for process in processes:
            process.wait(GRACE_S[signal.SIGKILL])

    def stop(self, names: Iterable[str] | None = None) -> None:
        """End the named nodes, or all of them, by SIGINT, then SIGTERM, then SIGKILL.

        The first node of the graph is ended last, after the others.
        """
        chosen = [entry.name for entry in self.graph.nodes if names is None or entry.name in set(names)]
        running = {name: self._processes.pop(name) for name in chosen if name in self._processes}
        first = self.graph.nodes[0].name
        _end([process for name, process in running.items() if name != first], GRACE_S)
        _end([process for name, process in running.items() if name == first], RECORDER_GRACE_S)
        if running:
            remove_stale_segments()

    def _start(self, entry: NodeEntry, executable: Path) -> None:
        parameters = entry.write_parameters(self.logs)
        arguments = ["--ros-args", "-r", f"__node:={entry.name}", "--params-file", str(parameters)]
        if self.graph.namespace:
            arguments += ["-r", f"__ns:=/{self.graph.namespace}"]
        with self.log(entry.name).open("ab") as log:
            self._processes[entry.name] = subprocess.Popen(
                [str(executable), *arguments],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self.environment,
                start_new_session=True,  # Ctrl-C reaches the command alone, which ends its nodes in order
                preexec_fn=_die_with_parent,
            )


def node_environment(domain: int | None = None) -> dict[str, str]:
    """Return the environment of nodes: that of this process, with the settings that reproducible results need.

    Raises
    ------
    ProcessError
        With other computers, and the address of this one cannot be chosen.
    """
    environment = dict(os.environ)
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    environment.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(configuration("fastdds.xml")))
    environment.setdefault("FRINGEDIC_SEGMENT_BYTES", str(_segment_bytes()))
    environment.setdefault("FRINGEDIC_ADDRESS", own_address(environment["ROS_AUTOMATIC_DISCOVERY_RANGE"]))
    environment |= {
        "OPENBLAS_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
        "PYTHONUNBUFFERED": "1",
        "RCUTILS_COLORIZED_OUTPUT": "0",
    }
    # memory that a process keeps between steps need not be cleared again by the kernel
    for name, value in (("ARENA_MAX", 1), ("MMAP_THRESHOLD_", 1 << 30), ("TRIM_THRESHOLD_", 1 << 32)):
        environment.setdefault(f"MALLOC_{name}", str(value))
    if domain is not None:
        environment["ROS_DOMAIN_ID"] = str(domain)
    return environment


def _segment_bytes() -> int:
    """Return the size of a node's shared memory, which Fast DDS allocates at once, so that all nodes have enough."""
    try:
        whole = shutil.disk_usage(SHARED_MEMORY).total
    except OSError:  # not Linux
        return SEGMENT_BYTES
    return min(SEGMENT_BYTES, whole // SEGMENTS)


@contextmanager
def private_domain() -> Iterator[int]:
    """Reserve a ROS domain that no other replay on this machine uses, and yield its number.

    Each search starts one domain further, because a killed process stays in the graph of its domain for 20 s.

    Raises
    ------
    ProcessError
        All of these domains are in use.
    """
    first = next(_taken)
    for turn in range(len(PRIVATE_DOMAINS)):
        domain = PRIVATE_DOMAINS[(first + turn) % len(PRIVATE_DOMAINS)]
        if str(domain) == os.environ.get("ROS_DOMAIN_ID"):
            continue
        path = Path(tempfile.gettempdir()) / f"fringedic-domain-{domain}.{os.getuid()}.lock"
        with path.open("a") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            yield domain
            return
    raise ProcessError(
        f"all ROS domains from {PRIVATE_DOMAINS[0]} to {PRIVATE_DOMAINS[-1]} are used by other replays; wait until one "
        "has ended"
    )


def remove_stale_segments() -> set[str]:
    """Remove this user's Fast DDS shared memory that no process uses, and return the names of the segments.

    Killed processes leave their segments behind, others their ports. A segment is in use when a process has mapped it
    or locked one of its files (``_el``: exclusively, ``_sl``: shared). It is removed when it is unused twice in
    succession, because a process maps a new segment only after it was created.
    """
    stale = _unused_segments()
    if stale:
        time.sleep(BETWEEN_CHECKS_S)
        stale = {path: name for path, name in _unused_segments().items() if path in stale}
    for path in stale:
        path.unlink(missing_ok=True)
    return set(stale.values())


def _unused_segments() -> dict[Path, str]:
    """Return the files of this user's segments that no process has mapped or locked, with the names of the segments."""
    files = [(found, path) for path in SHARED_MEMORY.iterdir() if (found := _SEGMENT.fullmatch(path.name))]
    names = {found["name"] for found, _ in files} - mapped_segments()
    names -= {found["name"] for found, path in files if found["lock"] and _is_locked(path)}
    return {path: found["name"] for found, path in files if found["name"] in names and _is_mine(path)}


def mapped_segments() -> set[str]:
    """Return the segments that are mapped by processes whose memory map this user may read."""
    names: set[str] = set()
    for maps in Path("/proc").glob("[0-9]*/maps"):
        with suppress(OSError):
            names.update(re.findall(r"/dev/shm/(?:sem\.)?(fastrtps_(?:port\d+|[0-9a-f]{16}))", maps.read_text()))
    return names


def _is_locked(path: Path) -> bool:
    # a shared lock conflicts with an exclusive one, but not with that of another process that runs this check
    kind = fcntl.LOCK_SH if path.name.endswith("_el") else fcntl.LOCK_EX
    try:
        with path.open("ab") as file:
            fcntl.flock(file, kind | fcntl.LOCK_NB)
    except OSError:
        return True
    return False


def _is_mine(path: Path) -> bool:
    with suppress(OSError):
        return path.stat().st_uid == os.getuid()
    return False


def _executable(entry: NodeEntry) -> Path:
    try:
        path = Path(get_package_prefix(entry.package)) / "lib" / entry.package / entry.executable
    except PackageNotFoundError:
        path = None
    if path is None or not path.exists():
        raise ProcessError(
            f"{entry.package} {entry.executable} is not installed: run `make setup`, or build the workspace with "
            "`colcon build` and source it"
        )
    return path


def _end(processes: list[subprocess.Popen[bytes]], grace_s: Mapping[signal.Signals, float]) -> None:
    for number, grace in grace_s.items():
        for process in processes:
            if process.poll() is None:
                process.send_signal(number)
        end = time.monotonic() + grace
        for process in processes:
            try:
                process.wait(max(0.0, end - time.monotonic()))
            except subprocess.TimeoutExpired:
                continue
        if all(process.poll() is not None for process in processes):
            return


def _ending(code: int) -> str:
    if code >= 0:
        return f"ended with exit code {code}"
    return f"was ended by {signal.Signals(-code).name}"


_LIBC = ctypes.CDLL(None) if sys.platform == "linux" else None
_PR_SET_PDEATHSIG = 1


def _die_with_parent() -> None:
    """Request Linux to end this node when the command that started it ends for any reason."""
    if _LIBC is not None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
