"""Moves that another user of the computer could have sent, whose process has a port of the ROS domain."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from rclpy.action import ActionClient
from rclpy.task import Future
from std_srvs.srv import Trigger

from fringedic_msgs.action import MoveCrosshead
from fringedic_ros.middleware import other_users
from fringedic_ros.middleware.fast_dds import memory_of_port, number_of_port
from fringedic_ros.middleware.other_users import participants_of_others
from fringedic_ros.spinning import Spinning
from fringedic_ros.testing import Peer
from load_frame_node.load_frame_node import LoadFrameNode

NOBODY = 65534
TAKE_A_PORT = """
import os, socket, sys
os.setgroups([]); os.setgid(int(sys.argv[1])); os.setuid(int(sys.argv[1]))
taken = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
taken.bind(("127.0.0.1", int(sys.argv[2])))
print("taken", flush=True)
sys.stdin.read()
"""


@contextmanager
def port_of(user: int, port: int) -> Iterator[None]:
    """Let a process of a user have a UDP port."""
    command = [sys.executable, "-c", TAKE_A_PORT, str(user), str(port)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "taken\n"
        yield
        process.communicate()


@pytest.mark.usefixtures("ros")
@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_moves_are_refused_while_another_user_is_in_the_domain(
    monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    monkeypatch.setattr(other_users, "REMEMBERED_S", 0.2)
    with Spinning() as spinning:
        node = spinning.add(LoadFrameNode.started())
        domain = node.context.get_domain_id()
        operator = Peer()
        hold = operator.create_client(Trigger, "load_frame/hold")
        move = ActionClient(operator, MoveCrosshead, "move_crosshead")

        def started(position: float, speed: float = 1e-3) -> Future:
            operator.wait(move.server_is_ready, "the action server")
            operator.meet("load_frame")
            goal = move.send_goal_async(MoveCrosshead.Goal(position=position, speed=speed))
            operator.wait(goal.done, "the answer to the goal")
            return goal.result().get_result_async()

        def ended(move: Future) -> MoveCrosshead.Result:
            operator.wait(move.done, "the end of the move", 40.0)
            return move.result().result

        port = 7400 + 250 * domain + 249  # the last one of the domain, which no node of this test has
        begun = started(1e-4, 1e-4)
        with port_of(NOBODY, port):
            refused = ended(started(2e-4))
            assert ended(begun).error_code == MoveCrosshead.Result.NONE, "a move that has begun goes on"
            assert operator.ask(hold, Trigger.Request(), "the hold").success
        memory = memory_of_port(domain, number_of_port(port))
        lock = memory.with_name(f"{memory.name}_el")
        with port_of(NOBODY, port), port_of(NOBODY, port + 1):  # which is one of the next domain
            assert participants_of_others(domain) == {(NOBODY, port)}
            with lock.open("w") as file:
                request.addfinalizer(lock.unlink)
                os.chown(lock, NOBODY, NOBODY)
                assert participants_of_others(domain), "a program that was killed left it"
                fcntl.flock(file, fcntl.LOCK_EX)
                assert not participants_of_others(domain), "it receives in shared memory"
                operator.wait(lambda: not ended(started(0.0)).error_code, "a move of this user", 40.0)
        operator.destroy_node()
    assert refused.error_code == MoveCrosshead.Result.MACHINE_FAULT
    assert refused.error_message.startswith(
        f"no move was sent: user nobody has a program without shared memory in ROS domain {domain} on this "
        f"computer (UDP port {port})"
    )
    assert refused.position <= 1e-4
