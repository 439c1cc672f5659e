"""Sentences about the registration of sensors and the overlap of their surfaces."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence

import numpy as np
import xarray as xr

from fringedic.camera.findings import Finding
from fringedic.datasets.quantities import JOINED_MAPS
from fringedic.sensors.distance import DistanceAcross
from fringedic.sensors.findings import RegistrationFinding, RegistrationVerdict
from fringedic.sensors.join import SENSOR_ERRORS
from fringedic.sensors.registration import Registration
from fringedic.wording.numbers import counted, number_text
from fringedic.wording.sealed_yaml import EDITED_WORDS

_UM, _MM = 1e6, 1e3


def registration_in_words(registration: Registration) -> list[str]:
    """Return the verdict with its figures, the pose of every sensor, and the remarks."""
    return [_verdict(registration), *_poses(registration), *map(_finding, registration.findings)]


def _verdict(registration: Registration) -> str:
    objects = len({each.name for each in registration.residuals})
    largest = max(registration.residuals, key=lambda each: each.deviation)
    test = (
        f"chi square is {number_text(registration.reduced_chi_square, 3)} per degree of freedom, "
        f"{registration.freedom} of them"
        if registration.freedom
        else "nothing is left over to test them"
    )
    words = {
        RegistrationVerdict.GO: "The sensors agree within their uncertainty",
        RegistrationVerdict.WITH_CARE: "The sensors can be used together, but read the remarks",
        RegistrationVerdict.NO_GO: "The sensors cannot be used together",
    }[registration.verdict]
    return (
        f"{registration.verdict}. {words}: {counted(objects, 'object')} deviate by up to "
        f"{number_text(_UM * largest.deviation, 3)} µm ({test})."
    )


def _poses(registration: Registration) -> list[str]:
    found = []
    for name in registration.placed:
        pose, sigma = registration.poses[name], np.sqrt(np.diag(registration.pose_covariance(name)))
        place = ", ".join(number_text(_MM * each, 6) for each in pose.translation)
        turn = ", ".join(number_text(math.degrees(each), 5) for each in pose.rotation)
        found.append(
            f"{name}: at ({place}) mm in the frame of '{registration.reference}', turned by ({turn}) degree; standard "
            f"uncertainty {number_text(_UM * float(sigma[3:].max()), 2)} µm and "
            f"{number_text(math.degrees(float(sigma[:3].max())), 2)} degree."
        )
    return found


def _finding(finding: Finding) -> str:
    return _FINDINGS[finding.code](finding)


_FINDINGS: dict[str, Callable[[Finding], str]] = {
    RegistrationFinding.CONTRADICTION: lambda finding: (
        f"{finding.subject} contradicts the others most: it deviates by "
        f"{number_text(_UM * finding.values['deviation'], 3)} µm, {number_text(finding.values['sigmas'], 3)} standard "
        "deviations. Did the object move between the sensors, or did a sensor move since its calibration? Are two "
        "cameras or calibration files exchanged? Measure the object again, or calibrate that sensor again."
    ),
    RegistrationFinding.NOT_TESTED: lambda _: (
        "The objects determine the poses without anything left over: measure one more place of the object to test them."
    ),
    RegistrationFinding.UNCERTAIN: lambda finding: (
        f"{finding.subject} is placed with a standard uncertainty of "
        f"{number_text(_UM * finding.values['sigma'], 3)} µm: measure the object in more places, or a larger one."
    ),
}


def overlap_sentence(dataset: xr.Dataset) -> str:
    """Return how well the sensors agree where they overlap; empty for the dataset of one sensor."""
    names = [name for name in JOINED_MAPS if name.startswith("overlap_") and name in dataset]
    if names:  # the reference step differs by nothing from itself
        dataset = dataset.isel(step=dataset["step"].values != dataset["reference_step"].values)
    figures = []
    for name in names:
        values = dataset[name].values
        values = values[np.isfinite(values)]
        if values.size:
            figures.append(f"{name.removeprefix('overlap_')} {number_text(float(np.sqrt(np.mean(values**2))), 3)}")
    if not figures:
        return ""
    return (
        "Where two sensors overlap, their RMS difference in units of its standard deviation is: "
        f"{', '.join(figures)}. 1 is expected."
    )


def distances_in_words(distances: Sequence[DistanceAcross]) -> list[str]:
    """Return the verdict on a registration by a known distance, and each measured one."""
    worst = max(distances, key=lambda each: abs(each.score))
    holds = all(each.holds for each in distances)
    first = (
        f"The registration holds: {counted(len(distances), 'distance')} across sensors deviate from "
        f"{_MM * worst.expected:.4f} mm by at most {number_text(abs(worst.score), 2)} standard uncertainties."
        if holds
        else f"The registration does not hold: in step {worst.step} the distance between the balls of "
        f"'{worst.sensors[0]}' and '{worst.sensors[1]}' deviates by {number_text(_UM * worst.error, 3)} µm, "
        f"{number_text(abs(worst.score), 3)} standard uncertainties. Check the distance in the certificate; if it is "
        "right, register the sensors again."
    )
    return [
        first,
        *(
            f"step {each.step}, {each.sensors[0]} to {each.sensors[1]}: {_MM * each.distance:.4f} ± "
            f"{_MM * each.sigma:.4f} mm, error {number_text(_UM * each.error, 3)} µm"
            for each in distances
        ),
    ]


def registration_remarks(dataset: xr.Dataset) -> list[str]:
    """Return what a reader has to know of the registration that a joined dataset was made with."""
    registration = json.loads(dataset.attrs.get("registration", "{}"))
    found = []
    if registration.get("edited"):
        found.append(f"The registration of the sensors, of {registration['created'][:10]}, was {EDITED_WORDS}.")
    if registration.get("verdict") == RegistrationVerdict.NO_GO:
        found.append(
            "The sensors were joined although the verdict of their registration is NO-GO: positions and displacements "
            "of different sensors contradict each other."
        )
    return found


def joined_sentences(dataset: xr.Dataset) -> list[str]:
    """Return the sentences about a joined surface: its overlap, its registration and the parts that are missing."""
    found = [overlap_sentence(dataset), *registration_remarks(dataset), *sensor_error_sentences(dataset)]
    return list(filter(None, found))


def sensor_error_sentences(dataset: xr.Dataset) -> list[str]:
    """Return one sentence for each part of a step that a sensor did not measure."""
    errors = json.loads(dataset.attrs.get(SENSOR_ERRORS, "{}"))
    return [
        f"Step {step} was measured without the sensor '{sensor}': {reason}."
        for step, sensors in errors.items()
        for sensor, reason in sensors.items()
    ]
