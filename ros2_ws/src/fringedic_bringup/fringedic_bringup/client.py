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
import os
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from experiment_node.topics import DERIVED_TOPICS, RAW_TOPICS
from fringedic.calibration_session import place_in_words
from fringedic.errors import NotAnsweredError, StepFailedError
from fringedic.programme import Reading
from fringedic_bringup.processes import node_environment
from fringedic_msgs.action import CalibrateDistortion, CalibrateRig, MeasureStep, MoveCrosshead
from fringedic_msgs.msg import LoadState, NodeParameters, RecorderStatus
from fringedic_msgs.srv import PlaceReferencePlane, SetReference, StartExperiment
from fringedic_ros.qos import LATCHED, LATCHED_BY_MANY, STATE
from fringedic_ros.stamps import to_nanoseconds

MODES = {"fringes": MeasureStep.Goal.FRINGES, "white": MeasureStep.Goal.WHITE}
START_TIMEOUT_S = 60.0
# Several heartbeats of config/fastdds.xml.
HEARTBEATS_S = 0.5
# A service whose node was killed is listed for 20 s beside the one of the node that was started again.
LISTED_S = 20.0
SERVICES = {"camera": "camera/capture", "projector": "projector/show", "load_frame": "load_frame/hold"}
# The experiment node ends every step by itself; this only ends the wait for one that is gone.
STEP_TIMEOUT_S = 3600.0


