"""Calibrates a rig: starts its nodes, has grid and planes placed by a stage or an operator, writes files and report."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from fringedic.calibration.placement import PlaneKind
from fringedic.calibration.result import RigCalibration
from fringedic.calibration.sentences import placing_instruction
from fringedic.calibration.traceability import Traceability
from fringedic.command.outcome import CalibrationReport, Progress
from fringedic.configuration.rig_file import RigFile
from fringedic.errors import ConfigurationError, EvidenceError
from fringedic.evidence.changes import begin_log
from fringedic.report.calibration import CALIBRATION_REPORT, write_calibration_report
from fringedic_bringup.client import PERSON_S, START_TIMEOUT_S, RigClient
from fringedic_bringup.launch.graph import calibration_graph
from fringedic_bringup.launch.processes import RunningGraph

ATTEMPTS = 1000  # of an operator at one place, who ends a calibration with a button
SPECIMEN_S = 5.0  # for a stage to put the specimen back after an error


def calibrate(
    rig: RigFile,
    rig_path: Path,
    folder: Path,
    progress: Progress,
    *,
    ask: Callable[[str], bool],
    watch: Callable[[], None] = lambda: None,
    domain: int | None = None,
) -> CalibrationReport:
    """Calibrate a rig and write recording, calibration and report into a folder.

    Parameters
    ----------
    rig, rig_path
        The rig file, whose section ``reference_plane`` defines the planes, and its path.
    folder
        Where the files are written.
    progress
        Receives the progress.
    ask
        Asks an operator to place grid or plane where there is no stage; returns False when the operator stops.
    watch
        Called about ten times a second while waiting; an exception that it raises ends the calibration.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    ConfigurationError
        The folder contains a recording already, the rig has no projector, or the pitch of the grid is not known.
    NodeDiedError, WaitTimeoutError, StepFailedError
        The nodes did not start, or one of them ended.
    """
    grid_pitch = rig.grid_pitch()
    if grid_pitch is None:
        raise ConfigurationError(
            f"{rig_path}: reference_plane.grid_pitch_mm is missing: the distance of the printed lines"
        )
    if rig.projector is None:
        raise ConfigurationError(f"{rig_path}: has no projector; there is nothing to calibrate but the camera")
    plane, feedback = rig.reference_plane, _Feedback(progress)
    with calibration_client(
        rig, folder, progress, place=placing_by(ask, feedback.before), watch=watch, domain=domain
    ) as client:
        camera = client.calibrate_distortion(
            grid_pitch,
            angles=plane.grid_angles,
            sigma_angle=plane.sigma_angle,
            frames=plane.grid_frames,
            folder=folder,
            feedback=feedback.of("grid"),
        )
        go = False
        if camera.error_code:
            words = [_failure(camera)]
        else:
            result = client.calibrate_rig(
                plane.angles,
                plane.heights,
                held_out=[number - 1 for number in plane.held_out],
                sigma_angle=plane.sigma_angle,
                sigma_height=plane.sigma_height,
                folder=folder,
                feedback=feedback.of("plane"),
            )
            go = bool(result.go and not result.error_code)
            words = [camera.verdict, _failure(result) if result.error_code else result.verdict]
        client.wait_until_recorded()
    if go:  # the node that wrote it does not know the rig file
        write_calibration_report(RigCalibration.load(folder), folder / CALIBRATION_REPORT, traceability_of(rig))
    try:
        begin_log(folder, "calibration", operator=rig.specimen.operator, details={"go": go})
    except EvidenceError as error:
        progress.note(f"the calibration is not signed: {error}; then 'fringedic note {folder}' signs it")
    return CalibrationReport(folder, go, tuple(words))


def traceability_of(rig: RigFile) -> Traceability:
    """Return what a rig file says about grid, stage and operator."""
    plane = rig.reference_plane
    return Traceability(
        grid_pitch=rig.grid_pitch(),
        stage="virtual" if rig.virtual_rig is not None else "placed by hand or by another program",
        sigma_angle=plane.sigma_angle,
        sigma_height=plane.sigma_height,
        operator=rig.specimen.operator,
        target=rig.hardware.calibration_target,
    )


@contextmanager
def calibration_client(
    rig: RigFile,
    folder: Path,
    progress: Progress,
    *,
    place: Callable[[int, float, float], str],
    watch: Callable[[], None] = lambda: None,
    domain: int | None,
) -> Iterator[RigClient]:
    """Start the nodes that measure the reference plane and yield their client; parameters as of `calibrate`.

    Without a stage `place` has planes placed, as of `RigClient.serve_placing`. After an error a stage is
    requested to put the specimen back.

    Raises
    ------
    ConfigurationError
        The folder contains a recording already.
    NodeDiedError, WaitTimeoutError
        The nodes did not start.
    """
    if (folder / "bag").exists():
        raise ConfigurationError(f"{folder} contains a recording already; choose another --output")
    folder.mkdir(parents=True, exist_ok=True)
    graph = calibration_graph(rig, folder)
    progress.stage(f"starting {len(graph.nodes)} nodes")
    with RunningGraph(graph, folder / "logs", domain=domain) as running:

        def check() -> None:
            running.check()
            watch()

        with RigClient(graph.namespace, domain=domain, watch=check) as client:
            client.wait_until_ready(graph.names)
            service = client.node.resolve_service_name("reference_plane/place")
            has_stage = "stage" in graph.names or bool(client.node.count_services(service))  # or a driver of a real one
            if not has_stage:
                client.serve_placing(place)
                _wait_for_a_person(client)
            try:
                yield client
            except BaseException:
                if has_stage:
                    client.abandon_planes(SPECIMEN_S)
                raise


def _wait_for_a_person(client: RigClient) -> None:
    """Let the experiment node wait for a plane as long as the client does, and measure a rejected one again.

    Its defaults are those of a stage, which would place the plane as before.
    """
    patience = Parameter("placing_timeout_s", value=PERSON_S), Parameter("placing_attempts", value=ATTEMPTS)
    setting = client.node.create_client(SetParameters, "experiment/set_parameters")
    request = SetParameters.Request(parameters=[each.to_parameter_msg() for each in patience])
    client.call_again(setting, request, START_TIMEOUT_S)


class _Feedback:
    """Passes the feedback of the calibration actions on as progress, and keeps the latest."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._latest: deque[str] = deque(maxlen=2)

    def of(self, what: str) -> Callable[[Any], None]:
        """Return a function for the feedback of one action."""

        def show(feedback: Any) -> None:
            if not feedback.frames:
                self._latest.append(feedback.words)
            words = f"{what}: {feedback.words}"
            self._progress.part(feedback.plane, feedback.planes, words, feedback.frame, feedback.frames)

        return show

    def before(self, words: str) -> str:
        """Return the latest feedback other than this one; empty without any."""
        return next((each for each in reversed(self._latest) if each != words), "")


def _failure(result: Any) -> str:
    return f"{result.error_message} (error {result.error_code})"


def placing_by(
    ask: Callable[[str], bool], heard_before: Callable[[str], str] = lambda _: ""
) -> Callable[[int, float, float], str]:
    """Return a function for `RigClient.serve_placing` that asks an operator.

    Parameters
    ----------
    ask
        Asks the operator; returns False when the operator stops.
    heard_before
        Returns what the experiment node has reported before an instruction: why it requests a place again.
    """
    last: list[tuple[int, float, float]] = []

    def place(kind: int, angle: float, height: float) -> str:
        if kind == PlaneKind.SPECIMEN:
            return ""  # nothing waits for the specimen
        instruction = placing_instruction(kind, angle, height)
        question = instruction[:1].upper() + instruction[1:]
        if last == [(kind, angle, height)]:
            reason = heard_before(instruction) or "the log contains the reason"
            question = f"This place was not measured ({reason}). Once more: {instruction}"
        last[:] = [(kind, angle, height)]
        return "" if ask(question) else "the operator stopped"

    return place
