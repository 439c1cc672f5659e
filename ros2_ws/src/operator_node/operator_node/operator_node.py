"""Shows a rig on the operator's page, and drives it by public services and actions.

The node may be ended at any moment without effect on a measurement.
"""

from __future__ import annotations

import asyncio
import json
import os
import struct
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from pydantic import BaseModel, Field
from rcl_interfaces.msg import Log
from rclpy.action import ActionClient
from rclpy.callback_groups import CallbackGroup
from rclpy.client import Client
from rclpy.qos import QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from fringedic.configuration.test_series import Series
from fringedic.configuration.yaml_section import validate
from fringedic.datasets.opening import RESULTS
from fringedic.datasets.quantities import MAPS
from fringedic.errors import ConfigurationError, FringedicError, OperatorError, StepFailedError
from fringedic.figures.live_preview import browser_picture
from fringedic.frames.messages import cloud_arrays
from fringedic.frames.sensor import file_of
from fringedic.report.page_server.app import Control, Hold, Measure, PlanSeries, SetAlarms, Start
from fringedic.report.page_server.maps import RecordedMaps, SpooledMaps, described
from fringedic.report.page_server.marks import KeepMarks, shown_marks
from fringedic.report.page_server.recorded import KEPT, RecordedRig
from fringedic.report.page_server.server import Address, PageServer
from fringedic.signals import SignalCollector
from fringedic.wording.translation import Sentence, translatable
from fringedic_msgs.action import MeasureStep
from fringedic_msgs.msg import (
    LiveView,
    LoadState,
    NodeStatus,
    ProcedureStatus,
    RecorderStatus,
    SetupState,
    Signal,
    StepStatus,
)
from fringedic_msgs.srv import ControlProcedure, StartProcedure
from fringedic_ros.goals import result_of
from fringedic_ros.images import image_array
from fringedic_ros.main import run
from fringedic_ros.parameters import declare
from fringedic_ros.polled import PolledTopic
from fringedic_ros.processing import StampJoin
from fringedic_ros.qos import DERIVED, DIAGNOSTICS, EVENTS, LATCHED, LATEST, PREVIEWS, SIGNAL_PREVIEWS
from fringedic_ros.rig_node import RigNode
from fringedic_ros.serialized import image_view
from fringedic_ros.signals import add_signals
from fringedic_ros.stamps import to_nanoseconds
from fringedic_ros.waiting import RepeatedRequest
from fringedic_ros.work import Worker
from operator_node.alarms import Alarms
from operator_node.rig_file import ShownRigFile
from operator_node.rig_state import RigState

TOKEN = "FRINGEDIC_OPERATOR_TOKEN"  # an environment variable: parameters are recorded and published
ANSWER_S = 10.0
LOOKS_S = 0.1  # between two looks for a service
PRESENCE_S = 1.0
MODES = {"fringes": MeasureStep.Goal.FRINGES, "white": MeasureStep.Goal.WHITE}
REFUSED = translatable("the experiment node refuses the step; wait until it has started")
MEASURING = ("run", "by_hand")  # the procedures with a dataset
IN_PLANE = {"dic/displacement": ("displacement_x", "displacement_y")}
IN_PLANE |= {"dic/sigma": ("displacement_sigma_x", "displacement_sigma_y")}
JOINED = {
    "dic": (*IN_PLANE, "dic/camera_info", "dic/status"),
    "coupling": ("coupling/displacement", "coupling/shape", "dic/camera_info", "coupling/status"),
}


class OperatorParameters(BaseModel):
    """Parameters of the operator node."""

    rig_file: str = Field("", description="Rig file, for its programme and its region.")
    address: str = Field("127.0.0.1", description="Address of this computer at which the page is served.")
    port: int = Field(8090, ge=1, le=65535, description="Port of the page.")
    certificate: str = Field("", description="TLS certificate (PEM); empty: none.")
    key: str = Field("", description="Private key of the certificate (PEM).")
    maps_folder: str = Field("", description="Folder for the maps of the steps; empty: a new temporary folder.")
    maximum_rate_hz: float = Field(10.0, gt=0, le=30, description="Largest rate of images for the browsers [Hz].")


