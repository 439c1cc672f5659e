"""Background thread for work that is too heavy for the thread of the executor."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable

from rclpy.node import Node
from rclpy.task import Future

Job = Callable[[], None]


class Worker:
    """Runs jobs one after the other, in the order in which they were submitted.

    Parameters
    ----------
    node
        Its executor is woken when a future completes.
    on_error
        Called in the background thread with the exception of a submitted job; by default, the node logs it as an error.
    """

    def __init__(self, node: Node, on_error: Callable[[Exception], None] | None = None) -> None:
        self._node = node
        self._on_error = on_error or self._log
        self._jobs: queue.SimpleQueue[Job | None] = queue.SimpleQueue()
        self._pending = 0
        self._lock = threading.Lock()
        self._stopped = False
        # a daemon: a blocked driver must not keep the process alive
        self._thread = threading.Thread(target=self._run, name=f"{node.get_name()}-worker", daemon=True)
        self._thread.start()

    @property
    def pending(self) -> int:
        """Jobs that are queued or running."""
        return self._pending

    def submit(self, function: Callable[..., object], *arguments: object) -> None:
        """Queue a job without result; `on_error` receives its exception."""

        def job() -> None:
            try:
                function(*arguments)
            except Exception as error:
                self._on_error(error)

        self._put(job)

    def run(self, function: Callable[..., object], *arguments: object) -> Future:
        """Queue a job and return the future of its result, for `wait_for`."""
        future = Future()

        def job() -> None:
            try:
                result = function(*arguments)
            except Exception as error:
                future.set_exception(error)
            else:
                future.set_result(result)

        self._put(job)
        return future

    def await_idle(self, timeout_s: float) -> None:
        """Block until all jobs have returned, for `timeout_s` at most."""
        deadline = time.monotonic() + timeout_s
        while self._pending and time.monotonic() < deadline:
            time.sleep(0.01)

    def stop(self, timeout_s: float = 5.0) -> bool:
        """Discard the queued jobs and wait for the running one; return False when it still runs after `timeout_s`."""
        self._stopped = True
        self._jobs.put(None)
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _put(self, job: Job) -> None:
        with self._lock:
            self._pending += 1
        self._jobs.put(job)

    def _run(self) -> None:
        while (job := self._jobs.get()) is not None and not self._stopped:
            try:
                job()
            finally:
                with self._lock:
                    self._pending -= 1

    def _log(self, error: Exception) -> None:
        self._node.get_logger().error(f"{type(error).__name__}: {error}")
