"""Start, run and end of every process of nodes."""

from __future__ import annotations

import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable

import rclpy
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import get_default_context

from fringedic.errors import FringedicError
from fringedic_ros import middleware
from fringedic_ros.parameters import report_unknown_parameters
from fringedic_ros.presence import announce

ENDING = (signal.SIGINT, signal.SIGTERM)


class _EndRequested(Exception):
    """SIGINT or SIGTERM was received."""


def run(*makers: Callable[[], Node]) -> int:
    """Spin nodes in one thread until SIGINT or SIGTERM; return the exit code of the process.

    A signal has an effect after the nodes are complete and the running callback has returned: an exception in between
    would leave an incomplete node, whose process may not end. Further signals are ignored, so that a second Ctrl-C does
    not interrupt the closing of a recording.

    A node that cannot start (a `FringedicError`) ends with its message and code 1, every other error with its traceback
    and code 1.

    Parameters
    ----------
    makers
        Make the nodes, which are ended in the same order.
    """
    signals = _collect_signals()
    nodes: list[Node] = []
    try:
        rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
        middleware.enter(get_default_context().get_domain_id())
        executor = SingleThreadedExecutor()
        for make in makers:
            nodes.append(node := make())
            announce(node)
            report_unknown_parameters(node)
            executor.add_node(node)
        _end_at(signals, nodes[0])
        executor.spin()
    except _EndRequested:
        pass
    except FringedicError as error:
        sys.stderr.write(f"{type(error).__name__}: {error}\n")
        return 1
    except Exception:
        traceback.print_exc()
        return 1
    finally:
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _collect_signals() -> int:
    """Return the file descriptor that receives each signal, in place of an exception at an arbitrary line."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    for number in ENDING:
        signal.signal(number, lambda *_: None)
    return reading


def _end_at(signals: int, node: Node) -> None:
    """End the executor of a node with `_EndRequested`, between two callbacks, after a signal."""

    def end() -> None:
        raise _EndRequested

    # a group of its own: a waiting callback may occupy that of the node
    guard = node.create_guard_condition(end, callback_group=ReentrantCallbackGroup())

    def listen() -> None:
        while os.read(signals, 1)[0] not in ENDING:
            pass  # another signal with a handler in Python
        guard.trigger()

    threading.Thread(target=listen, name="signals", daemon=True).start()
