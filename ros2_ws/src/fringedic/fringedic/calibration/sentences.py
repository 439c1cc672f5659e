"""Sentences about planes, grids, checks and results of a calibration, and instructions to the operator."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path

import numpy as np

from fringedic.calibration.check import CheckVerdict, RigCheck
from fringedic.calibration.findings import Action, CalibrationWarning, CheckProblem, CheckWarning, ImageProblem
from fringedic.calibration.fit_results import Candidate, PlaneResult, Reason
from fringedic.calibration.history import recorded_checks
from fringedic.calibration.placement import PlaneKind
from fringedic.calibration.recorded import RecordedPlane
from fringedic.calibration.result import RigCalibration
from fringedic.calibration.session import PlaneQuality
from fringedic.calibration.variants import ModelVariant
from fringedic.camera.carriers import aliasing_text
from fringedic.camera.findings import Finding, GridFinding
from fringedic.camera.grid import GridMeasurement
from fringedic.camera.tilted_grid import contradiction_text
from fringedic.errors import CalibrationError
from fringedic.wording.numbers import number_text

CHECK_AFTER = 7 * 86400.0  # [s] after which a change of temperature or an accidental contact is likely
_MM, _UM, _FRINGE = 1e3, 1e6, 2 * math.pi


def grid_in_words(grid: GridMeasurement) -> str:
    """Return the distortion, the pixel size and the position of the camera, with warnings."""
    plane = grid.plane
    words = (
        f"The distortion of the lens is {grid.magnitude:.3f} px RMS, with a residual of {grid.residual:.4f} px at the "
        f"points of the grid and a standard uncertainty of {grid.sigma:.4f} px. The pixel size on the plane is "
        f"{_UM * plane.pixel_size:.4f} µm."
    )
    if plane.pin_hole is not None:
        camera, sigma = plane.camera(plane.pin_hole.distance), np.sqrt(np.diag(plane.pin_hole.covariance))
        tilts = math.degrees(camera["camera_tilt_x"]), math.degrees(camera["camera_tilt_y"])
        words += (
            f" The camera is {_MM * plane.pin_hole.distance:.2f} mm above it (standard uncertainty "
            f"{_MM * sigma[0]:.2g} mm), tilted by {tilts[0]:+.3f} degree about x and "
            f"{tilts[1]:+.3f} degree about y (standard uncertainty "
            f"{math.degrees(sigma[1:].max() / plane.pin_hole.distance):.2g} degree)."
        )
    return " ".join([words, *map(finding_sentence, grid.warnings)])


def plane_in_words(quality: PlaneQuality) -> str:
    """Return how well a plane was measured."""
    return f"{100 * quality.valid:.0f} % of the image measured, noise {quality.noise / _FRINGE:.4f} fringe"


def recorded_plane_in_words(plane: RecordedPlane) -> str:
    """Return which plane of a recording was measured, and how well."""
    if plane.quality is None:
        return f"grid at {math.degrees(plane.angle):+.2f} degree"
    return f"plane {plane.step + 1}: {plane_in_words(plane.quality)}"


def calibration_in_words(calibration: RigCalibration) -> str:
    """Return the verdict of a calibration and its warnings."""
    return " ".join([verdict_sentence(calibration), *warning_sentences(calibration)])


def verdict_sentence(calibration: RigCalibration) -> str:
    """Return whether a calibration can be used and why, beginning with GO, GO with care or NO-GO."""
    return f"{calibration.verdict}. {reason_sentence(calibration)}"


def reason_sentence(calibration: RigCalibration) -> str:
    """Return the reason of the verdict with the figures that decide."""
    return _REASONS[calibration.reason](calibration)


def warning_sentences(calibration: RigCalibration) -> list[str]:
    """Return one sentence for each warning of a calibration."""
    return [finding_sentence(each) for each in calibration.warnings]


def problem_sentence(plane: PlaneResult) -> str:
    """Return why an image contradicts the others; empty when it does not."""
    return "" if plane.problem is None else _text(plane.problem)


def finding_sentence(finding: Finding) -> str:
    """Return a finding as a sentence that names the image or the places concerned."""
    if finding.code is CalibrationWarning.TEXT:
        return finding.subject
    named = f"{finding.subject}: " if finding.subject and not isinstance(finding.code, GridFinding) else ""
    return _sentence(f"{named}{_text(finding)}", capital=not named)


def model_choice_sentence(calibration: RigCalibration) -> str:
    """Return the residuals of the models, and which of them the data support."""
    found = {each.name: each for each in calibration.candidates}
    noise = f"the noise of a pixel is {_micro(calibration.predicted, 3)}"
    six, general = (_left(found[variant]) for variant in (ModelVariant.SIX_PARAMETER, ModelVariant.GENERAL))
    if calibration.variant is ModelVariant.SIX_PARAMETER:
        return (
            f"The residual of the six-parameter model is {six}, that of the general model {general} ({noise}): the "
            "data do not support more than the six parameters."
        )
    return (
        f"The residual of the six-parameter model is {six}; with a free direction of the projector, the distortion of "
        f"its lens and a free rotation axis it is {general} ({noise})."
    )


def check_in_words(check: RigCheck) -> str:
    """Return the result of a check of the rig and its warnings."""
    return " ".join([check_sentence(check), *check_warning_sentences(check)])


def check_sentence(check: RigCheck) -> str:
    """Return whether the rig holds its calibration, with the figures that decide."""
    if check.verdict is CheckVerdict.FAILS:
        problems = "; and ".join(_CHECKS[each.code](check) for each in check.problems)
        return f"The rig does not hold its calibration: {problems}. Calibrate again."
    scale = ""
    if not math.isnan(check.expected):
        scale = f"; {_MM * check.expected:.3f} mm measured as {measured_distance(check)}"
    change = ", but there is a significant change" if check.verdict is CheckVerdict.HOLDS_WITH_CHANGE else ""
    flat = f"the plate is measured as flat to {_micro(check.flatness)} ({_noise(check.noise)})"
    return f"The rig holds its calibration{change}: {flat}{scale}."


def measured_distance(check: RigCheck) -> str:
    """Return the measured known distance with its standard uncertainty, such as "5.0012 ± 0.0008 mm"."""
    digits = max(1, min(6, 1 - math.floor(math.log10(_MM * max(check.distance_sigma, 1e-9)))))
    return f"{_MM * check.distance:.{digits}f} ± {_MM * check.distance_sigma:.{digits}f} mm"


def check_warning_sentences(check: RigCheck) -> list[str]:
    """Return one sentence for each warning of a check."""
    return [_CHECKS[each.code](check) for each in check.warnings]


def in_force_words(file: Path, now: datetime) -> list[str]:
    """Return what an operator should read about a calibration before it is used: age, latest check and warnings.

    Parameters
    ----------
    file
        The model with the other files of its calibration beside it; without them nothing is known about it.
    now
        The time.
    """
    try:
        calibration = RigCalibration.load(file)
        checks = recorded_checks(file.parent)
    except CalibrationError as error:
        return [f"calibration {file}: its age and its quality are not known: {error}"]
    age = calibration.age(now)
    identifier = calibration.model.identifier
    words = [f"calibration {identifier}, {_span_in_words(age)} old. {verdict_sentence(calibration)}"]
    since = age
    if checks:
        since = (now - datetime.fromisoformat(checks[-1].created)).total_seconds()
        words.append(f"last checked {_span_in_words(since)} ago: {checks[-1].verdict}")
    if since > CHECK_AFTER:
        words.append(
            f"{'the check' if checks else 'it'} is older than {_span_in_words(CHECK_AFTER)}: run `fringedic check` to "
            "find out whether it is still valid"
        )
    return [*words, *warning_sentences(calibration)]


def _bad_images(calibration: RigCalibration) -> str:
    named = "; ".join(f"{each.name}: {problem_sentence(each)}" for each in calibration.planes if each.problem)
    agreement = f"{_micro(calibration.systematic)} ({_noise(calibration.predicted)})"
    return f"{_sentence(named, capital=False)} Without it the planes agree to {agreement}."


def _no_rig(calibration: RigCalibration) -> str:
    worst = calibration.worst_plane
    return (
        f"No rig fits the planes: they deviate by {_micro(calibration.systematic)}, and "
        f"{_noise(calibration.predicted)}; {worst.name} deviates most, by {_micro(worst.systematic)}. "
        "Did the rig move? Is the plane flat?"
    )


def _beyond_noise(calibration: RigCalibration) -> str:
    worst = calibration.worst_plane
    return (
        f"The planes deviate by {_micro(calibration.systematic)}{_tested(calibration)} from the model, more than noise "
        f"explains in {worst.name} ({_micro(worst.systematic)}; {_noise(calibration.predicted)})."
    )


_REASONS: dict[Reason, Callable[[RigCalibration], str]] = {
    Reason.BAD_IMAGE: _bad_images,
    Reason.NO_RIG_FITS: _no_rig,
    Reason.HELD_OUT_DEVIATES: lambda calibration: (
        f"The planes kept out of the fit deviate by up to {_micro(calibration.held_out)}, those in it by "
        f"{_micro(calibration.systematic)} ({_noise(calibration.predicted)}): their angles are wrong, the rig "
        "moved, or there are too few planes in the fit."
    ),
    Reason.NOT_CONVERGED: lambda _: (
        "The planes do not determine the rig: the search for its parameters did not end. Measure more planes, at "
        "angles of 10 to 20 degree to both sides."
    ),
    Reason.UNCERTAIN_HEIGHT: lambda calibration: (
        f"The standard uncertainty of z due to the calibration is {_micro(calibration.height_sigma)} "
        f"({_noise(calibration.predicted)}): use more planes or larger angles."
    ),
    Reason.BEYOND_NOISE: _beyond_noise,
    Reason.WITHIN_NOISE: lambda calibration: (
        f"The planes deviate by {_micro(calibration.systematic)} from the model{_tested(calibration)}; "
        f"{_noise(calibration.predicted)}."
    ),
}


def _text(finding: Finding) -> str:
    """Return the words of a finding, without the image that it concerns."""
    return _FINDINGS[finding.code](finding)


def _other_place(finding: Finding) -> str:
    values = finding.values
    return (
        f"the plane was at {math.degrees(values['angle']):.2f} degree, not at {math.degrees(values['stated']):g}, and "
        f"{_MM * values['lift']:+.3f} mm away: was it pushed or clamped again?"
    )


def _ripples(amplitude: float) -> str:
    return f"its phase ripples with the fringes by {amplitude / _FRINGE:.4f} fringe, the others do not"


def _common_ripple(finding: Finding) -> str:
    harmonic = int(finding.values["harmonic"])
    cause = (
        "the light or the exposure is not the same for all frames"
        if harmonic <= 2
        else "measure the response curve of projector and camera, or use more shifts"
    )
    return (
        f"all phases ripple {harmonic} times per fringe by {finding.values['amplitude'] / _FRINGE:.4f} fringe: {cause}"
    )


def _in_step(finding: Finding) -> str:
    values = finding.values
    periods = {name: values[f"period_{name}"] for name in ("columns", "rows") if f"period_{name}" in values}
    return aliasing_text(periods, values["turn"], values.get("advised_turn"))


def _contradiction(finding: Finding) -> str:
    values = finding.values
    stated, apparent = (
        [value for name, value in values.items() if name.startswith(kind)] for kind in ("stated", "apparent")
    )
    return (
        f"{contradiction_text(stated, apparent, values['residual'])} If only the angles are inaccurate, state the "
        "standard uncertainty of the stage as sigma_angle_degree"
    )


_ACTIONS = {
    Action.GRIDS: "images of the grid on the plane at 0 degree and tilted to both sides reduce",
    Action.ANGLES: "planes at angles up to twice as large reduce",
    Action.PLANES: "twice as many planes reduce",
}


def _improvement(values: Mapping[str, float], unit: float) -> str:
    """Return what reduces an uncertainty most, and to which value; empty for files that do not contain it."""
    if "action" not in values:
        return ""
    return f": {_ACTIONS[Action(int(values['action']))]} this most, to {number_text(values['reduced'] / unit, 2)} µm"


_FINDINGS: dict[str, Callable[[Finding], str]] = {
    GridFinding.SATURATED: lambda finding: (
        f"{finding.values['share']:.0%} of the grid image is saturated: reduce the exposure"
    ),
    GridFinding.IN_STEP: _in_step,
    GridFinding.COVERED: lambda finding: f"part of the grid is covered, dark or blurred at: {finding.subject}",
    GridFinding.ASPECT: lambda finding: (
        f"the periods of the grid differ by {finding.values['difference']:.1%} along rows and columns: check the "
        "printer's scale along both edges of the sheet, unless the camera's pixels are not square"
    ),
    GridFinding.SKEW: lambda finding: (
        f"the angle between the directions of the grid is {math.degrees(finding.values['angle']):.2f} degree instead "
        "of 90: is the sheet flat?"
    ),
    GridFinding.CONTRADICTION: _contradiction,
    ImageProblem.TEXT: lambda finding: finding.subject,
    ImageProblem.WRONG_ORDER: lambda finding: (
        f"its fringe order is wrong by {int(finding.values['orders']):+d} everywhere: measure it again with all pitches"
    ),
    ImageProblem.PARTLY_WRONG_ORDER: lambda finding: (
        f"the fringe order is wrong on {100 * finding.values['share']:.0f} % of it: "
        "check light, shadows and the coarse pitches"
    ),
    ImageProblem.MOVED_OR_FLICKER: lambda finding: (
        f"{_ripples(finding.values['ripple'])}: the plane moved, or the light changed, while its frames were taken; "
        "measure it again"
    ),
    # a plane that was turned in the middle of its frames gives the same phase as one at half the angle
    ImageProblem.OTHER_ANGLE: lambda finding: (
        f"the plane was at {math.degrees(finding.values['angle']):.2f} degree, not at "
        f"{math.degrees(finding.values['stated']):g}: correct the angle, or measure it again if the plane may have "
        "turned while its frames were taken"
    ),
    ImageProblem.OTHER_HEIGHT: lambda finding: (
        f"the plane was {_MM * finding.values['lift']:+.3f} mm away from its stated position: was it pushed or clamped "
        "again?"
    ),
    ImageProblem.OTHER_PLACE: _other_place,
    ImageProblem.NOT_THIS_PLANE: lambda _: (
        "its phase is not that of the plane at any angle: the projector showed a wrong pattern, frames are out of "
        "order, or something else was in front of the camera; measure it again"
    ),
    CalibrationWarning.OUTLIERS: lambda finding: (
        f"{100 * finding.values['share']:.1f} % of the pixels contradict their surroundings "
        "(wrong fringe orders, dirt or edges) and are not used"
    ),
    CalibrationWarning.RIPPLE: lambda finding: (
        f"{_ripples(finding.values['amplitude'])}: the light changed, or something moved, while its frames were taken"
    ),
    CalibrationWarning.COMMON_RIPPLE: _common_ripple,
    CalibrationWarning.NARROW_ANGLES: lambda finding: (
        f"the angles span {math.degrees(finding.values['span']):.1f} degree only; 20 to 30 degree calibrate the "
        "heights several times better"
    ),
    CalibrationWarning.TILT_UNKNOWN: lambda _: (
        "the camera's tilt was not measured by a grid on the plane: it is known to a degree only, which increases the "
        "uncertainty of x and y"
    ),
    CalibrationWarning.TILT_FROM_ONE_PLANE: lambda _: (
        "the grid was measured on the plane at 0 degree only, which does not distinguish a tilted camera from a lens "
        "that is off its axis: x and y may contain some tenths of a percent of a motion towards the camera. Measure "
        "the grid with the plane tilted to both sides as well"
    ),
    CalibrationWarning.FEW_PLANES: lambda finding: (
        f"{int(finding.values['count'])} planes were fitted: with 5 or more a faulty one can be found"
    ),
    CalibrationWarning.NOT_TESTED: lambda _: "no plane at a position of its own was kept out of the fit to test it",
    CalibrationWarning.UNCERTAIN_HEIGHT: lambda finding: (
        f"the calibration leaves z uncertain by up to {_micro(finding.values['sigma'], 3)}, more than the noise of a "
        f"pixel{_improvement(finding.values, 1e-6)}"
    ),
    CalibrationWarning.NOT_CONVERGED: lambda _: "the search for the parameters of the rig did not end",
    CalibrationWarning.UNEXPLAINED: lambda finding: (
        "no model of a rig explains the phases within their noise: neighbouring parts of the image err together, so "
        f"that {finding.values['blocks']:.0f} count as one (pattern of the projector's pixels, response, a plane that "
        f"is not flat). The stated uncertainty contains this: {number_text(1e3 * finding.values['sigma'], 2)} µm in u "
        "or v for each millimetre of motion towards the camera"
    ),
    CalibrationWarning.UNCERTAIN_MOTION: lambda finding: (
        f"the calibration leaves u and v uncertain by {number_text(1e3 * finding.values['sigma'], 2)} µm for each "
        f"millimetre of motion towards the camera{_improvement(finding.values, 1e-3)}"
    ),
    CalibrationWarning.DRIFT: lambda finding: (
        f"the rig moved by {_UM * finding.values['change']:.2f} µm RMS while it was calibrated, more than the noise of "
        f"a pixel ({_UM * finding.values['noise']:.2f} µm): let projector and camera warm up, check that nothing can "
        "shift, and calibrate again"
    ),
    CalibrationWarning.DRIFT_UNKNOWN: lambda _: (
        "the first plane was not measured again in the same place, so that it is unknown whether the rig moved while "
        "it was calibrated"
    ),
}


_CHECKS: dict[str, Callable[[RigCheck], str]] = {
    CheckProblem.BENT: lambda check: (
        f"a flat plate is measured as bent by {_micro(check.flatness)} ({_noise(check.noise)}): camera, projector or "
        "lens has moved since the calibration, or the plate is not flat"
    ),
    CheckProblem.SCALE: lambda check: (
        f"a distance of {_MM * check.expected:.3f} mm is measured as {measured_distance(check)} "
        f"({100 * check.scale_error / check.expected:+.2f} %): the scale or the geometry has changed"
    ),
    CheckWarning.OLD: lambda check: f"The calibration is {check.age / 86400:.0f} days old.",
    CheckWarning.DRIFT: lambda check: (
        f"The plate seems to have moved by {_micro(check.drift)} since its earlier measurement: wait until projector "
        "and camera are warm."
    ),
    CheckWarning.SCALE_NOT_CHECKED: lambda _: "No known distance was measured: the scale is not checked.",
}


def _left(candidate: Candidate) -> str:
    return _micro(candidate.systematic, 3)


def _tested(calibration: RigCalibration) -> str:
    return f", planes kept out by up to {_micro(calibration.held_out)}" if calibration.tested else ""


def _noise(noise: float) -> str:
    return f"the noise of a pixel is {_micro(noise)}"


def _micro(value: float, digits: int = 2) -> str:
    return f"{number_text(_UM * value, digits)} µm"


def _sentence(words: str, *, capital: bool = True) -> str:
    first = words[:1].upper() if capital else words[:1]
    return f"{first}{words[1:]}{'' if words.endswith(('.', '?')) else '.'}"


def _span_in_words(seconds: float) -> str:
    for unit, length in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds:.0f} seconds"


_NAMES = {PlaneKind.GRID: "the grid", PlaneKind.PLANE: "the plane", PlaneKind.SPECIMEN: "the specimen"}


def position_in_words(kind: int, angle: float, height: float) -> str:
    """Return the position of an object that a stage has placed; angle [rad], height [m]."""
    if kind == PlaneKind.SPECIMEN:
        return _NAMES[PlaneKind.SPECIMEN]
    return f"{_NAMES[PlaneKind(kind)]} at {math.degrees(angle) + 0.0:+.2f} degree and {1e3 * height + 0.0:+.3f} mm"


def placing_instruction(kind: int, angle: float, height: float) -> str:
    """Return the instruction to put something in front of the camera; angle [rad], height [m]."""
    if kind == PlaneKind.SPECIMEN:
        return "put the specimen back"
    degrees, lift = math.degrees(angle), 1e3 * height
    side = f" ({'right' if degrees > 0 else 'left'} side towards the camera)" if abs(degrees) > 1e-6 else ""
    if kind == PlaneKind.GRID and not side:
        return "lay the printed grid on the reference plane at 0 degree, turned in its plane by 1 to 3 degrees"
    if kind == PlaneKind.GRID:
        return f"turn the reference plane with the grid on it to {degrees:+.2f} degree{side}"
    lifted = f", {abs(lift):.3f} mm {'above' if lift > 0 else 'below'} its place" if abs(lift) > 1e-6 else ""
    return f"turn the plain reference plane to {degrees + 0.0:+.2f} degree{side}{lifted}"