class OperatorNode(RigNode):
    """Web server of the page; subscribes to the public topics of a rig, and calls its services and actions."""

    def __init__(self) -> None:
        super().__init__("operator")
        parameters = declare(self, OperatorParameters).value
        self._state = RigState()
        self._file = ShownRigFile(Path(parameters.rig_file)) if parameters.rig_file else None
        self._maps = SpooledMaps(Path(parameters.maps_folder or tempfile.mkdtemp(prefix="fringedic-maps-")))
        self._folders: dict[str, Path] = {}
        self._running: list[dict[str, Any]] = []  # steps of the programme that was started last
        self._texture: bytes | None = None  # the latest one
        self._joins = {name: StampJoin(topics) for name, topics in JOINED.items()}
        self._signals = SignalCollector(longest=1)
        self._alarms = Alarms()
        self._sent: list[_Sent] = []  # requests of limits
        self._worker = Worker(self)
        self._subscribe()
        self._starts = self.create_client(StartProcedure, "procedures/start")
        self._controls = self.create_client(ControlProcedure, "procedures/control")
        self._holds = self.create_client(Trigger, "load_frame/hold")
        self._by_hand = _FromFirstUse()
        self._measure = ActionClient(self, MeasureStep, "measure_step", callback_group=self._by_hand)
        self._present = self.create_publisher(Bool, "operator/driver_present", LATEST)
        self.create_timer(PRESENCE_S, self._publish_presence)
        self.create_timer(1 / parameters.maximum_rate_hz, self._poll)
        self._page = PageServer(self, _address(parameters))

    def destroy_node(self) -> None:
        """End server, background thread and node."""
        self._page.close()
        self._worker.stop()
        self._measure.destroy()
        super().destroy_node()

    def _subscribe(self) -> None:
        state = self._state
        topics: list[tuple[type[Any], str, Callable[[Any], None], QoSProfile]] = [
            (StepStatus, "experiment/step", self._take_step, EVENTS),
            (RecorderStatus, "recorder/status", state.take_recorder, LATCHED),
            (DiagnosticArray, "/diagnostics", state.take_diagnostics, DIAGNOSTICS),
            (Log, "/rosout", state.take_log, EVENTS),
            (ProcedureStatus, "procedures/status", self._take_procedure, LATCHED),
            (ProcedureStatus, "procedures/live", partial(state.take_procedure, topic="live"), LATCHED),
            (SetupState, "procedures/setup", self._take_setup, LATCHED),
            (LiveView, "live_view/figures", state.take_figures, DERIVED),
            (LoadState, "load_frame/state", self._take_load, PREVIEWS),
            (Signal, "signals", partial(self._take_signal, "signals"), SIGNAL_PREVIEWS),
            *((Image, topic, partial(self._join, topic), DERIVED) for topic in IN_PLANE),
            (CameraInfo, "dic/camera_info", partial(self._join, "dic/camera_info"), DERIVED),
            (PointCloud2, "coupling/displacement", partial(self._join, "coupling/displacement"), DERIVED),
            (PointCloud2, "coupling/shape", partial(self._join, "coupling/shape"), DERIVED),
            *((NodeStatus, f"{name}/status", partial(self._join, f"{name}/status"), EVENTS) for name in JOINED),
        ]
        # polled together: a turn of the executor for each message costs three times as much processor time
        self._topics = [(PolledTopic[Any](self, kind, topic, qos), take) for kind, topic, take, qos in topics]
        # the bytes: only the few frames that are shown are decoded
        self._images = PolledTopic[bytes](self, Image, "camera/image_raw", PREVIEWS, raw=True)
        self._textures = PolledTopic[bytes](self, Image, "phase/texture", DERIVED, raw=True)

    # what the page shows, as of `fringedic.report.page_server.app.Rig`

    @property
    def maps(self) -> SpooledMaps:
        """The maps of the running experiment."""
        return self._maps

    def snapshot(self) -> dict[str, Any]:
        """Return the state of the rig."""
        names = self._maps.names()
        found = self._state.snapshot({step: 2 if "u" in of_step else 1 for step, of_step in names.items() if of_step})
        measured = {name for of_step in names.values() for name in of_step}
        found["quantities"] = [described(name) for name in MAPS if name in measured]
        shown = {} if self._file is None else self._file.shown()
        found["tests"] = [] if self._file is None else self._file.shown_tests()
        found["rigs"] = [] if self._file is None else self._file.rigs()
        found["series"] = {} if self._file is None else self._file.series()
        found["marks"] = shown_marks(self._folders["run"]) if "run" in self._folders else {}
        found["alarms"] = self._alarms.shown()
        found["rig"] = {
            "kind": "rig",
            "title": self.get_namespace().strip("/") or "rig",
            "operated": self._starts.service_is_ready(),
            "machine": self._holds.service_is_ready(),
            "measures": self._measure.server_is_ready(),
            **shown,
            "running": self._running,
        }
        return found

    def folders(self) -> Mapping[str, Path]:
        """Return the folders of the results."""
        tests = {} if self._file is None else self._file.tests()
        return self._folders | {f"test {name}": test.folder for name, test in tests.items()}

    def busy(self) -> str:
        """Return why nothing else may be computed now; "" when it may."""
        busy = translatable("a procedure runs on the rig: evaluate and export when it has ended")
        return busy if self._state.is_busy else ""

    def opened(self, test: str) -> RecordedRig:
        """Return an earlier test of the rig file."""
        return self._shown_file().opened(test)

    def _shown_file(self) -> ShownRigFile:
        if self._file is None:
            raise OperatorError(
                translatable("this page was started without a rig file: start it with 'fringedic operate RIG.yaml'")
            )
        return self._file

    async def do(self, command: Any) -> str:
        """Execute a command of the page."""
        if isinstance(command, KeepMarks):
            return await self._keep_marks(command)
        if isinstance(command, SetAlarms):
            return self._alarms.set(command.alarms)
        if isinstance(command, PlanSeries):
            series = validate(Series, command.model_dump(), "series")
            await asyncio.to_thread(self._shown_file().plan_series, series)
            if not series.specimens:
                return translatable("the series is removed")
            return Sentence("specimens of the series: {count}", count=len(series.specimens))
        if isinstance(command, Start):
            request = command.model_dump() | {"options": json.dumps(command.options)}  # which is YAML as well
            checked = await self.check(self._text_that_runs(command)) if command.procedure == "run" else {}
            answer = await self._called(self._starts, StartProcedure.Request(**request))
            if command.procedure == "run":
                self._running = checked["rows"]
            return answer
        if isinstance(command, Control):
            code = getattr(ControlProcedure.Request, command.command.upper())
            return await self._called(self._controls, ControlProcedure.Request(command=code))
        if isinstance(command, Hold):
            await self._discovered(self._holds)
            answer = await self._called(self._holds, Trigger.Request()) or translatable(
                "the machine was requested to hold"
            )
            with suppress(OperatorError):  # no programme runs
                await self._called(self._controls, ControlProcedure.Request(command=ControlProcedure.Request.PAUSE))
                answer = Sentence("{answer}; the programme does not go on by itself", answer=answer)
            return answer
        assert isinstance(command, Measure), "there are no other commands"
        return await self._measure_by_hand(command)

    async def check(self, text: str) -> dict[str, Any]:
        """Return what a programme would do, and why it may not be started."""
        return await asyncio.to_thread(self._shown_file().check, text)

    def _text_that_runs(self, command: Start) -> str:
        """Return the programme of a run: one that goes on has that of its beginning."""
        continued = str(command.options.get("continue_run", ""))
        return (self._shown_file().programme_of(continued) if continued else "") or command.text

    async def _keep_marks(self, command: KeepMarks) -> str:
        """Keep marks and notes of an earlier test, or of the one that runs or ran last."""
        if command.test:
            opened = await asyncio.to_thread(self.opened, command.test)
            return await opened.do(command.model_copy(update={"test": ""}))
        if "run" not in self._folders:
            raise OperatorError(
                translatable("marks and notes are kept with a test: measure one, or open one of the list")
            )
        await asyncio.to_thread(command.save, self._folders["run"])
        return KEPT

    def _request_hold(self, reason: str) -> str:
        """Request a hold of the machine at a limit, and let no further step begin; in the thread of the node."""
        if self._controls.service_is_ready():
            self._send(reason, self._controls, ControlProcedure.Request(command=ControlProcedure.Request.PAUSE))
        if not self._holds.service_is_ready():
            self.get_logger().error(f"{reason}: there is no node of the machine to request a hold of")
            return translatable("no node of the machine runs: stop it at its own controls")
        self.get_logger().warning(f"{reason}: a hold of the machine is requested")
        self._send(reason, self._holds, Trigger.Request())
        return translatable("a hold was requested")

    def _send(self, reason: str, client: Client, request: Any) -> None:
        """Send a request of a limit, which `_repeat` sends again until it is answered."""
        sent = RepeatedRequest(client, request)
        self._sent.append(_Sent(reason, client, sent, time.monotonic() + ANSWER_S))
        sent.is_answered()

    def _repeat(self) -> None:
        """Send the requests of limits again when they are due; log and show those without effect."""
        waiting = []
        for each in self._sent:
            is_hold, problem = each.client is self._holds, ""
            if not each.request.is_answered():
                if time.monotonic() < each.end:
                    waiting.append(each)
                    continue
                problem = Sentence("no answer within {seconds} s", seconds=f"{ANSWER_S:g}")
            elif is_hold and not each.request.response.success:  # without a programme nothing is paused
                problem = each.request.response.message
            if problem:
                self.get_logger().error(f"{each.client.srv_name}: {problem}")
            if problem and is_hold:
                told = Sentence("NO HOLD: {problem}; stop the machine at its own controls", problem=problem)
                self._alarms.answer(each.reason, told)
            with each.request:
                pass  # no request stays pending
        self._sent = waiting

    async def _discovered(self, client: Client) -> None:
        """Wait for a service of a node that has just started: on a busy computer it is known after the button is."""
        for _ in range(round(ANSWER_S / LOOKS_S)):
            if client.service_is_ready():
                return
            await asyncio.sleep(LOOKS_S)

    async def _called(self, client: Client, request: Any) -> str:
        if not client.service_is_ready():
            raise OperatorError(
                f"{client.srv_name}: there is no such service; start the rig, or wait until it is ready"
            )
        response = await _answer(client.call_async(request), client.srv_name)
        if not response.success:
            raise OperatorError(response.message)
        return str(response.message)

    async def _measure_by_hand(self, command: Measure) -> str:
        if not self._measure.server_is_ready():
            raise OperatorError(translatable("no experiment node is running: start measuring by hand, or a programme"))
        self._by_hand.used = True
        goal = MeasureStep.Goal(mode=MODES[command.mode], set_reference=command.set_reference, controller="operator")
        sent = self._measure.send_goal_async(goal)
        sent.add_done_callback(self._follow)  # also of an answer that comes too late for the browser
        handle = await _answer(sent, "measure_step")
        if not handle.accepted:
            raise OperatorError(REFUSED)
        return ""

    def _follow(self, sent: Future) -> None:
        handle = sent.result()
        if not handle.accepted:
            self._not_measured(REFUSED)
            return
        self._state.set_hand(translatable("measuring"))
        handle.get_result_async().add_done_callback(self._take_result)

    def _take_result(self, future: Future) -> None:
        try:
            result = result_of(future.result(), "measure_step")
        except StepFailedError as error:
            self._not_measured(str(error))
            return
        if result is None:
            self._not_measured(translatable("the experiment node was started again; measure the step again"))
            return
        if result.error_code:
            why = f"{result.error_message} (error {result.error_code})"
            self._state.set_hand(Sentence("step {step} failed: {reason}", step=result.step, reason=why))
        else:
            self._state.set_hand(Sentence("step {step} is measured", step=result.step))

    def _not_measured(self, reason: str) -> None:
        self._state.set_hand(Sentence("not measured: {reason}", reason=reason))

    # messages of the rig

    def _take_step(self, message: StepStatus) -> None:
        if self._state.take_step(message):
            self._worker.submit(self._maps.clear)

    def _take_procedure(self, message: ProcedureStatus) -> None:
        if message.procedure in MEASURING and message.folder:  # that of a noise floor has no report of a test
            self._folders["run"] = Path(message.folder)
        self._state.take_procedure(message, "procedure")
        if message.state == ProcedureStatus.DONE and message.procedure in MEASURING:
            self._worker.submit(self._complete, file_of(Path(message.folder) / f"{RESULTS}.nc", self.sensor))

    def _take_setup(self, message: SetupState) -> None:
        self._folders |= {item.item: Path(item.folder) for item in message.items if item.folder}
        self._state.take_setup(message)

    def _take_load(self, message: LoadState) -> None:
        self._state.take_load(message)
        self._take_signal("load_frame/state", message)

    def _take_signal(self, topic: str, message: Any) -> None:
        add_signals(self, self._signals, topic, message)
        self._state.take_signals(self._signals.latest)
        self._alarms.check(self._signals.latest, self._request_hold)

    def _poll(self) -> None:
        """Take the messages that have arrived and, while a browser is connected, the newest frame."""
        self._repeat()
        for topic, take in self._topics:
            while (message := topic.take()) is not None:
                take(message)
        while (texture := self._textures.take()) is not None:
            self._texture = texture
        image = self._images.take() if self._page.hub.clients else None
        if image is not None:
            self._page.publish("image", partial(self._picture, image))

    def _picture(self, data: bytes) -> bytes:
        """Return a camera image for the browser: width, height, stamp [s], JPEG; nothing of an unreadable one."""
        try:
            image = image_view(data)
            picture = browser_picture(image_array(image))
        except FringedicError as error:
            self.get_logger().warning(f"camera/image_raw: {error}", throttle_duration_sec=10.0)
            return b""
        return struct.pack("<IId", image.width, image.height, 1e-9 * image.stamp) + picture

    def _join(self, topic: str, message: Any) -> None:
        stamp = to_nanoseconds(message.header.stamp)
        for name, topics in JOINED.items():
            parts = self._joins[name].add(topic, stamp, message) if topic in topics else None
            if parts is not None:
                self._worker.submit(self._keep, parts[f"{name}/status"], parts)

    def _keep(self, status: NodeStatus, parts: Mapping[str, Any]) -> None:
        """Keep the maps of a step; in the thread of the worker."""
        maps: dict[str, Any] = {}
        for topic, names in IN_PLANE.items():
            if topic in parts:
                maps |= dict(zip(names, image_array(parts[topic]).transpose(2, 0, 1), strict=True))
        if "dic/displacement" in parts and self._texture is not None:
            texture = image_view(self._texture)
            is_of_step = texture.stamp == to_nanoseconds(status.header.stamp)
            if is_of_step:  # else it has not come, or is that of the next step
                maps["texture"] = image_array(texture)
        if "coupling/shape" in parts:
            maps |= {f"shape_{name}": values for name, values in cloud_arrays(parts["coupling/shape"]).items()}
            maps |= cloud_arrays(parts["coupling/displacement"])
        self._maps.put(status.step, maps, max(int(parts["dic/camera_info"].binning_x), 1))
        self._state.take_maps(status, surface="coupling/shape" in parts)

    def _complete(self, results: Path) -> None:
        """Add the maps of a run that this server did not hear; in the thread of the worker."""
        if results.exists():
            self._maps.complete(RecordedMaps(results))

    def _publish_presence(self) -> None:
        self._present.publish(Bool(data=self._page.wheel.present))


