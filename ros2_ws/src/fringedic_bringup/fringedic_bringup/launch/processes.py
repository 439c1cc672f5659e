"""Starts the node processes of a graph, checks that they run and ends them together."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from fringedic.errors import NodeDiedError, ProcessError
from fringedic.warm_up import require_kernels
from fringedic_bringup.launch.environment import domain_of, node_environment
from fringedic_bringup.launch.graph import PROCESSING_NODES, Graph, NodeEntry
from fringedic_bringup.launch.lease import RigLease
from fringedic_ros import middleware
from fringedic_ros.node_server import ForkedProcess, NodeServer, can_fork, die_with_parent
from fringedic_ros.presence import is_announced

RECORDER = "recorder"
# Wait after each signal, in which a node finishes its current work.
GRACE_S = {signal.SIGINT: 15.0, signal.SIGTERM: 5.0, signal.SIGKILL: 5.0}
# The recorder writes its backlog and closes the recording: half a gigabyte takes a slow disk two minutes.
RECORDER_GRACE_S = GRACE_S | {signal.SIGINT: 120.0}
ENDING_S = 10.0  # longest wait for the nodes of a command that has just been killed


class RunningGraph:
    """The processes of one graph; leaving the context manager ends them all.

    Parameters
    ----------
    graph
        The nodes, started in this order. The recorder is ended last, so that it receives everything that the others
        publish.
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
        The executable of a node is not installed, another process has the rig, or one of its nodes runs already;
        nothing was started.
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
        self._domain = domain_of(self.environment)
        self._lease = RigLease(self._domain, graph.namespace, self.logs.parent)
        self._server: NodeServer | None = None
        self._processes: dict[str, subprocess.Popen[bytes] | ForkedProcess] = {}
        self._may_end: set[str] = set()
        self._ending_since: dict[str, float] = {}

    def __enter__(self) -> RunningGraph:
        executables = {name: _executable(entries[0]) for name, entries in self.graph.processes.items()}
        if not PROCESSING_NODES.keys().isdisjoint(node.own_name for node in self.graph.nodes):
            require_kernels(lambda words: sys.stderr.write(f"{words}\n"))  # before a node is waited for
        if self._owner:
            self._lease.__enter__()
        try:
            if self._owner:
                require_no_nodes(self._domain, self.graph)
            self.logs.mkdir(parents=True, exist_ok=True)
            for name, entries in self.graph.processes.items():
                self._start(name, entries, executables[name])
        except BaseException:
            self.__exit__(*sys.exc_info())
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        interruption: KeyboardInterrupt | None = None
        while True:
            try:
                self.stop()
                break
            except KeyboardInterrupt as another:  # the recorder needs its time to close the recording
                interruption = another
        if self._server is not None:
            self._server.close()
            self._server = None
        if self._owner:
            self._lease.__exit__(kind, error, traceback)
        if interruption is not None:
            raise interruption

    def pid(self, name: str) -> int:
        """Return the process id of a node."""
        return self._processes[name].pid

    def log(self, name: str) -> Path:
        """Return the path of a node's log, which is that of its process."""
        shared = {entry.name: entry.process for entry in self.graph.nodes}.get(name)
        return self.logs / f"{shared or name}.log"

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

    def check(self, names: Collection[str] | None = None) -> None:
        """Raise an error when a node has ended that should run: one of the named nodes, or any.

        Raises
        ------
        NodeDiedError
            The message contains the end of the node's log; that about a named node its path.
        """
        for name, how in self.dead().items():
            if names is None:
                raise NodeDiedError(f"{name} {how}. The end of {self.log(name)}:\n{self.log_tail(name)}")
            if name in names:
                raise NodeDiedError(f"{name} {how} (see {self.log(name)})")

    def log_tail(self, name: str, lines: int = 20) -> str:
        """Return the last lines of a node's log."""
        path = self.log(name)
        text = path.read_text(errors="replace") if path.exists() else ""
        return "\n".join(f"  {line}" for line in text.splitlines()[-lines:])

    def restart(self, name: str, **changes: Any) -> None:
        """Start a node that has ended once more, with these parameters changed; its log continues in the same file.

        The nodes of its process start with it.
        """
        if name in self._processes and self._processes[name].poll() is None:
            return  # with another node of its process
        entry = next(each for each in self.graph.nodes if each.name == name)
        process = entry.process or name
        entries = [
            replace(
                each, parameters={**each.parameters, **each.changes_at_restart, **(changes if each is entry else {})}
            )
            for each in self.graph.processes[process]
        ]
        self._start(process, entries, _executable(entry))

    def kill(self, names: Iterable[str]) -> None:
        """Kill nodes that do not answer; `dead` contains them then."""
        processes = [self._processes[name] for name in names if name in self._processes]
        for process in processes:
            process.kill()
        for process in processes:
            process.wait(GRACE_S[signal.SIGKILL])

    def stop(self, names: Iterable[str] | None = None) -> None:
        """End the named nodes, or all of them, by SIGINT, then SIGTERM, then SIGKILL.

        The recorder is ended after the others. When an interruption ends this wait, the next call goes on with it: each
        node has its grace once.
        """
        chosen = self.graph.names if names is None else set(names)
        running = [name for name in self._processes if name in chosen]
        self._end([name for name in running if name != RECORDER], GRACE_S)
        self._end([name for name in running if name == RECORDER], RECORDER_GRACE_S)
        for name in running:  # not earlier: this may have been interrupted
            del self._processes[name], self._ending_since[name]
        if running:
            middleware.remove_leftovers()

    def _end(self, names: Sequence[str], grace_s: Mapping[signal.Signals, float]) -> None:
        processes = list(dict.fromkeys(self._processes[name] for name in names))
        end = max((self._ending_since.setdefault(name, time.monotonic()) for name in names), default=0.0)
        for number, grace in grace_s.items():
            end += grace
            for process in processes:
                if process.poll() is None:
                    process.send_signal(number)
            for process in processes:
                with suppress(subprocess.TimeoutExpired):
                    process.wait(max(0.0, end - time.monotonic()))
            if all(process.poll() is not None for process in processes):
                return

    def _start(self, name: str, entries: Sequence[NodeEntry], executable: Path) -> None:
        arguments = ["--ros-args"]
        for entry in entries:
            arguments += ["--params-file", str(entry.write_parameters(self.logs))]
        if name == entries[0].name:  # the nodes of a shared process have their own names
            arguments += ["-r", f"__node:={entries[0].own_name}"]
        if namespace := "/".join(filter(None, (self.graph.namespace, entries[0].sensor))):
            arguments += ["-r", f"__ns:=/{namespace}"]
        for used, found in entries[0].remappings.items():
            arguments += ["-r", f"{used}:={found}"]
        process = self._process([str(executable), *arguments], self.log(entries[0].name))
        self._processes |= {entry.name: process for entry in entries}

    def _process(self, command: list[str], log: Path) -> subprocess.Popen[bytes] | ForkedProcess:
        if can_fork(Path(command[0])):
            if self._server is None or not self._server.runs:
                self._server = NodeServer(self.environment, self.logs / "libraries.log")
            return self._server.start(command, log)
        with log.open("ab") as file:
            return subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
                env=self.environment,
                start_new_session=True,  # Ctrl-C reaches the command alone, which ends its nodes in order
                preexec_fn=die_with_parent,
            )


def require_no_nodes(domain: int, graph: Graph) -> None:
    """Check that no node of a graph runs on this computer, after those that are ending have had some seconds for it.

    Raises
    ------
    ProcessError
        The message names the nodes.
    """
    place = f"/{graph.namespace}" if graph.namespace else ""
    end = time.monotonic() + ENDING_S
    while names := [name for name in graph.names if is_announced(domain, f"{place}/{name}")]:
        if time.monotonic() > end:
            raise ProcessError(
                f"rig '{graph.namespace or '/'}' in ROS domain {domain} runs already, started by ros2 launch or ros2 "
                f"run: {', '.join(names)}; end it, or choose another namespace or ROS_DOMAIN_ID"
            )
        time.sleep(0.1)


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


def _ending(code: int) -> str:
    if code >= 0:
        return f"ended with exit code {code}"
    return f"was ended by {signal.Signals(-code).name}"
