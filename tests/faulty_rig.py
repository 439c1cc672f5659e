"""A running rig whose steps are made to fail, for the tests of faults."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.parameter import Parameter
from running_system import WORKING

from fringedic.errors import StepFailedError
from fringedic.recording import BagReader
from fringedic_bringup.client import RigClient
from fringedic_bringup.processes import RunningGraph
from fringedic_msgs.action import MeasureStep, MoveCrosshead

FRAMES = 12
MM = 1e-3


class Rig:
    """A rig in its processes, and its controller.

    Parameters
    ----------
    measured
        Whether its steps are measured, not only recorded.
    """

    def __init__(self, running: RunningGraph, client: RigClient, folder: Path, *, measured: bool = True) -> None:
        self.running, self.client, self.folder, self._measured = running, client, folder, measured

    def works(self) -> MeasureStep.Result:
        """Measure a step that has to work."""
        result = self.client.measure()
        assert result.load_samples > 3
        assert result.valid_fraction > WORKING or not self._measured
        return result

    def works_again(self) -> bool:
        """Whether a step can be measured by now."""
        try:
            self.works()
        except StepFailedError as error:  # what was lost is on its way back
            print(error)
            return False
        return True

    def fails(self, words: str, *, at_frame: int = 0, then: Callable[[], object] = lambda: None) -> None:
        """Measure a step that has to fail; do something when a frame has been taken."""
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
        """Other parameters of the experiment node for a while."""
        before = {"hold_required": True, "load_drift_n": 0.0}
        self.set("experiment", values)
        try:
            yield
        finally:
            self.set("experiment", {name: before[name] for name in values})

    def set(self, node: str, values: dict[str, Any]) -> None:
        """Set parameters of a node."""
        client = self.client._node.create_client(SetParametersAtomically, f"{node}/set_parameters_atomically")
        self.client._wait(client.service_is_ready, 20.0, lambda: "parameter service")
        changes = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        result = self.client._call(client, SetParametersAtomically.Request(parameters=changes)).result
        assert result.successful, result.reason
        self.client._node.destroy_client(client)

    @contextmanager
    def creeping(self) -> Iterator[None]:
        """Let the machine creep, which nobody stops but a request to hold; that has to come."""
        self.client.move(0.0, 5 * MM)
        goal = MoveCrosshead.Goal(position=0.9 * MM, speed=0.05 * MM, controller="creep")
        handle = self.client._send(self.client._move, goal, "creeping", lambda _: None)
        with self.settings(hold_required=False):
            yield
        ended = handle.get_result_async()
        self.client._wait(ended.done, 30.0, lambda: "the end of the motion")
        result = ended.result().result
        assert result.error_code == MoveCrosshead.Result.CANCELLED
        assert "load_frame/hold stopped it" in result.error_message

    def holds(self) -> bool:
        """Whether the machine tells that it stands."""
        self.client.sleep(0.1)  # takes what came before
        self.client._load = None
        self.client.sleep(0.1)
        load = self.client._load
        return load is not None and load.mode in (load.HOLD, load.IDLE)


def recorded(bag: Path, step: int) -> int:
    """Exposures of a step that can be read by now."""
    reader = BagReader(bag)
    topics = reader.find_optional("camera/exposure").values()
    return sum(message.step == step for _, message, _ in reader.messages(topics))
