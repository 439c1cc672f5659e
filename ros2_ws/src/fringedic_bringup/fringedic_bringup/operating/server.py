"""Node `procedures`: starts procedures on request, one at a time, and publishes their state."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from types import TracebackType
from typing import Any, Self

from std_msgs.msg import Bool

from fringedic.configuration.changes import change_rig_file
from fringedic.errors import FringedicError, OperatorError
from fringedic.rig_setup.check_list import CheckList, ListedItem, SetupItem, SetupRecord
from fringedic.rig_setup.live_sentences import next_sentence
from fringedic.wording.causes import cause_of
from fringedic_bringup.operating.procedures import Place, Request, check_request, execute, requested
from fringedic_bringup.operating.status import STOPPED, Job, State, Status
from fringedic_bringup.participant import Participant
from fringedic_msgs.msg import ProcedureStatus, SetupState, StepReport
from fringedic_msgs.msg import SetupItem as SetupItemMessage
from fringedic_msgs.srv import ControlProcedure, StartProcedure
from fringedic_ros.qos import LATCHED, LATEST
from fringedic_ros.stamps import to_msg
from fringedic_ros.waiting import Patience

CONFIRM = "confirm"  # the procedure that records an item of the live view as done
USE = "use"  # the procedure that enters the result of an item in the rig file
LIVE_ITEMS = (SetupItem.AXES, SetupItem.CAMERA_FOCUS, SetupItem.PROJECTOR_FOCUS)
LONGEST_END_S = 60.0  # of a live view, or of any procedure at the end of the server
LOST_S = 5.0  # without a sign of the driver's page
PERIOD_S = 0.05
AGAIN_S = 10.0  # after which a live view that failed begins again


class ProcedureServer:
    """Serves ``procedures/start`` and ``procedures/control``; publishes ``procedures/status`` and ``procedures/setup``.

    Whenever no other procedure runs, the last live view continues.

    Parameters
    ----------
    place
        The rig.
    """

    def __init__(self, place: Place) -> None:
        self._place = place
        self._participant = Participant("procedures", place.rig.topic_namespace, domain=place.domain)
        node = self._participant.node
        self._changed = threading.Event()
        self._running: Job | None = None
        self._thread: threading.Thread | None = None
        self._next: Request | None = None
        self._live: Request | None = requested("live", "white")
        self._live_from = 0.0  # not before this time [s]
        self._figures: tuple[str, ...] = ()  # of the last live view
        self._list_file = place.own_file("setup.yaml")
        self._list = CheckList.load(self._list_file)
        self._shown_time = 0  # change of the rig file whose content the check list shows
        self._driver_silence = Patience(LOST_S)
        # the result of the last procedure stays there while the live view runs
        self._statuses = {
            live: node.create_publisher(ProcedureStatus, f"procedures/{topic}", LATCHED)
            for live, topic in ((True, "live"), (False, "status"))
        }
        self._setups = node.create_publisher(SetupState, "procedures/setup", LATCHED)
        node.create_subscription(Bool, "operator/driver_present", self._see_driver, LATEST)
        node.create_service(StartProcedure, "procedures/start", self._start)
        node.create_service(ControlProcedure, "procedures/control", self._control)
        self._publish_setup()

    @property
    def is_measuring(self) -> bool:
        """Whether a procedure other than the live view runs or is about to begin."""
        return self._next is not None or (self._running is not None and not self._running.is_live)

    def spin_once(self) -> None:
        """Run callbacks, begin the next procedure when the one before has ended, and publish changes."""
        self._participant.spin_once(PERIOD_S)
        if self._thread is not None and not self._thread.is_alive():
            self._take_result()
        if self._thread is None and (request := self._due()) is not None:
            self._next = None
            self._begin(request)
        if self._changed.is_set():
            self._changed.clear()
            self._publish()
        self._pause_without_driver()
        if self._rig_file_time() != self._shown_time:  # it decides which results are in use
            self._publish_setup()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        """End the procedure in order, and the node."""
        self._live = self._next = None
        if self._running is not None and self._thread is not None:
            self._running.stop()
            self._thread.join(LONGEST_END_S)
        self._participant.close()

    def _start(self, request: StartProcedure.Request, response: StartProcedure.Response) -> StartProcedure.Response:
        with _answering(response):
            if request.procedure == CONFIRM:
                self._confirm(request.pattern)
            elif request.procedure == USE:
                response.message = self._use(request.pattern)
            else:
                self._accept(requested(request.procedure, request.pattern, request.text, request.options))
        return response

    def _accept(self, request: Request) -> None:
        running = self._running
        self._require_idle()
        check_request(self._place, request)
        if request.procedure == "live":
            self._live, self._live_from = request, 0.0
        else:
            self._next = request
        if running is not None:
            running.stop()

    def _require_idle(self) -> None:
        """Refuse a change while a procedure other than the live view runs.

        Raises
        ------
        OperatorError
            One runs, or is about to begin.
        """
        if self.is_measuring:
            running = self._running
            what = "a procedure is starting" if running is None else f"{running.status.procedure} is running"
            raise OperatorError(f"{what}: wait until it has ended, or stop it")

    def _control(
        self, request: ControlProcedure.Request, response: ControlProcedure.Response
    ) -> ControlProcedure.Response:
        with _answering(response):
            running = self._running
            if running is None:
                raise OperatorError("nothing runs: start a procedure first")
            actions = {
                request.PAUSE: running.pause,
                request.RESUME: running.resume,
                request.STOP: self._stop,
                request.CONFIRM: lambda: running.answer(True),
                request.REFUSE: lambda: running.answer(False),
            }
            if request.command not in actions:
                raise OperatorError(f"command {request.command} is unknown")
            actions[request.command]()
        return response

    def _stop(self) -> None:
        if self._running is not None:
            if self._running.is_live:
                self._live = None
            self._running.stop()

    def _due(self) -> Request | None:
        """Return what begins now: a requested procedure, else the live view, which waits after a failure."""
        return self._next or (self._live if time.monotonic() >= self._live_from else None)

    def _begin(self, request: Request) -> None:
        job = self._running = Job(request.procedure, request.pattern, self._changed.set)
        self._thread = threading.Thread(target=execute, args=[self._place, job, request], name=request.procedure)
        self._thread.start()
        self._changed.set()

    def _take_result(self) -> None:
        """Keep the result of the procedure that has ended."""
        job, self._running, self._thread = self._running, None, None
        if job is None:
            return
        self._publish_status(job)
        status = job.status
        if job.is_live:
            self._figures = job.figures
            if status.state == State.FAILED:
                self._live_from = time.monotonic() + AGAIN_S
        elif _is_listed(status):
            outcome = status.outcome
            self._record(
                SetupItem(status.procedure),
                SetupRecord(
                    when=datetime.now(UTC),
                    words=tuple(outcome.words),
                    folder=status.folder,
                    picture=outcome.picture,
                    good=outcome.good,
                    settings=outcome.settings,
                    measured_with=outcome.measured_with,
                ),
            )

    def _confirm(self, item: str) -> None:
        if item not in LIVE_ITEMS:
            raise OperatorError(f"{item}: has to be measured; it cannot be confirmed")
        live = self._running if self._running is not None and self._running.is_live else None
        words = self._figures if live is None else live.figures
        self._record(SetupItem(item), SetupRecord(when=datetime.now(UTC), words=words))

    def _use(self, item: str) -> str:
        """Enter the result of an item in the rig file, and return a sentence about it."""
        record = self._list.records.get(SetupItem(item)) if item in set(SetupItem) else None
        if record is None or not record.settings:
            raise OperatorError(f"{item}: has no result for the rig file; measure it first")
        self._require_idle()
        before = change_rig_file(self._place.rig_path, record.settings)
        return f"the rig file is changed; the file before is {before.name}"

    def _record(self, item: SetupItem, record: SetupRecord) -> None:
        self._list = self._list.with_record(item, record)
        try:
            self._list.save(self._list_file)
        except OSError as error:
            self._participant.node.get_logger().error(
                f"{self._list_file}: cannot be written: {cause_of(error)}; make room"
            )
        self._publish_setup()

    def _see_driver(self, present: Bool) -> None:
        if present.data:
            self._driver_silence.renew()

    def _pause_without_driver(self) -> None:
        job, is_lost = self._running, self._driver_silence.is_over()  # looked at also while nothing runs
        if is_lost and job is not None and job.holds_without_driver:
            job.note_pause("the page of the driver is closed: the programme pauses after the present step")

    def _publish(self) -> None:
        if self._running is not None:
            self._publish_status(self._running)

    def _publish_status(self, job: Job) -> None:
        self._statuses[job.is_live].publish(_status_message(job.status))

    def _rig_file_time(self) -> int:
        try:
            return self._place.rig_path.stat().st_mtime_ns
        except OSError:
            return 0

    def _publish_setup(self) -> None:
        self._shown_time = self._rig_file_time()
        items = [_item_message(each) for each in self._list.items(self._place.content(), self._place.folder)]
        message = SetupState(rig_file=str(self._place.rig_path), items=items)
        message.header.stamp = to_msg(time.time_ns())
        self._setups.publish(message)


def _is_listed(status: Status) -> bool:
    """Return whether the check list keeps the result of a procedure that has ended: a bad one only of a check.

    A calibration that is NO-GO leaves the one before in use, and its item as it was.
    """
    if status.procedure not in set(SetupItem):
        return False
    is_measured = bool(status.outcome.words) and status.outcome != STOPPED
    return status.state == State.DONE or (status.procedure == SetupItem.CHECK and is_measured)


@contextmanager
def _answering(response: Any) -> Iterator[None]:
    """Fill the response of a service: success, or the reason of a refusal."""
    try:
        yield
        response.success = True
    except FringedicError as error:
        response.success, response.message = False, str(error)


def _status_message(status: Status) -> ProcedureStatus:
    reports = [
        StepReport(
            step=each.step,
            white=each.white,
            position=each.position,
            force=each.force,
            valid_fraction=each.valid_fraction,
            rms_displacement=each.rms_displacement,
            rms_displacement_px=each.rms_displacement_px,
            processing_time=each.processing_time,
            error_message=each.error,
        )
        for each in status.reports
    ]
    message = ProcedureStatus(
        procedure=status.procedure,
        state=int(status.state),
        started=to_msg(round(1e9 * status.started)),
        activity=status.activity,
        step=status.step,
        steps=status.steps,
        frame=status.frame,
        frames=status.frames,
        question=status.question,
        pattern=status.pattern,
        folder=status.folder,
        notes=list(status.notes),
        words=list(status.outcome.words),
        settings=status.outcome.settings,
        error_message=status.error,
        reports=reports,
    )
    message.header.stamp = to_msg(time.time_ns())
    return message


def _item_message(listed: ListedItem) -> SetupItemMessage:
    message = SetupItemMessage(item=listed.item.value, state=listed.state.value)
    message.next = next_sentence(listed)
    if listed.record is not None:
        message.done = to_msg(round(1e9 * listed.record.when.timestamp()))
        message.words = list(listed.record.words)
        message.folder, message.picture = listed.record.folder, listed.record.picture
    return message
