"""A rig from a script: move the machine, hold, measure.

with RigClient("rig") as rig:
    rig.wait_until_ready(["camera", "phase", "dic", "coupling", "experiment", "load_frame"])
    for position in (0.0, 0.1e-3, 0.2e-3):
        rig.move(position, speed=1e-3)
        result = rig.measure()
        print(result.step, result.force_mean, result.rms_displacement)
"""

from __future__ import annotations

import math
import statistics
import threading
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from fringedic.calibration.sentences import placing_instruction
from fringedic.configuration.conditions import Reading
from fringedic.errors import MoveStoppedError, RigBusyError, StepFailedError, WaitTimeoutError
from fringedic.signals import SignalCollector
from fringedic_bringup.launch.readiness import RECORDER, Readiness
from fringedic_bringup.participant import Participant
from fringedic_msgs.action import CalibrateDistortion, CalibrateRig, MeasureStep, MoveCrosshead
from fringedic_msgs.msg import LoadState, RecorderStatus, Reference, Signal, StepStatus
from fringedic_msgs.srv import PlaceReferencePlane, SetReference, StartExperiment
from fringedic_ros.arrivals import Arrivals, unconnected
from fringedic_ros.goals import RepeatedGoal
from fringedic_ros.placing import PlaceWatch, placing_problem
from fringedic_ros.qos import EVENTS, LATCHED, STATE
from fringedic_ros.signals import add_signals
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.waiting import LOST_S, LongRequest, Patience, RepeatedRequest

MODES = {"fringes": MeasureStep.Goal.FRINGES, "white": MeasureStep.Goal.WHITE, "moving": MeasureStep.Goal.MOVING}
# Ends of a move that need a person: somebody wants the machine to stand still, or it does not do what is requested.
STOPS = (
    MoveCrosshead.Result.CANCELLED,
    MoveCrosshead.Result.MACHINE_FAULT,
    MoveCrosshead.Result.STOPPED_ELSEWHERE,
)
START_TIMEOUT_S = 60.0
# Several heartbeats of config/fastdds.xml.
HEARTBEATS_S = 0.5
# Without feedback. The nodes end every step and move by themselves; this ends the wait for a node that stands still.
STEP_TIMEOUT_S = 3600.0
PERSON_S = 86_400.0  # for a person to place a plane, who may go home before
LATE_RESULT_S = 5.0  # a machine that does not move so long has ended its move, also when the result does not come
CANCEL_AGAIN_S = 0.5  # between two requests to end a move
SILENT_S, MISSED = 2.0, 3  # without a new value, and in its periods, after which it is not known


