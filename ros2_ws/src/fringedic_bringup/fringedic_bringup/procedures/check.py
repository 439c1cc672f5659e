"""Checks whether a calibration is still valid: a flat plane and a known distance, measured by the same nodes."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from fringedic.calibration import RigCalibration, RigCheck, check_rig
from fringedic.calibration.history import record_check
from fringedic.calibration.placement import apart
from fringedic.calibration.recorded_phases import recorded_phases
from fringedic.calibration.sentences import check_in_words
from fringedic.command.outcome import Progress
from fringedic.configuration.calibration_in_use import calibration_to_check
from fringedic.configuration.rig_file import RigFile
from fringedic.errors import CalibrationError
from fringedic.report.check import CHECK_PAGE, write_check_page
from fringedic_bringup.procedures.calibrate import calibration_client, placing_by, traceability_of
from fringedic_msgs.srv import PlaceReferencePlane
from fringedic_ros.stamps import to_nanoseconds

PLANE = PlaceReferencePlane.Request.PLANE


def check(
    rig: RigFile,
    rig_path: Path,
    folder: Path,
    progress: Progress,
    *,
    distance: float,
    ask: Callable[[str], bool],
    watch: Callable[[], None] = lambda: None,
    domain: int | None = None,
) -> RigCheck:
    """Measure the reference plane in its place, lifted by a known distance, and in its place again.

    The calibration is valid when the plane is flat, the distance is right, and the last plane agrees with the first.
    The result is stored beside the calibration, for later recordings and reports, and as a page in the folder.

    Parameters
    ----------
    rig, rig_path
        The rig file, and its path.
    folder
        Where the recording ``bag``, the page ``check.html`` and ``logs`` are written.
    progress
        Receives the progress.
    distance
        Distance by which the plane is lifted towards the camera [m].
    ask
        Asks an operator to place the plane where there is no stage; returns False when the operator stops.
    watch
        Called about ten times a second while waiting; an exception that it raises ends the check.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    ConfigurationError
        The folder contains a recording already, the rig has no projector, or no calibration that fits it.
    CalibrationError
        The stage reports that it did not lift the plane, or did not put it back.
    NodeDiedError, WaitTimeoutError, StepFailedError
        The nodes did not start, one of them ended, or a plane could not be placed or measured, or left its place.
    """
    model = calibration_to_check(rig, rig_path)
    rig = rig.model_copy(update={"recording": rig.recording.model_copy(update={"derived": True})})
    heights = [0.0, distance, 0.0]
    stamps, reached = [], []
    with calibration_client(rig, folder, progress, place=placing_by(ask), watch=watch, domain=domain) as client:
        for number, height in enumerate(heights, start=1):
            progress.part(number, len(heights), f"plane {1e3 * height:g} mm above its place")
            reached.append(client.place(PLANE, height=height).height)
            stamps.append(to_nanoseconds(client.measure().stamp))
            client.require_place()
        client.place(PlaceReferencePlane.Request.SPECIMEN)
        client.wait_until_recorded()
    lifted_by = reached[1] - reached[2]  # the last plane is compared with the lifted one
    if not apart(0.0, lifted_by):
        raise CalibrationError(
            f"the stage did not lift the plane: it reports {1e3 * reached[1]:.3f} mm for {1e3 * distance:g} mm; check "
            "its driver"
        )
    if apart(0.0, reached[2] - reached[0]):
        raise CalibrationError(
            f"the stage did not put the plane back: it reports {1e3 * reached[2]:.3f} mm instead of "
            f"{1e3 * reached[0]:.3f} mm; check its play and its driver"
        )
    file = rig.calibration_file
    known = None if file is None else _calibration_in(file)
    first, lifted, last = recorded_phases(folder / "bag", stamps)
    finest = rig.patterns()[-1]
    result = check_rig(
        model,
        last.phase,
        last.sigma,
        pitch=finest.pitch,
        orientation=finest.orientation,
        distance=lifted_by,
        lifted=lifted,
        earlier=first,
        age=math.nan if known is None else known.age(),
    )
    when = datetime.fromtimestamp(1e-9 * stamps[-1], UTC)
    write_check_page(result, folder / CHECK_PAGE, rig=model.identifier, created=when, traceability=traceability_of(rig))
    if file is not None and known is not None:
        record_check(file.parent, result, when, verdict=check_in_words(result))
    return result


def _calibration_in(file: Path) -> RigCalibration | None:
    """Return the calibration whose model is in a file; None when the file holds a model alone."""
    try:
        return RigCalibration.load(file)
    except CalibrationError:
        return None
