"""Does the rig still hold its calibration? A flat plane and a known distance are measured by the same nodes."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from fringedic.calibration import RigCalibration, RigCheck, check_rig
from fringedic.calibration.history import record_check
from fringedic.errors import CalibrationFileError, InvalidCalibrationError, RigFileError
from fringedic.recording import BagReader
from fringedic.results import image_array
from fringedic.rig_file import VIRTUAL_RIG, RigFile, load_calibration
from fringedic.sequence import stamp_of
from fringedic_bringup.calibrate import calibration_client
from fringedic_bringup.report import Progress
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
    domain: int | None = None,
) -> RigCheck:
    """Measure the reference plane at its place, lifted by a known distance, and at its place again.

    The result is kept beside the calibration; later recordings and reports tell it.

    The plane has to come out flat, the distance right, and the plane unchanged, if the rig is warm and holds its
    calibration.

    Parameters
    ----------
    rig, rig_path
        The rig file and where it was read.
    folder
        Gets the recording ``bag`` and ``logs``.
    progress
        Told what goes on.
    distance
        By which the plane is lifted towards the camera [m].
    ask
        Asks an operator to do something, where no stage does it; False when he does not want to.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    RigFileError
        The folder holds a recording already, or the rig has no calibration or no projector.
    NodeDiedError, NotAnsweredError, StepFailedError
        The nodes did not start, one of them ended, or a plane could not be placed or measured.
    """
    model = load_calibration(rig, rig_path)
    if model is None or rig.projector is None:
        raise RigFileError(f"{rig_path}: has no {'calibration' if rig.projector else 'projector'}; nothing to check")
    rig = rig.model_copy(update={"recording": rig.recording.model_copy(update={"derived": True})})
    heights = [0.0, distance, 0.0]
    stamps = []
    with calibration_client(rig, rig_path, folder, progress, ask=ask, domain=domain) as client:
        for number, height in enumerate(heights, start=1):
            progress.step(number, len(heights), f"the plane {1e3 * height:g} mm above its place")
            client.place(PLANE, height=height)
            stamps.append(to_nanoseconds(client.measure().stamp))
        client.place(PlaceReferencePlane.Request.SPECIMEN)
        client.wait_until_recorded()
    first, lifted, last = _maps(folder / "bag", "phase/map", stamps)
    finest = rig.projections()[-1]
    found = check_rig(
        model,
        last,
        _maps(folder / "bag", "phase/sigma", stamps)[-1],
        pitch=finest.pitch,
        orientation=finest.orientation,
        distance=distance,
        lifted=lifted,
        earlier=first,
        age=_age(rig, rig_path),
    )
    calibrated = calibration_folder(rig, rig_path)
    if calibrated is not None:
        record_check(calibrated, found, datetime.fromtimestamp(1e-9 * stamps[-1], UTC))
    return found


def calibration_folder(rig: RigFile, rig_path: Path) -> Path | None:
    """Return the folder of the calibration that a rig file names; None for the exact one of a virtual rig."""
    if not isinstance(rig.calibration, str) or rig.calibration == VIRTUAL_RIG:
        return None
    return (rig_path.parent / rig.calibration).parent


def _age(rig: RigFile, rig_path: Path) -> float:
    """Age of the calibration that a rig file names [s]; NaN when nothing tells."""
    folder = calibration_folder(rig, rig_path)
    if folder is None:
        return math.nan
    try:
        return RigCalibration.load(folder).age()
    except (CalibrationFileError, InvalidCalibrationError):
        return math.nan


def _maps(bag: Path, topic: str, stamps: list[int]) -> list[np.ndarray]:
    reader = BagReader(bag)
    found = {stamp_of(message): message for _, message, _ in reader.messages(reader.find(topic).values())}
    return [image_array(found[stamp]) for stamp in stamps]
