"""A running rig with faults in its steps, for the tests of faults."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from running_system import WORKING, wait_until

from fringedic.errors import StepFailedError
from fringedic.recording.reader import BagReader
from fringedic_bringup.client import RigClient
from fringedic_bringup.launch.processes import RunningGraph
from fringedic_msgs.action import MeasureStep, MoveCrosshead
from fringedic_ros.stamps import to_nanoseconds

FRAMES = 12
MM = 1e-3


class Rig:
    """The processes of a rig, and their controller.

    Parameters
    ----------
    running, client
        The processes and the controller.
    folder
        Folder of the run.
    measured
        Whether the steps are measured, not only recorded.
    """

    def __init__(self, running: RunningGraph, client: RigClient, folder: Path, *, measured: bool = True) -> None:
        self.running, self.client, self.folder, self._measured = running, client, folder, measured

    def works(self) -> MeasureStep.Result:
        """Measure a step that has to succeed."""
        result = self.client.measure()
        assert result.load_samples > 3, result
        assert result.valid_fraction > WORKING or not self._measured, result
        return result

    def works_again(self) -> bool:
        """Return whether a step can be measured."""
        try:
            self.works()
        except StepFailedError:  # the node or device is not available again yet
            return False
        return True

    def fails(self, words: str, *, at_frame: int = 0, then: Callable[[], object] = lambda: None) -> None:
        """Measure a step that has to fail; call a function when a frame has been taken."""
        done = False

        def look(feedback: MeasureStep.Feedback) -> None:
            nonlocal done
            if feedback.frame >= at_frame and not done:
                done = True
                then()

        with pytest.raises(StepFailedError, match=rf"step \d+: {words}"):
            self.client.measure(feedback=look)

    @contextmanager
    def settings(self, **values: Any) -> Iterator[None]:
        """Change parameters of the experiment node until the end of the block."""
        before = {"hold_required": True, "load_drift_n": 0.0}
        self.set("experiment", values)
        try:
            yield
        finally:
            self.set("experiment", {name: before[name] for name in values})

    def set(self, node: str, values: dict[str, Any]) -> None:
        """Set parameters of a node."""
        result = set_parameters(self.client, node, values)
        assert result.successful, result.reason

    @contextmanager
    def creeping(self) -> Iterator[None]:
        """Move the machine slowly; only a request to hold stops it, and there has to be one."""
        self.client.move(0.0, 5 * MM)
        goal = MoveCrosshead.Goal(position=0.9 * MM, speed=0.05 * MM, controller="creep")
        with action(self.client, MoveCrosshead, "move_crosshead", "load_frame") as move:
            sent = move.send_goal_async(goal)
            self.client.wait_for(sent.done, 20.0, lambda: "the start of the motion")
            with self.settings(hold_required=False):
                yield
            ended = sent.result().get_result_async()
            self.client.wait_for(ended.done, 30.0, lambda: "the end of the motion")
        result = ended.result().result
        assert result.error_code == MoveCrosshead.Result.CANCELLED
        assert "load_frame/hold stopped the move" in result.error_message

    def wait_for_hold(self, what: str) -> None:
        """Wait for a sample of the machine, acquired from now on, that says that it does not move."""
        begin = time.time_ns()

        def holds() -> bool:
            self.client.sleep(0.1)
            load = self.client.load
            new = load is not None and to_nanoseconds(load.header.stamp) > begin
            return new and load.mode in (load.HOLD, load.IDLE)

        wait_until(holds, what)


@contextmanager
def action(client: RigClient, kind: Any, name: str, server: str) -> Iterator[ActionClient]:
    """Provide a client of an action, as another controller has it; `server` is the node that has to know it."""
    other = ActionClient(client.node, kind, name)
    try:
        client.wait_for(other.server_is_ready, 20.0, lambda: f"action {name}")
        set_parameters(client, server, {})
        yield other
    finally:
        other.destroy()


def set_parameters(client: RigClient, node: str, values: dict[str, Any]) -> SetParametersResult:
    """Set parameters of a node and return its answer."""
    service = client.node.create_client(SetParametersAtomically, f"{node}/set_parameters_atomically")
    changes = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
    result = client.call_again(service, SetParametersAtomically.Request(parameters=changes), 20.0).result
    client.node.destroy_client(service)
    return result


def recorded(bag: Path, step: int) -> int:
    """Return the number of exposures of a step that can be read from a recording."""
    reader = BagReader(bag)
    topics = reader.find_optional("camera/exposure").values()
    return sum(message.step == step for _, message, _ in reader.messages(topics))
