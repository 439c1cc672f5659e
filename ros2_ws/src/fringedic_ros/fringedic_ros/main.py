"""How every node process starts, runs and ends."""

from __future__ import annotations

import sys
import time
import traceback
from collections.abc import Callable

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from fringedic.errors import FringedicError

SIGNAL_S = 0.5


def run(make_node: Callable[[], Node]) -> int:
    """Spin one node until SIGINT or SIGTERM; return the exit code of the process.

    A node that cannot start (a named error) ends with its message and code 1; anything unexpected ends with its
    traceback and code 1, so that whoever started the process knows.
    """
    node: Node | None = None
    initialised = False
    try:
        rclpy.init(args=sys.argv)
        initialised = True
        node = make_node()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except FringedicError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
        return 1
    except Exception:
        if not initialised or _goes_on():
            traceback.print_exc()
            return 1
        # a signal ended the context: while the node was made, or between two steps of the executor
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _goes_on() -> bool:
    """Whether no signal has ended the context; it may break what is in hand just before the context hears of it."""
    end = time.monotonic() + SIGNAL_S
    try:
        while rclpy.ok() and time.monotonic() < end:
            time.sleep(0.01)
    except KeyboardInterrupt:  # Python hears of the same signal
        return False
    return rclpy.ok()
