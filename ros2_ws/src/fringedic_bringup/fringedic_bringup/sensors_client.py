"""A rig of several sensors from a script: one load frame, and a step of all sensors one after the other."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from types import TracebackType
from typing import Literal

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters

from fringedic.errors import NodeDiedError, RigBusyError, StepFailedError, WaitTimeoutError
from fringedic.patterns.pattern import PatternKind
from fringedic_bringup.client import START_TIMEOUT_S, RigClient
from fringedic_bringup.launch.graph import own_name, sensor_of_node
from fringedic_bringup.launch.readiness import RECORDER
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.srv import ShowPattern
from fringedic_ros.goals import RepeatedGoal

DARK_S = 5.0  # for the projector of a sensor that failed to become dark
CANCEL_S = 5.0  # for the step of a sensor that failed to end
_Failure = StepFailedError | WaitTimeoutError | NodeDiedError


class SensorsClient(RigClient):
    """Client of a rig and of its sensors, each in a namespace of its name; a step is measured by all sensors.

    Parameters
    ----------
    namespace, domain, name
        As of `RigClient`.
    sensors
        Their names, in the order in which they are measured.
    watch
        Called about ten times a second while waiting, with the name of the sensor whose step is being waited for, and
        None otherwise; an exception that it raises ends the wait.

    Attributes
    ----------
    results
        Of the last step, by sensor: the result, or the reason why its part failed.
    """

    def __init__(
        self,
        namespace: str,
        sensors: Sequence[str],
        *,
        domain: int | None = None,
        watch: Callable[[str | None], None] = lambda _: None,
        name: str = "client",
    ) -> None:
        super().__init__(namespace, domain=domain, watch=partial(watch, None), name=name)
        self._recorder_name = f"/{namespace}/{RECORDER}" if namespace else f"/{RECORDER}"
        self._watch_sensor = watch
        self._ending = ""  # sensor whose step has failed, and whose nodes may have ended
        self._parts = {
            sensor: RigClient(
                "/".join(filter(None, (namespace, sensor))),
                domain=domain,
                watch=partial(self._watch_part, sensor),
                name=name,
                beside=self,
                recorder=self._recorder_name,
            )
            for sensor in sensors
        }
        self._numbers = {
            sensor: part.node.create_client(SetParameters, "experiment/set_parameters")
            for sensor, part in self._parts.items()
        }
        self._shows = {
            sensor: part.node.create_client(ShowPattern, "projector/show") for sensor, part in self._parts.items()
        }
        self._next: dict[str, int | None] = dict.fromkeys(sensors)  # step of each; None: not known
        self.results: dict[str, MeasureStep.Result | str] = {}

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for part in self._parts.values():
            part.__exit__(kind, error, traceback)
        super().__exit__(kind, error, traceback)

    def of_node(self, name: str) -> RigClient:
        """Return the client of the sensor that a node belongs to, or this one for a node of the rig."""
        return self._parts.get(sensor_of_node(name), self)

    @property
    def reference(self) -> int:
        """Step that the sensors measure against; -1 before the first. The latest, where one lost its reference."""
        return max(part.reference for part in self._parts.values())

    def highest_step(self, experiment: str) -> int:
        """Return the highest number of a step of any sensor, see `RigClient.highest_step`."""
        return max(part.highest_step(experiment) for part in self._parts.values())

    def wait_until_ready(self, nodes: Iterable[str], timeout_s: float = START_TIMEOUT_S) -> None:
        """Wait for the nodes of the rig and of its sensors, see `RigClient.wait_until_ready`."""
        names = list(nodes)
        super().wait_until_ready([each for each in names if self.of_node(each) is self], timeout_s)
        for sensor, part in self._parts.items():
            own = [own_name(each) for each in names if sensor_of_node(each) == sensor]
            recorder = [self._recorder_name] if RECORDER in names else []
            part.wait_until_ready([*own, *recorder], timeout_s)

    def wait_until_started(self, since_ns: Mapping[str, int], timeout_s: float = START_TIMEOUT_S) -> None:
        """Wait for nodes that were started again, see `RigClient.wait_until_started`."""
        super().wait_until_started({name: at for name, at in since_ns.items() if self.of_node(name) is self}, timeout_s)
        for sensor, part in self._parts.items():
            own = {own_name(name): at for name, at in since_ns.items() if sensor_of_node(name) == sensor}
            part.wait_until_started(own, timeout_s)

    def measure(
        self,
        mode: Literal["fringes", "white", "moving"] = "fringes",
        *,
        set_reference: bool = False,
        feedback: Callable[[MeasureStep.Feedback], None] = lambda _: None,
    ) -> MeasureStep.Result:
        """Measure one step with all sensors; each is exposed when the one before has become dark.

        Results of a sensor are computed while the next one is exposed. `results` contains the outcome of each.

        Parameters
        ----------
        mode, set_reference
            As of `RigClient.measure`.
        feedback
            As of `RigClient.measure`, with the name of the sensor before the stage.

        Returns
        -------
        MeasureStep.Result
            Of the first sensor that measured the step.

        Raises
        ------
        StepFailedError
            All sensors failed; the message contains the reason of each.
        """
        number, self.results, begun = self.last_step + 1, {}, dict[str, RepeatedGoal]()
        self.forget_readings()
        try:
            for sensor in self._parts:
                try:
                    begun[sensor] = self._expose(sensor, number, mode, set_reference, feedback)
                except RigBusyError as busy:
                    if not begun:
                        raise  # the whole step waits
                    self._fail(sensor, busy)
                except (StepFailedError, WaitTimeoutError, NodeDiedError) as error:
                    self._fail(sensor, error)
            for sensor, sent in begun.items():
                try:
                    self.results[sensor] = self._parts[sensor].finish_measuring(sent)
                except (StepFailedError, WaitTimeoutError, NodeDiedError) as error:
                    self._fail(sensor, error)
        finally:
            if begun or self.results:
                self.last_step = number  # also where it was interrupted: no number is used twice
        measured = [each for sensor in self._parts if isinstance(each := self.results[sensor], MeasureStep.Result)]
        if not measured:
            reasons = "; ".join(f"sensor {sensor}: {self.results[sensor]}" for sensor in self._parts)
            raise StepFailedError(reasons)
        return measured[0]

    def cancel(self, timeout_s: float = 10.0) -> None:
        """Cancel the move, and the steps of all sensors, see `RigClient.cancel`."""
        for part in self._parts.values():
            with suppress(WaitTimeoutError):
                part.cancel(timeout_s)
        super().cancel(timeout_s)

    def request_cancel(self) -> None:
        """Request the end of the move and of the steps that are running, without waiting."""
        for part in self._parts.values():
            part.request_cancel()
        super().request_cancel()

    def _expose(
        self,
        sensor: str,
        number: int,
        mode: Literal["fringes", "white", "moving"],
        set_reference: bool,
        feedback: Callable[[MeasureStep.Feedback], None],
    ) -> RepeatedGoal:
        """Begin the step of one sensor, and wait until its frames are exposed and its projector is dark."""
        part, exposed = self._parts[sensor], False

        def take(message: MeasureStep.Feedback) -> None:
            nonlocal exposed
            exposed = exposed or message.stage == MeasureStep.Feedback.PROCESS
            feedback(
                MeasureStep.Feedback(stage=f"{sensor}: {message.stage}", frame=message.frame, frames=message.frames)
            )

        if self._next[sensor] != number:
            self._set_number(sensor, number)
        sent = part.begin_measuring(mode, set_reference=set_reference, feedback=take)
        self._next[sensor] = number + 1
        part.wait_while_measuring(sent, lambda: exposed or sent.request_result())
        return sent

    def _watch_part(self, sensor: str) -> None:
        self._watch_sensor("" if sensor == self._ending else sensor)

    def _set_number(self, sensor: str, number: int) -> None:
        """Continue the steps of a sensor with a number: it failed or was started again, and has fallen behind."""
        value = ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=number)
        request = SetParameters.Request(parameters=[Parameter(name="first_step", value=value)])
        part = self._parts[sensor]
        (answer,) = part.call_again(self._numbers[sensor], request, START_TIMEOUT_S).results
        if not answer.successful:
            raise StepFailedError(f"experiment: step {number} was refused: {answer.reason}")
        self._next[sensor] = number

    def _fail(self, sensor: str, error: _Failure) -> None:
        """Keep the reason of a part that failed, end its step, and make its projector dark for the other sensors.

        Raises
        ------
        NodeDiedError
            It was a node of the whole rig that has ended.
        """
        self._watch_sensor("")
        self.results[sensor], self._next[sensor] = str(error), None
        part, show = self._parts[sensor], self._shows[sensor]
        self._ending = sensor
        try:
            with suppress(StepFailedError, WaitTimeoutError):
                part.cancel(CANCEL_S)
            if show.service_is_ready():
                with suppress(WaitTimeoutError):
                    part.call_again(show, ShowPattern.Request(kind=int(PatternKind.OTHER), name="dark"), DARK_S)
        finally:
            self._ending = ""


def nodes_to_watch(names: Collection[str], sensor: str | None) -> Collection[str] | None:
    """Return the nodes whose end interrupts a wait: those of the rig, and of the sensor that is waited for.

    Parameters
    ----------
    names
        Of all nodes.
    sensor
        Name of the sensor; empty: none; None: all.
    """
    if sensor is None:
        return None
    return [name for name in names if sensor_of_node(name) in ("", sensor)]
