"""Node processes and a peer that talks to them, for tests over real DDS."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from typing_extensions import Self


class NodeProcess:
    """A node in a process of its own, from entering to leaving the `with` block.

    Parameters
    ----------
    module
        Module whose `main` runs the node.
    domain
        ROS domain.
    folder
        Where its log goes.
    parameters
        Values of its parameters, as YAML understands them.
    """

    def __init__(self, module: str, domain: int, folder: Path, parameters: Mapping[str, Any] | None = None) -> None:
        self._log = folder / f"{module}.log"
        self._command = [sys.executable, "-c", f"import sys; from {module} import main; sys.exit(main())"]
        values = (parameters or {}).items()
        self._command += ["--ros-args", *(word for name, value in values for word in ("-p", f"{name}:={value}"))]
        self._environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "ROS_PYTHON_CHECK_FIELDS": "1"}

    @property
    def log(self) -> str:
        """What the process has written."""
        return self._log.read_text()

    def __enter__(self) -> Self:
        with self._log.open("w") as log:
            self.process = subprocess.Popen(
                self._command, env=self._environment, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL
            )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        alive = self.process.poll() is None
        if alive:
            self.process.send_signal(signal.SIGINT)
        try:
            code = self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            code = self.process.wait()
        if error is not None:
            print(f"--- {self._log.name}\n{self.log}")
        else:
            assert alive and code == 0, f"the process ended with {code}:\n{self.log}"


class Peer(Node):
    """The other side of a test: publishes, serves and keeps what it hears; spun by the waiting test itself."""

    def __init__(self, name: str = "peer") -> None:
        super().__init__(name)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self)

    def listen(self, kind: type[Any], topic: str, qos: QoSProfile) -> list[Any]:
        """Subscribe and return the list that what arrives is appended to."""
        heard: list[Any] = []
        self.create_subscription(kind, topic, heard.append, qos)
        return heard

    def wait(self, predicate: Callable[[], Any], what: str, timeout_s: float = 60.0) -> None:
        """Serve callbacks until the predicate is true."""
        deadline = time.monotonic() + timeout_s
        while not predicate():
            assert time.monotonic() < deadline, f"{what} did not happen within {timeout_s:g} s"
            self._executor.spin_once(timeout_sec=0.01)

    def serve(self, seconds: float) -> None:
        """Serve callbacks for a time."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self._executor.spin_once(timeout_sec=0.01)

    def destroy_node(self) -> None:
        """Leave the executor first."""
        self._executor.shutdown()
        super().destroy_node()