class RigClient:
    """Calls the actions and services of one rig and waits for their results.

    Parameters
    ----------
    namespace
        The rig's namespace, without slashes around it.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.
    watch
        Called about ten times a second while waiting; what it raises ends the wait.
    name
        Of this controller, for others whom it keeps waiting.

    Attributes
    ----------
    last_step
        Number of the step that was measured last, whether it succeeded or not; -1 before the first.
    """

    def __init__(
        self,
        namespace: str = "rig",
        *,
        domain: int | None = None,
        watch: Callable[[], None] = lambda: None,
        name: str = "client",
    ) -> None:
        self.last_step = -1
        self._name = name
        self._watch = watch
        self._context = Context()
        for variable, value in node_environment().items():
            os.environ.setdefault(variable, value)  # the same middleware settings as the nodes have
        rclpy.init(context=self._context, domain_id=domain)
        self._node = Node(name, namespace=namespace, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._measure = ActionClient(self._node, MeasureStep, "measure_step")
        self._move = ActionClient(self._node, MoveCrosshead, "move_crosshead")
        self._calibrate_distortion = ActionClient(self._node, CalibrateDistortion, "calibrate_distortion")
        self._calibrate_rig = ActionClient(self._node, CalibrateRig, "calibrate_rig")
        self._actions = {
            "experiment": [self._measure, self._calibrate_distortion, self._calibrate_rig],
            "load_frame": [self._move],
        }
        self._known_servers: dict[str, set[bytes]] = {}
        self._known_readers: set[bytes] = set()  # of the recorder
        self._stale_readers: set[bytes] = set()  # of one that is gone
        self._place = self._node.create_client(PlaceReferencePlane, "reference_plane/place")
        self._start = self._node.create_client(StartExperiment, "experiment/start")
        self._set_reference = self._node.create_client(SetReference, "experiment/set_reference")
        self._recorder_parameters = self._node.create_client(GetParameters, "recorder/get_parameters")
        self._recorder: RecorderStatus | None = None
        self._node.create_subscription(RecorderStatus, "recorder/status", self._take_recorder, LATCHED)
        self._hold = self._node.create_client(Trigger, "load_frame/hold")
        self._load: LoadState | None = None
        self._strain = self._strain_of_step = math.nan
        self._node.create_subscription(LoadState, "load_frame/state", self._take_load, STATE)
        self._node.create_subscription(Float64, "extensometer/strain", self._take_strain, STATE)
        self._started: dict[str, int] = {}  # when each node published its parameters last [ns]
        self._node.create_subscription(NodeParameters, "node_parameters", self._take_parameters, LATCHED_BY_MANY)
        self._running: Any = None  # goal whose result has not come

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._executor.shutdown()
        # a node's end does not end its action clients, which would keep the shared memory of others until collected
        for client in (client for clients in self._actions.values() for client in clients):
            client.destroy()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    @property
    def recorder(self) -> RecorderStatus | None:
        """What the recorder said last."""
        return self._recorder

    def wait_until_ready(self, nodes: Iterable[str], timeout_s: float = START_TIMEOUT_S) -> None:
        """Wait for nodes, for the actions, and for a recorder among the nodes to hear every recorded topic.

        Raises
        ------
        NotAnsweredError
            Not all of them came in time; the message names what is missing.
        StepFailedError
            The recorder cannot record.
        """
        expected = set(nodes)

        def missing() -> list[str]:
            absent = sorted(expected - {name for name, _ in self._node.get_node_names_and_namespaces()})
            for node, clients in self._actions.items():
                missed = [client for client in clients if node in expected and not client.server_is_ready()]
                absent += [f"action {client._action_name}" for client in missed]
            if "stage" in expected and not self._place.service_is_ready():
                absent.append("service reference_plane/place")
            if "recorder" in expected:
                absent += [f"recorder on {topic}" for topic in self._unrecorded()]
            return absent

        self._wait(lambda: not missing(), timeout_s, lambda: f"not ready: {', '.join(missing())}")
        self._known_servers = self._servers(expected)
        topics = [self._node.resolve_topic_name(name) for name in (*RAW_TOPICS, *DERIVED_TOPICS)]
        self._known_readers = {gid for topic in topics for gid in self._recorder_readers(topic)}

    def start_experiment(self, name: str) -> None:
        """Begin a new experiment with step 0.

        Raises
        ------
        StepFailedError
            It is refused.
        """
        response = self._call(self._start, StartExperiment.Request(experiment=name))
        if not response.success:
            raise StepFailedError(response.message)

    def set_reference(self, step: int | None = None) -> None:
        """Make a step the reference of the following ones; None: the one measured next.

        Raises
        ------
        StepFailedError
            It is refused.
        """
        response = self._call(self._set_reference, SetReference.Request(next=step is None, step=step or 0))
        if not response.success:
            raise StepFailedError(response.message)

    @property
    def reading(self) -> Reading:
        """The latest force and strain that came; NaN where none did."""
        return Reading(math.nan if self._load is None else self._load.force, self._strain)

    @property
    def strain_of_step(self) -> float:
        """The last strain that the extensometer was sure of while the last step was measured [-]; NaN for none."""
        return self._strain_of_step

    def move(
        self, position: float, speed: float = 1e-3, *, until: Callable[[Reading], object] | None = None
    ) -> MoveCrosshead.Result:
        """Move the crosshead to a position [m] at a speed [m/s] and hold there.

        Parameters
        ----------
        until
            Asked at every sample of the load frame; when it says true the machine is told to hold where it is. The
            machine stops with its ramp and after the way of the messages, so that it goes a little further.

        Raises
        ------
        StepFailedError
            The machine did not get there.
        NotAnsweredError
            `until` is given, and the load frame publishes no state.
        """
        goal = MoveCrosshead.Goal(position=position, speed=speed, controller=self._name)
        what = f"crosshead to {position * 1e3:.4f} mm"
        if until is None:
            return self._act(self._move, goal, what, lambda _: None)
        self._wait(lambda: self._load is not None, START_TIMEOUT_S, lambda: "load_frame/state: no sample")
        handle = self._send(self._move, goal, what, lambda _: None)
        ended = handle.get_result_async()
        stopped = False

        def over() -> bool:
            nonlocal stopped
            if not stopped and not ended.done() and until(self.reading):
                stopped = True
                handle.cancel_goal_async()
            return ended.done()

        self._wait(over, STEP_TIMEOUT_S, lambda: f"{what}: no answer")
        self._running = None
        result = ended.result().result
        if result.error_code and not (stopped and result.error_code == MoveCrosshead.Result.CANCELLED):
            raise StepFailedError(f"{result.error_message} (error {result.error_code})")
        return result

    def wait_for_strain(self, timeout_s: float = START_TIMEOUT_S) -> None:
        """Wait for somebody who publishes the strain.

        Raises
        ------
        NotAnsweredError
            Nobody does.
        """
        topic = self._node.resolve_topic_name("extensometer/strain")
        self._wait(
            lambda: self._node.count_publishers(topic) > 0,
            timeout_s,
            lambda: f"nobody publishes {topic}: no extensometer",
        )

    def hold(self, timeout_s: float = START_TIMEOUT_S) -> None:
        """Ask the machine to stop and hold.

        Raises
        ------
        StepFailedError
            It does not: nobody serves ``load_frame/hold``, or the machine refuses.
        NotAnsweredError
            Who serves it does not answer.
        """
        if not self._hold.service_is_ready():
            raise StepFailedError("nobody serves load_frame/hold; stop the machine by hand")
        response = self._await(self._hold.call_async(Trigger.Request()), timeout_s, self._hold.srv_name)
        if not response.success:
            raise StepFailedError(response.message)

    def cancel(self, timeout_s: float = 10.0) -> None:
        """Cancel the move or the step whose wait was ended by `watch`, if there is one.

        Raises
        ------
        NotAnsweredError
            Who runs it does not answer any more.
        """
        handle, self._running = self._running, None
        if handle is not None:
            self._await(handle.cancel_goal_async(), timeout_s, "cancelling")
            self._await(handle.get_result_async(), timeout_s, "the end of what was cancelled")

    def wait_until_started(self, nodes: Iterable[str], since_ns: int, timeout_s: float = START_TIMEOUT_S) -> None:
        """Wait for nodes that were started again: the middleware still lists the old ones for some seconds.

        Parameters
        ----------
        nodes
            Their names.
        since_ns
            Time on this computer's clock [ns] from which on their parameters have to come.

        Raises
        ------
        NotAnsweredError
            One of them did not come in time.
        """
        expected = set(nodes)
        if "recorder" in expected:
            self._recorder = None  # what was heard of it was said by the one that is gone
            self._stale_readers |= self._known_readers

        listed_until = time.monotonic() + LISTED_S

        def missing() -> set[str]:
            absent = {name for name in expected if self._started.get(name, 0) < since_ns}
            known = self._known_servers
            absent |= {name for name, gids in self._servers(expected).items() if gids <= known.get(name, set())}
            if time.monotonic() < listed_until:
                absent |= {name for name in expected & SERVICES.keys() if self._count_services(name) < 2}
            return absent

        self._wait(lambda: not missing(), timeout_s, lambda: f"not started: {', '.join(sorted(missing()))}")

    def measure(
        self,
        mode: Literal["fringes", "white"] = "fringes",
        *,
        set_reference: bool = False,
        feedback: Callable[[MeasureStep.Feedback], None] = lambda _: None,
    ) -> MeasureStep.Result:
        """Measure one step.

        Parameters
        ----------
        mode
            ``fringes``: shape and displacement; ``white``: one frame, in-plane displacement.
        set_reference
            The step becomes the reference of the following ones.
        feedback
            Called with stage and frame while the step runs.

        Raises
        ------
        StepFailedError
            The step ended with an error; the message names experiment and step.
        """
        goal = MeasureStep.Goal(mode=MODES[mode], set_reference=set_reference, controller=self._name)
        self._strain_of_step = math.nan
        result = self._goal(self._measure, goal, "measure_step", feedback)
        if result.error_code != MeasureStep.Result.BUSY:
            self.last_step = result.step
        return _without_error(result)

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
        """Have the printed grid placed and the camera's distortion and scale measured.

        Parameters
        ----------
        grid_pitch
            Distance of the printed lines [m].
        angles, sigma_angle
            Of the plane, at which the grid is seen besides 0, and their standard deviation [rad].
        frames
            Averaged; 0: 8.
        folder
            Gets the files.
        feedback
            Called with what happens, or what an operator shall do.

        Returns
        -------
        CalibrateDistortion.Result
            Also of a measurement that failed: ``error_code`` and ``error_message`` say how, ``go`` is False.
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
        """Have the plane placed at every angle [rad] and height [m], and the rig calibrated; after the grid.

        Parameters
        ----------
        angles, heights
            Of the planes, above 0 with the +x side nearer to the camera; without heights all at 0.
        held_out
            Indices of planes, from 0 on, that test the calibration and are not used by it.
        sigma_angle, sigma_height
            Standard deviations of the stage.
        folder
            Gets the calibration and its report.
        feedback
            Called with what happens, or what an operator shall do.

        Returns
        -------
        CalibrateRig.Result
            Also of a calibration that failed: ``error_code`` and ``error_message`` say how, ``go`` is False.
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

    def place(self, kind: int, angle: float = 0.0, height: float = 0.0) -> None:
        """Have the grid, the plane or the specimen (`PlaceReferencePlane.Request` kinds) put in front of the camera.

        Raises
        ------
        StepFailedError
            It is refused.
        """
        request = PlaceReferencePlane.Request(kind=kind, angle=angle, height=height)
        response = self._await(self._place.call_async(request), STEP_TIMEOUT_S, self._place.srv_name)
        if not response.success:
            raise StepFailedError(f"{place_in_words(kind, angle, height)}: {response.message}")

    def serve_placing(self, place: Callable[[int, float, float], str]) -> None:
        """Answer whoever wants something placed, as a stage would.

        Parameters
        ----------
        place
            Called in a thread of its own with kind, angle [rad] and height [m]; returns when it stands there, or why it
            does not.
        """

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

        self._node.create_service(
            PlaceReferencePlane, "reference_plane/place", serve, callback_group=MutuallyExclusiveCallbackGroup()
        )

    def wait_until_recorded(self) -> None:
        """Wait until the recorder has taken what was published before the last result came.

        A message that got lost on its way is sent again after the publisher's next heartbeat. The recorder takes
        messages before requests, so that its answer to one follows everything that had reached it.

        Raises
        ------
        NotAnsweredError
            It does not answer.
        """
        self.sleep(HEARTBEATS_S)
        self._call(self._recorder_parameters, GetParameters.Request())

    def sleep(self, seconds: float) -> None:
        """Wait, and notice what `watch` notices."""
        end = time.monotonic() + seconds
        self._wait(lambda: time.monotonic() >= end, seconds + 1.0, lambda: "the clock stands still")

    def _act(self, client: ActionClient, goal: Any, what: str, feedback: Callable[[Any], None]) -> Any:
        return _without_error(self._goal(client, goal, what, feedback))

    def _goal(self, client: ActionClient, goal: Any, what: str, feedback: Callable[[Any], None]) -> Any:
        handle = self._send(client, goal, what, feedback)
        result = self._await(handle.get_result_async(), STEP_TIMEOUT_S, what).result
        self._running = None
        return result

    def _send(self, client: ActionClient, goal: Any, what: str, feedback: Callable[[Any], None]) -> Any:
        sent = client.send_goal_async(goal, feedback_callback=lambda message: feedback(message.feedback))
        handle = self._await(sent, START_TIMEOUT_S, what)
        if not handle.accepted:
            raise StepFailedError(f"{what}: refused")
        self._running = handle
        return handle

    def _servers(self, nodes: set[str]) -> dict[str, set[bytes]]:
        """Identities of the action servers that are listed; one that was killed stays so for some seconds."""
        servers = {}
        for node in nodes & self._actions.keys():
            name = self._node.resolve_topic_name(self._actions[node][0]._action_name)
            found = self._node.get_publishers_info_by_topic(f"{name}/_action/status")
            servers[node] = {bytes(each.endpoint_gid) for each in found}
        return servers

    def _recorder_readers(self, topic: str) -> set[bytes]:
        found = self._node.get_subscriptions_info_by_topic(topic)
        return {bytes(each.endpoint_gid) for each in found if each.node_name == "recorder"}

    def _count_services(self, node: str) -> int:
        return self._node.count_services(self._node.resolve_service_name(SERVICES[node]))

    def _call(self, client: Any, request: Any) -> Any:
        return self._await(client.call_async(request), START_TIMEOUT_S, client.srv_name)

    def _await(self, future: Future, timeout_s: float, what: str) -> Any:
        self._wait(future.done, timeout_s, lambda: f"{what}: no answer")
        return future.result()

    def _wait(self, done: Callable[[], bool], timeout_s: float, words: Callable[[], str]) -> None:
        end = time.monotonic() + timeout_s
        while not done():
            self._executor.spin_once(timeout_sec=0.1)
            self._watch()
            if time.monotonic() > end:
                raise NotAnsweredError(f"{words()} after {timeout_s:g} s")

    def _unrecorded(self) -> list[str]:
        """Topics that somebody publishes and the recorder does not hear yet."""
        if self._recorder is not None and self._recorder.state == RecorderStatus.FAILED:
            raise StepFailedError(f"the recorder failed: {self._recorder.error_message}")
        if self._recorder is None or self._recorder.state != RecorderStatus.RECORDING:
            return ["everything"]
        topics = [self._node.resolve_topic_name(name) for name in (*RAW_TOPICS, *DERIVED_TOPICS)]
        heard = [topic for topic in topics if self._recorder_readers(topic) - self._stale_readers]
        derived = {self._node.resolve_topic_name(name) for name in DERIVED_TOPICS}
        wanted = topics if derived & set(heard) else [topic for topic in topics if topic not in derived]
        return [topic for topic in wanted if topic not in heard and self._node.count_publishers(topic)]

    def _take_recorder(self, message: RecorderStatus) -> None:
        self._recorder = message

    def _take_load(self, message: LoadState) -> None:
        self._load = message

    def _take_strain(self, message: Float64) -> None:
        self._strain = message.data
        if math.isfinite(message.data):
            self._strain_of_step = message.data

    def _take_parameters(self, message: NodeParameters) -> None:
        stamp = to_nanoseconds(message.header.stamp)
        self._started[message.node] = max(stamp, self._started.get(message.node, 0))


def _without_error(result: Any) -> Any:
    if result.error_code:
        raise StepFailedError(f"{result.error_message} (error {result.error_code})")
    return result


def _absolute(folder: Path | None) -> str:
    """The folder as nodes that run elsewhere find it; empty when they choose one."""
    return "" if folder is None else str(folder.absolute())
