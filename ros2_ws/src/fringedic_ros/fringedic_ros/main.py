"""How every node process starts, runs and ends."""

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

from fringedic.errors import FringedicError

# Fast DDS may keep a process that has closed everything (decision 0033); this long, then SIGALRM ends it.
LONGEST_FAREWELL_S = 5
ENDING = (signal.SIGINT, signal.SIGTERM)
CLEAN_ENDS = (0, -signal.SIGALRM)  # exit codes of a process whose node has closed everything


class _EndAskedFor(Exception):
    """SIGINT or SIGTERM came."""


def run(make_node: Callable[[], Node]) -> int:
    """Spin one node until SIGINT or SIGTERM; return the exit code of the process.

    The signal waits until the node stands and the callback in hand has returned: an exception or a context that is
    shut down amid either leaves a node half made or half destroyed, whose process may not end at all. Signals after
    the first change nothing, so that a second Ctrl-C cannot tear a recording that is being closed.

    A node that cannot start (a named error) ends with its message and code 1; anything unexpected ends with its
    traceback and code 1, so that whoever started the process knows.
    """
    signals = _collect_signals()
    node: Node | None = None
    try:
        rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
        node = make_node()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        _end_at(signals, node)
        executor.spin()
    except _EndAskedFor:
        pass
    except FringedicError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)
        return 1
    except Exception:
        traceback.print_exc()
        return 1
    finally:
        if node is not None:
            with node.handle:  # keeps the participant until the node has closed all that is ours
                node.destroy_node()
                signal.alarm(LONGEST_FAREWELL_S)
        rclpy.try_shutdown()
    return 0


def _collect_signals() -> int:
    """Return the file descriptor that each signal is written to, instead of an exception wherever Python is."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    for number in ENDING:
        signal.signal(number, lambda *_: None)
    return reading


def _end_at(signals: int, node: Node) -> None:
    """Have the executor of a node end with `_EndAskedFor`, between two callbacks, once a signal has come."""

    def end() -> None:
        raise _EndAskedFor

    # a group of its own: the node's may be taken by a callback that waits
    guard = node.create_guard_condition(end, callback_group=ReentrantCallbackGroup())

    def listen() -> None:
        while os.read(signals, 1)[0] not in ENDING:
            pass  # another signal that somebody handles in Python
        guard.trigger()

    threading.Thread(target=listen, name="signals", daemon=True).start()