class RigClient:
    """Calls the actions and services of one rig and waits for their results.

    Parameters
    ----------
    namespace
        The rig's namespace, without slashes around it.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.
    watch
        Called about ten times a second while waiting; an exception that it raises ends the wait.
    name
        Name of this controller, which other controllers see while they wait.
    beside
        Client of the rig to whose sensor this one belongs: each of both runs the callbacks of both.
    recorder
        Name of the recorder node, relative to the namespace or with its own.

    Attributes
    ----------
    node
        The ROS node of the client, for further topics and services; `call` and `wait_for` run its callbacks.
    last_step
        Number of this client's latest step, successful or not; -1 before the first.
    """

    def __init__(
        self,
        namespace: str = "rig",
        *,
        domain: int | None = None,
        watch: Callable[[], None] = lambda: None,
        name: str = "client",
        beside: RigClient | None = None,
        recorder: str = RECORDER,
    ) -> None:
        self.last_step = -1
        self._name = name
        self._watch = watch
        around = None if beside is None else beside.participant
        self.participant: Participant = Participant(name, namespace, domain=domain, beside=around)
        self.node: Node = self.participant.node
        self._measure = ActionClient(self.node, MeasureStep, "measure_step")
        self._move = ActionClient(self.node, MoveCrosshead, "move_crosshead")
        self._calibrate_distortion = ActionClient(self.node, CalibrateDistortion, "calibrate_distortion")
        self._calibrate_rig = ActionClient(self.node, CalibrateRig, "calibrate_rig")
        self._place = self.node.create_client(PlaceReferencePlane, "reference_plane/place")
        actions = {
            "experiment": {
                "measure_step": self._measure,
                "calibrate_distortion": self._calibrate_distortion,
                "calibrate_rig": self._calibrate_rig,
            },
            "load_frame": {"move_crosshead": self._move},
        }
        self._servers = {client: node for node, clients in actions.items() for client in clients.values()}
        self._readiness = Readiness(self.node, actions, self._place, recorder)
        self._start = self.node.create_client(StartExperiment, "experiment/start")
        self._set_reference = self.node.create_client(SetReference, "experiment/set_reference")
        self._hold = self.node.create_client(Trigger, "load_frame/hold")
        self._stage = PlaceWatch(self.node)
        self._placing_s = STEP_TIMEOUT_S
        self._reference = -1
        self.node.create_subscription(Reference, "experiment/reference", self._take_reference, LATCHED)
        self._highest: defaultdict[str, int] = defaultdict(lambda: -1)
        self.node.create_subscription(StepStatus, "experiment/step", self._take_step, EVENTS)
        self._load: LoadState | None = None
        self._load_arrivals = Arrivals(self.node, LoadState, "load_frame/state")
        self._signals = SignalCollector(longest=1)
        self._followed: defaultdict[str, _Followed] = defaultdict(_Followed)  # signals by their name
        self._strain = _Followed()
        self.node.create_subscription(LoadState, "load_frame/state", self._take_load, STATE)
        self.node.create_subscription(Signal, "signals", lambda message: self._take_signals("signals", message), STATE)
        self.node.create_subscription(Float64, "extensometer/strain", self._take_strain, STATE)
        self._sent: RepeatedGoal | None = None  # goal whose acceptance is pending; a server may run it already
        self._cancels_sent = False  # it is cancelled when its acceptance arrives
        self._running: RepeatedGoal | None = None  # goal whose result is pending
        self._moving: RepeatedGoal | None = None  # move during which steps are measured
        # the last of all, because a node discovers the endpoints of another in the order of their creation
        self._own_hold: RepeatedRequest | None = None  # of which a request may still be on its way
        self._pings = {
            name: self.node.create_client(GetParameters, f"{name}/get_parameters")
            for name in ("experiment", "load_frame", recorder)
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.participant.close()

    @property
    def recorder(self) -> RecorderStatus | None:
        """Latest status of the recorder; None before the first."""
        return self._readiness.recorder

    def wait_until_ready(self, nodes: Iterable[str], timeout_s: float = START_TIMEOUT_S) -> None:
        """Wait for nodes and actions, and until a recorder among the nodes has subscribed to every recorded topic.

        The nodes have then discovered this client, too: an answer that they send earlier is lost.

        Raises
        ------
        WaitTimeoutError
            Not all are ready in time; the message names those that are missing.
        StepFailedError
            The recorder cannot record.
        """
        expected = set(nodes)
        missing = self._readiness.missing
        self.wait_for(lambda: not missing(expected), timeout_s, lambda: f"not ready: {', '.join(missing(expected))}")
        for name in sorted(expected & self._pings.keys()):
            self.call_again(self._pings[name], GetParameters.Request(), timeout_s)

    @property
    def reference(self) -> int:
        """Step that the experiment node announced as reference; -1 before the first."""
        return self._reference

    def highest_step(self, experiment: str) -> int:
        """Return the highest number of a step of an experiment, of any controller, since this client began; or -1."""
        return self._highest[experiment]

    def start_experiment(self, name: str) -> None:
        """Begin a new experiment with step 0.

        Raises
        ------
        StepFailedError
            The experiment node refuses it.
        """
        response = self.call(self._start, StartExperiment.Request(experiment=name))
        if not response.success:
            raise StepFailedError(response.message)

    def set_reference(self, step: int | None = None, *, previous_lost: bool = False) -> None:
        """Make a step the reference of the following ones; None: the one measured next.

        Parameters
        ----------
        step
            Its number.
        previous_lost
            The one measured next takes the place of a reference that nodes have lost, see fringedic_msgs/Reference.

        Raises
        ------
        StepFailedError
            The experiment node refuses it.
        """
        request = SetReference.Request(next=step is None, step=step or 0, previous_lost=previous_lost)
        response = self.call_again(self._set_reference, request, START_TIMEOUT_S)
        if not response.success:
            raise StepFailedError(response.message)

    @property
    def load(self) -> LoadState | None:
        """Latest sample of the load frame; None before the first."""
        return self._load

    @property
    def reading(self) -> Reading:
        """Latest signals, such as the force [N], and strain [-]; NaN before the first sample."""
        return self._read(lambda followed: followed.latest)

    @property
    def reading_of_step(self) -> Reading:
        """Latest signals and strain during the last step that are not NaN; NaN when there were none."""
        return self._read(lambda followed: followed.of_step)

    def _read(self, value: Callable[[_Followed], float]) -> Reading:
        return Reading({name: value(each) for name, each in self._followed.items()}, value(self._strain))

    def move(
        self,
        position: float,
        speed: float = 1e-3,
        *,
        force_above: float | None = None,
        force_below: float | None = None,
        until: Callable[[Reading], object] | None = None,
    ) -> MoveCrosshead.Result:
        """Move the crosshead to a position [m] at a speed [m/s] and hold there.

        Parameters
        ----------
        force_above, force_below
            Forces [N] at which the load frame node, which sees every sample first, requests a hold. The machine
            decelerates behind them.
        until
            Called with the samples of the load frame that reach this client; when it returns true the machine is
            requested to hold. A busy computer delays samples and request without limit: for what only a client knows.
            A signal or strain that has not come for 2 s and three of its periods is NaN; `duration` counts from here.

        Raises
        ------
        MoveStoppedError
            Something else than this client stopped the move, or the machine reports a fault: do not move on without a
            person.
        StepFailedError
            The machine did not reach the position.
        WaitTimeoutError
            `until` is given, and no state of the load frame arrives; the message gives the reason.
        """
        goal = self._move_goal(position, speed, force_above, force_below)
        self._settle_own_hold()
        if until is None:
            return self._act(self._move, goal, _move_text(goal), lambda _: None)
        move = self._begin_move(goal, until)
        return move.outcome(self._result(move.sent, lambda: move.is_over(_Followed.present), _move_text(goal)))

    def measure_while_moving(
        self,
        position: float,
        speed: float,
        *,
        every_s: float = 0.0,
        force_above: float | None = None,
        force_below: float | None = None,
        until: Callable[[Reading], object] = lambda _: False,
        measured: Callable[[MeasureStep.Result, bool], object] = lambda *_: None,
        feedback: Callable[[MeasureStep.Feedback], None] = lambda _: None,
    ) -> MoveCrosshead.Result:
        """Move the crosshead as `move` does, and measure stack after stack until it has ended, without a hold.

        Parameters
        ----------
        position, speed, force_above, force_below, until
            See `move`. While a stack is exposed the camera does not run freely, and the latest strain is compared; the
            next stack waits for a new one.
        every_s
            From the begin of a stack to that of the next [s]; 0: as fast as possible.
        measured
            Called with the result of every stack, also of one that failed, and whether the move has ended meanwhile.
        feedback
            Called with stage and frame of each stack.

        Raises
        ------
        MoveStoppedError, StepFailedError, WaitTimeoutError
            See `move`. No error of a stack is raised. `StepFailedError` also when the samples show that the machine
            stands still, and the load frame node does not end the move.
        """
        goal = self._move_goal(position, speed, force_above, force_below)
        self._settle_own_hold()
        move = self._begin_move(goal, until)
        self._moving, self._running = move.sent, None
        follows_strain = not math.isnan(self._strain.latest)

        def is_over() -> bool:
            return move.is_over(_Followed.present)

        def begins() -> bool:
            return is_over() or (self._load is not None and self._load.mode == LoadState.MOVING)

        self.wait_for(begins, START_TIMEOUT_S, lambda: f"{_move_text(goal)}: the machine does not begin to move")
        still_s = math.inf  # since when the samples show no motion

        def has_ended() -> bool:
            nonlocal still_s
            moves = self._load is None or self._load.mode == LoadState.MOVING
            still_s = math.inf if moves else min(still_s, time.monotonic())
            return is_over() or time.monotonic() > still_s + LATE_RESULT_S

        while not has_ended():
            begun, came = time.monotonic(), self._strain.count
            result = self._measure_during(move, feedback)
            measured(result, is_over())
            self._strain.renew()

            def may_follow(begun: float = begun, came: int = came) -> bool:
                is_due = time.monotonic() >= begun + every_s
                is_known = self._strain.count > came or math.isnan(self._strain.present())
                return has_ended() or (is_due and (not follows_strain or is_known))

            while not may_follow():
                self._spin_once()
        if not is_over():
            self._end_still_move(move, is_over, _move_text(goal))
        ended = self._result(move.sent, is_over, _move_text(goal))
        self._moving = None
        return move.outcome(ended)

    def _end_still_move(self, move: _Move, is_over: Callable[[], bool], what: str) -> None:
        """Request the end of a move without a result of a machine that stands still, and wait for it.

        The result was requested again and again meanwhile.

        Raises
        ------
        StepFailedError
            There is still no result.
        """
        move.end()
        try:
            self.wait_for(is_over, LATE_RESULT_S, lambda: what)
        except WaitTimeoutError:
            self._moving = None
            load = self._load
            where = "" if load is None else f" at {1e3 * load.position:.4f} mm, {load.force:.1f} N"
            raise StepFailedError(
                f"{what}: the machine stands still{where}, but its node load_frame does not end the move; the stacks "
                "are measured; read the log of the node, and start it again before the next move"
            ) from None

    def _measure_during(self, move: _Move, feedback: Callable[[MeasureStep.Feedback], None]) -> MeasureStep.Result:
        """Return the result of a stack in motion."""
        goal = MeasureStep.Goal(mode=MeasureStep.Goal.MOVING, controller=self._name)
        for followed in (self._strain, *self._followed.values()):
            followed.of_step = math.nan
        sent = self._send(self._measure, goal, "measure_step", feedback)

        def is_over() -> bool:
            move.is_over(lambda each: each.latest if each is self._strain else each.present())
            return sent.request_result()

        result = self._result(sent, is_over, "measure_step")
        self._take_number(result)
        return result

    def _move_goal(
        self, position: float, speed: float, force_above: float | None, force_below: float | None
    ) -> MoveCrosshead.Goal:
        goal = MoveCrosshead.Goal(position=position, speed=speed, controller=self._name)
        goal.force_above = [] if force_above is None else [float(force_above)]
        goal.force_below = [] if force_below is None else [float(force_below)]
        return goal

    def _begin_move(self, goal: MoveCrosshead.Goal, until: Callable[[Reading], object]) -> _Move:
        """Send a move that a condition may end, once a sample of the load frame has come."""
        self._load_arrivals.renew()
        self.wait_for(lambda: self._load is not None, START_TIMEOUT_S, lambda: str(self._load_arrivals))
        sent = self._send(self._move, goal, _move_text(goal), lambda _: None)
        for followed in (self._strain, *self._followed.values()):
            followed.renew()
        begun_s = time.monotonic()
        return _Move(sent, lambda value: until(self._read(value)._replace(duration=time.monotonic() - begun_s)))

    def wait_for_strain(self, timeout_s: float = START_TIMEOUT_S) -> None:
        """Wait for a publisher of the strain.

        Raises
        ------
        WaitTimeoutError
            There is none, or its type or QoS does not match.
        """
        topic = "extensometer/strain"
        self.wait_for(
            lambda: not unconnected(self.node, Float64, topic),
            timeout_s,
            lambda: unconnected(self.node, Float64, topic),
        )

    def wait_for_signals(self, names: AbstractSet[str], timeout_s: float = START_TIMEOUT_S) -> None:
        """Wait for a sample of each of these signals.

        Raises
        ------
        WaitTimeoutError
            One has not come; the message names it, and those that have come.
        """

        def missing() -> str:
            come = ", ".join(sorted(self._followed)) or "none"
            return (
                f"no sample of {', '.join(sorted(names - self._followed.keys()))} has come on signals; signals that "
                f"have come: {come}. Correct the name in the condition, or start the node that publishes it"
            )

        self.wait_for(lambda: names <= self._followed.keys(), timeout_s, missing)

    def hold(self, timeout_s: float = START_TIMEOUT_S) -> None:
        """Request the machine to stop and hold; its own limits and emergency stop stay in charge.

        Raises
        ------
        StepFailedError
            There is no service ``load_frame/hold``, or the machine refuses.
        WaitTimeoutError
            The load frame node does not answer.
        """
        if not self._hold.service_is_ready():
            raise StepFailedError("there is no service load_frame/hold: stop the machine by hand")
        self._forget_own_hold()
        hold = self._own_hold = RepeatedRequest(self._hold, Trigger.Request())
        self.wait_for(hold.is_answered, timeout_s, lambda: f"{self._hold.srv_name}: no answer")
        if not hold.response.success:
            raise StepFailedError(hold.response.message)

    def _settle_own_hold(self) -> None:
        """Wait until no hold of this client can arrive any more: it would stop the next move like one of a person."""
        if (hold := self._own_hold) is not None:
            with suppress(WaitTimeoutError):  # its server has ended, or the response was lost
                self.wait_for(lambda: hold.is_settled, LOST_S, lambda: f"{self._hold.srv_name}: no answer")
            self._forget_own_hold()

    def _forget_own_hold(self) -> None:
        if self._own_hold is not None:
            self._own_hold.__exit__()
            self._own_hold = None

    def request_cancel(self) -> None:
        """Request the end of the move and the step that are running, without waiting; also from their feedback."""
        for running in (self._moving, self._running):
            if running is not None:
                running.handle.cancel_goal_async()
        self._cancels_sent = self._sent is not None  # feedback may come before the answer to the goal

    def cancel(self, timeout_s: float = 10.0) -> None:
        """Cancel the move or the step whose wait was interrupted by `watch`, if there is one.

        Where `watch` interrupts this wait as well, the next call goes on with it.

        Raises
        ------
        MoveStoppedError
            The move had not been ended by this client, but at the machine, or by a fault.
        WaitTimeoutError
            The node that runs it does not answer any more.
        """
        stop: MoveCrosshead.Result | None = None
        try:
            if (sent := self._sent) is not None:
                # not sent again: it would begin now
                self.wait_for(lambda: sent.is_answered, timeout_s, lambda: "the answer to the goal: no answer")
                self._take_answer(sent)
            while (running := self._moving or self._running) is not None:
                self._await(running.handle.cancel_goal_async(), timeout_s, "cancelling")
                self.wait_for(running.request_result, timeout_s, lambda: "the result of the cancelled goal: no answer")
                if running is self._moving:
                    self._moving = None
                else:
                    self._running = None
                with suppress(StepFailedError):  # the goal has ended, too
                    result = running.result
                    self._take_number(result)
                    if isinstance(result, MoveCrosshead.Result) and result.error_code != result.CANCELLED:
                        stop = result  # it had ended before
        except WaitTimeoutError:
            self._sent = self._running = self._moving = None
            raise
        if stop is not None and stop.error_code in STOPS:
            _without_error(stop)

    def wait_until_started(self, since_ns: Mapping[str, int], timeout_s: float = START_TIMEOUT_S) -> None:
        """Wait for nodes that were started again, and until the middleware has dropped their predecessors.

        Parameters
        ----------
        since_ns
            When each was started, by its name, on this computer's clock [ns]; it publishes its parameters later.

        Raises
        ------
        WaitTimeoutError
            One of them is not ready in time.
        """
        missing = self._readiness.missing_since(since_ns)
        self.wait_for(lambda: not missing(), timeout_s, lambda: f"not started: {', '.join(sorted(missing()))}")

    def measure(
        self,
        mode: Literal["fringes", "white", "moving"] = "fringes",
        *,
        set_reference: bool = False,
        feedback: Callable[[MeasureStep.Feedback], None] = lambda _: None,
    ) -> MeasureStep.Result:
        """Measure one step.

        Parameters
        ----------
        mode
            ``fringes``: shape and displacement; ``white``: one frame, in-plane displacement; ``moving``: shape and
            displacement while the machine moves.
        set_reference
            The step becomes the reference of the following ones.
        feedback
            Called with stage and frame while the step runs.

        Raises
        ------
        StepFailedError
            The step ended with an error; the message names experiment and step.
        """
        return self.finish_measuring(self.begin_measuring(mode, set_reference=set_reference, feedback=feedback))

    def begin_measuring(
        self,
        mode: Literal["fringes", "white", "moving"],
        *,
        set_reference: bool = False,
        feedback: Callable[[MeasureStep.Feedback], None] = lambda _: None,
    ) -> RepeatedGoal:
        """Request a step as `measure` does, without waiting for its result, which `finish_measuring` returns.

        Raises
        ------
        StepFailedError
            The experiment node refuses the goal.
        """
        goal = MeasureStep.Goal(mode=MODES[mode], set_reference=set_reference, controller=self._name)
        self.forget_readings()
        return self._send(self._measure, goal, "measure_step", feedback)

    def finish_measuring(self, sent: RepeatedGoal) -> MeasureStep.Result:
        """Return the result of a step that has begun.

        Raises
        ------
        StepFailedError
            The step ended with an error; the message names experiment and step.
        """
        result = self._result(sent, sent.request_result, "measure_step")
        self._take_number(result)
        return _without_error(result)

    def wait_while_measuring(self, sent: RepeatedGoal, done: Callable[[], bool]) -> None:
        """Wait for something in the course of a step that has begun.

        Raises
        ------
        WaitTimeoutError
            There is no feedback for a long time, or the node is missing.
        """
        self._await_server(sent.client, done, STEP_TIMEOUT_S, "measure_step", lambda: sent.last_sign_s)

    def forget_readings(self) -> None:
        """Forget the readings of the last step; a new one begins."""
        for followed in (self._strain, *self._followed.values()):
            followed.of_step = math.nan

    def of_node(self, name: str) -> RigClient:  # noqa: ARG002 (a rig of several sensors has others)
        """Return the client of the sensor that a node belongs to."""
        return self

    def calibrate_distortion(
        self,
        grid_pitch: float,
        *,
        angles: Sequence[float] = (),
        sigma_angle: float = 0.0,
        frames: int = 0,
        folder: Path | None = None,
        feedback: Callable[[CalibrateDistortion.Feedback], None] = lambda _: None,
    ) -> CalibrateDistortion.Result:
        """Calibrate the lens: have the printed grid placed, and measure distortion and scale of the camera.

        Parameters
        ----------
        grid_pitch
            Distance of the printed lines [m].
        angles, sigma_angle
            Further angles of the plane besides 0, and their standard deviation [rad].
        frames
            Number of frames that are averaged; 0 takes the default of 8.
        folder
            Where the files are written.
        feedback
            Called with the progress, and with requests to an operator.

        Returns
        -------
        CalibrateDistortion.Result
            Also when the measurement fails: then ``error_code`` is not 0 and ``go`` is False.
        """
        goal = CalibrateDistortion.Goal(
            grid_pitch=grid_pitch,
            angles=list(angles),
            sigma_angle=sigma_angle,
            frames=frames,
            folder=_absolute(folder),
        )
        return self._goal(self._calibrate_distortion, goal, "calibrate_distortion", feedback)

    def calibrate_rig(
        self,
        angles: Sequence[float],
        heights: Sequence[float] = (),
        *,
        held_out: Sequence[int] = (),
        sigma_angle: float = 0.0,
        sigma_height: float = 0.0,
        folder: Path | None = None,
        feedback: Callable[[CalibrateRig.Feedback], None] = lambda _: None,
    ) -> CalibrateRig.Result:
        """Calibrate the rig by the plane at every angle [rad] and height [m]; `calibrate_distortion` comes first.

        Parameters
        ----------
        angles, heights
            Of the planes; an angle above 0 raises the +x side towards the camera. Without heights all are 0.
        held_out
            Indices of planes, from 0, that are left out of the fit and test it.
        sigma_angle, sigma_height
            Standard deviations of the stage.
        folder
            Where the calibration and its report are written.
        feedback
            Called with the progress, and with requests to an operator.

        Returns
        -------
        CalibrateRig.Result
            Also when the calibration fails: then ``error_code`` is not 0 and ``go`` is False.
        """
        goal = CalibrateRig.Goal(
            angles=list(angles),
            heights=list(heights),
            held_out=list(held_out),
            sigma_angle=sigma_angle,
            sigma_height=sigma_height,
            folder=_absolute(folder),
        )
        return self._goal(self._calibrate_rig, goal, "calibrate_rig", feedback)

    def place(self, kind: int, angle: float = 0.0, height: float = 0.0) -> PlaceReferencePlane.Response:
        """Have the grid, the plane or the specimen (`PlaceReferencePlane.Request` kinds) placed before the camera.

        The response contains the angle [rad] and the height [m] that were reached.

        Raises
        ------
        StepFailedError
            The stage or the person refuses it, or the stage reports that it is not in its place.
        WaitTimeoutError
            There is no server of ``reference_plane/place`` any more, or it does not answer.
        """
        what = placing_instruction(kind, angle, height)
        request = PlaceReferencePlane.Request(kind=kind, angle=angle, height=height)
        with LongRequest(self.node, self._place, request) as sent:
            self.wait_for(sent.is_over, self._placing_s, lambda: f"{what}: {self._place.srv_name}: no answer")
            if sent.loss:
                raise WaitTimeoutError(f"{what}: {sent.loss}")
            response = sent.response
        if problem := placing_problem(request, response):
            raise StepFailedError(f"{what}: {problem}")
        self._stage.take_response(kind, response)
        return response

    def require_place(self) -> None:
        """Check that the stage has not left the place that it reached; without a stage nothing is known about it.

        Raises
        ------
        StepFailedError
            The stage reports another place.
        """
        if problem := self._stage.problem():
            raise StepFailedError(problem)

    def abandon_planes(self, timeout_s: float) -> None:
        """After a failure, request the end of a calibration and the specimen in front of the camera again.

        `watch`, which may have caused the failure, is not called.
        """
        self.request_cancel()  # before it places another plane
        request = PlaceReferencePlane.Request(kind=PlaceReferencePlane.Request.SPECIMEN)
        patience = Patience(timeout_s)
        with LongRequest(self.node, self._place, request) as sent:
            while self._place.service_is_ready() and not sent.is_answered() and not patience.is_over():
                self.participant.spin_once(0.1)

    def serve_placing(self, place: Callable[[int, float, float], str]) -> None:
        """Serve ``reference_plane/place`` as a stage would; this client then waits a day for a plane to be placed.

        Parameters
        ----------
        place
            Called in a thread of its own with kind, angle [rad] and height [m]; returns when it is placed: an empty
            text, or the reason why it is not.
        """
        self._placing_s = PERSON_S

        async def serve(
            request: PlaceReferencePlane.Request, response: PlaceReferencePlane.Response
        ) -> PlaceReferencePlane.Response:
            answer = Future()
            arguments = (request.kind, request.angle, request.height)
            threading.Thread(target=lambda: answer.set_result(place(*arguments)), daemon=True).start()
            response.message = await answer
            response.success = not response.message
            response.angle, response.height = request.angle, request.height
            return response

        self.node.create_service(
            PlaceReferencePlane, "reference_plane/place", serve, callback_group=MutuallyExclusiveCallbackGroup()
        )

    def wait_until_recorded(self) -> None:
        """Wait until the recorder has received everything published before the last result.

        A lost message is sent again after the publisher's next heartbeat. The recorder takes messages before requests,
        so that its answer follows every message that had arrived.

        Raises
        ------
        WaitTimeoutError
            The recorder does not answer.
        """
        self.sleep(HEARTBEATS_S)
        self.call_again(self._pings[RECORDER], GetParameters.Request(), START_TIMEOUT_S)

    def sleep(self, seconds: float) -> None:
        """Wait, with the checks of `watch`."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self._spin_once()

    def call(self, client: Client, request: Any) -> Any:
        """Call a service of the rig and return its response.

        Raises
        ------
        WaitTimeoutError
            The service does not answer.
        """
        response = client.call_async(request)

        def silent() -> str:
            lost = "stands still or has lost the request, and gave no answer"
            return f"start the command again: the node of {client.srv_name} {lost}"

        self.wait_for(response.done, START_TIMEOUT_S, silent)
        return response.result()

    def call_again(self, client: Client, request: Any, timeout_s: float) -> Any:
        """Call a service whose effect is the same every time, again and again until it responds.

        Raises
        ------
        WaitTimeoutError
            There is no such service, or it does not answer.
        """
        with RepeatedRequest(client, request) as repeated:
            self.wait_for(repeated.is_answered, timeout_s, lambda: f"{client.srv_name}: no answer")
            return repeated.response

    def wait_for(self, done: Callable[[], bool], timeout_s: float, what: Callable[[], str]) -> None:
        """Run the callbacks of the node until a condition is true, with the checks of `watch`.

        Parameters
        ----------
        done
            The condition.
        timeout_s
            Longest wait [s].
        what
            Returns what is missing, for the error.

        Raises
        ------
        WaitTimeoutError
            The condition is not true in time.
        """
        patience = Patience(timeout_s)
        while not done():
            if patience.is_over():
                raise WaitTimeoutError(f"{what()} after {timeout_s:g} s")
            self._spin_once()

    def _spin_once(self) -> None:
        self.participant.spin_once(0.1)
        self._watch()

    def _act(self, client: ActionClient, goal: Any, what: str, feedback: Callable[[Any], None]) -> Any:
        return _without_error(self._goal(client, goal, what, feedback))

    def _goal(self, client: ActionClient, goal: Any, what: str, feedback: Callable[[Any], None]) -> Any:
        sent = self._send(client, goal, what, feedback)
        return self._result(sent, sent.request_result, what)

    def _send(self, client: ActionClient, goal: Any, what: str, feedback: Callable[[Any], None]) -> RepeatedGoal:
        sent = self._sent = RepeatedGoal(client, goal, feedback)
        self._cancels_sent = False
        self._await_server(client, sent.send, START_TIMEOUT_S, what)
        self._take_answer(sent)
        if not sent.is_accepted:
            raise StepFailedError(f"{what}: refused")
        return sent

    def _take_answer(self, sent: RepeatedGoal) -> None:
        self._sent, self._running = None, sent if sent.is_accepted else None
        if self._running is not None and self._cancels_sent:
            self._running.handle.cancel_goal_async()

    def _take_number(self, result: Any) -> None:
        """Keep the number of a step that has ended; a refused step has none."""
        if isinstance(result, MeasureStep.Result) and result.error_code != MeasureStep.Result.BUSY:
            self.last_step = result.step

    def _result(self, sent: RepeatedGoal, over: Callable[[], bool], what: str) -> Any:
        """Wait until a goal is over, and return its result.

        Raises
        ------
        WaitTimeoutError
            There is neither result nor feedback for a long time, the node is missing, or it does not know the goal.
        StepFailedError
            The node ended the goal without a result.
        """
        places = sent.client in (self._calibrate_distortion, self._calibrate_rig)
        timeout_s = self._placing_s if places else STEP_TIMEOUT_S
        self._await_server(sent.client, over, timeout_s, what, lambda: sent.last_sign_s)
        self._running = None
        if sent.result is None:
            node = self._servers[sent.client]
            raise WaitTimeoutError(f"{what}: the node {node} was started again and does not know the goal: repeat it")
        return sent.result

    def _await_server(
        self,
        client: ActionClient,
        done: Callable[[], bool],
        timeout_s: float,
        what: str,
        last_sign_s: Callable[[], float] = lambda: -math.inf,
    ) -> None:
        """Wait for an answer of an action server, unless its node has been missing for some seconds.

        Parameters
        ----------
        timeout_s
            Longest wait [s], counted from the latest feedback: a slow move may take days.
        last_sign_s
            Returns when the latest feedback arrived, on the monotonic clock [s].

        Raises
        ------
        WaitTimeoutError
            There is no answer in time, or the node is missing; the message names it.
        """
        silence, absence = Patience(timeout_s), Patience(LOST_S)
        node, sign_s = self._servers[client], last_sign_s()
        while not done():
            if client.server_is_ready():
                absence.renew()
            elif absence.is_over():
                raise WaitTimeoutError(f"{what}: the node {node} is missing: start it, or connect its computer")
            if sign_s != (sign_s := last_sign_s()):
                silence.renew()
            elif silence.is_over():
                raise WaitTimeoutError(f"{what}: no answer after {timeout_s:g} s")
            self._spin_once()

    def _await(self, future: Future, timeout_s: float, what: str) -> Any:
        self.wait_for(future.done, timeout_s, lambda: f"{what}: no answer")
        return future.result()

    def _take_reference(self, message: Reference) -> None:
        self._reference = message.step

    def _take_step(self, message: StepStatus) -> None:
        self._highest[message.experiment] = max(self._highest[message.experiment], message.step)

    def _take_load(self, message: LoadState) -> None:
        self._load = message
        self._load_arrivals.take_stamped(to_nanoseconds(message.header.stamp))
        self._take_signals("load_frame/state", message)

    def _take_strain(self, message: Float64) -> None:
        self._strain.take(message.data)

    def _take_signals(self, topic: str, message: Any) -> None:
        for name in add_signals(self.node, self._signals, topic, message):
            self._followed[name].take(self._signals.latest[name].value)


class _Move:
    """A move that a condition may end.

    Parameters
    ----------
    sent
        Its goal.
    until
        Called with a function that returns the value of each followed signal; when it returns true, the move ends.
    """

    def __init__(self, sent: RepeatedGoal, until: Callable[[Callable[[_Followed], float]], object]) -> None:
        self.sent = sent
        self._until = until
        self._stopped, self._again_s = False, 0.0

    def end(self) -> None:
        """Request the end of the move, as when its condition is met."""
        self._stopped = True
        self.sent.handle.cancel_goal_async()

    def is_over(self, value: Callable[[_Followed], float]) -> bool:
        """Return whether the move has ended; request its end when the condition is met by these values."""
        ended = self.sent.request_result()
        self._stopped = self._stopped or bool(not ended and self._until(value))
        if self._stopped and not ended and time.monotonic() > self._again_s:  # a request may be lost
            self._again_s = time.monotonic() + CANCEL_AGAIN_S
            self.sent.handle.cancel_goal_async()
        return ended

    def outcome(self, result: MoveCrosshead.Result) -> MoveCrosshead.Result:
        """Return the result of the move, which is over.

        Raises
        ------
        MoveStoppedError, StepFailedError
            It ended otherwise than at its position or by the condition.
        """
        ended_here = self._stopped and result.error_code == MoveCrosshead.Result.CANCELLED
        return result if ended_here else _without_error(result)


class _Followed:
    """Values that arrive live.

    Attributes
    ----------
    count
        Number of values that have arrived.
    latest
        The latest value; NaN before the first.
    of_step
        The latest one during the last step that is not NaN; NaN when there was none.
    """

    def __init__(self) -> None:
        self.latest = self.of_step = math.nan
        self.count = 0
        self._came = deque[float](maxlen=10)
        self._silence = Patience(SILENT_S)

    def take(self, value: float) -> None:
        """Take a value that arrives now."""
        self.count += 1
        self._came.append(time.monotonic())
        periods = [later - earlier for earlier, later in pairwise(self._came)]
        self._silence = Patience(max(SILENT_S, MISSED * statistics.median(periods or [0.0])))
        self.latest = value
        if math.isfinite(value):
            self.of_step = value

    def renew(self) -> None:
        """Begin to wait for the next value."""
        self._silence.renew()

    def present(self) -> float:
        """Return the latest value; NaN if no value has come for 2 s and three of its periods."""
        return math.nan if self._silence.is_over() else self.latest


def _move_text(goal: MoveCrosshead.Goal) -> str:
    return f"crosshead to {goal.position * 1e3:.4f} mm"


def _without_error(result: Any) -> Any:
    if result.error_code:
        kind = RigBusyError if result.error_code == result.BUSY else StepFailedError
        if isinstance(result, MoveCrosshead.Result) and result.error_code in STOPS:
            kind = MoveStoppedError
        raise kind(f"{result.error_message} (error {result.error_code})", error_code=result.error_code)
    return result


def _absolute(folder: Path | None) -> str:
    """Return the absolute path, which nodes in other folders find; empty when they choose one."""
    return "" if folder is None else str(folder.absolute())