class _Sent(NamedTuple):
    """A request of a limit, which is repeated until it is answered, or until a time [s]."""

    reason: str
    client: Client
    request: RepeatedRequest
    end: float


class _FromFirstUse(CallbackGroup):
    """Keeps the executor from waking for the feedback of every step while nobody has measured by hand."""

    used = False

    def can_execute(self, *_: Any) -> bool:
        return self.used

    def beginning_execution(self, *_: Any) -> bool:
        return self.used

    def ending_execution(self, *_: Any) -> None:
        pass


async def _answer(future: Future, what: str) -> Any:
    """Return the result of a future of rclpy in the event loop of the server.

    Raises
    ------
    OperatorError
        There is none in time.
    """
    loop, arrived = asyncio.get_running_loop(), asyncio.Event()
    future.add_done_callback(lambda _: loop.call_soon_threadsafe(arrived.set))
    try:
        await asyncio.wait_for(arrived.wait(), ANSWER_S)
    except TimeoutError as error:
        raise OperatorError(
            f"{what} does not answer: the request may still be carried out; see the states of the nodes before you try "
            "again"
        ) from error
    return future.result()


def _address(parameters: OperatorParameters) -> Address:
    token = os.environ.get(TOKEN, "")
    if len(token) < 16:
        raise ConfigurationError(f"{TOKEN}: give a secret of at least 16 characters, or start 'fringedic operate'")
    files = [Path(name) if name else None for name in (parameters.certificate, parameters.key)]
    return Address(parameters.address, parameters.port, token, *files)


def main() -> int:
    """Run the operator node."""
    return run(OperatorNode)


if __name__ == "__main__":
    raise SystemExit(main())
