"""Messages of recordings that an earlier version made, in the form of the present one.

This is the only place that reads fields which a definition no longer has, and that looks into recorded sentences.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from math import nan
from types import SimpleNamespace
from typing import Any

from fringedic.frames.sensor import SENSOR

_OF_A_SENSOR = {f"fringedic_msgs/msg/{name}" for name in ("Exposure", "NodeStatus", "RigCalibration")}
_LENS_BLUR = re.compile(r"lens blur (\S+) px")
_RMS = {"phase": "phase_sigma", "dic": "rms_displacement_px", "coupling": "rms_displacement"}


def translate(type_name: str, message: Any) -> None:
    """Give a decoded message the fields that a definition of an earlier version lacks.

    Parameters
    ----------
    type_name
        ``fringedic_msgs/msg/NodeStatus``.
    message
        The message; it is changed.
    """
    if type_name in _OF_A_SENSOR and not hasattr(message, "sensor"):
        message.sensor = SENSOR
    if type_name in _TRANSLATIONS:
        _TRANSLATIONS[type_name](message)


def _translate_exposure(message: Any) -> None:
    if not hasattr(message, "image_crc"):
        message.image_crc = 0


def _translate_load(message: Any) -> None:
    if not hasattr(message, "reason"):
        message.reason = ""


def _translate_reference(message: Any) -> None:
    """State that it is not known whether it took the place of a lost one: the starts of the nodes decide."""
    if not hasattr(message, "previous_lost"):
        message.previous_lost = None


def _translate_step(message: Any) -> None:
    """Take the name of the step off the reason of its failure, which named it although the message does."""
    named = f"experiment '{message.experiment}', step {message.step}: "
    message.error_message = message.error_message.removeprefix(named)


def _translate_status(message: Any) -> None:
    if hasattr(message, "remarks"):
        return
    named = f"experiment '{message.experiment}', step {message.step}: "
    message.error_message = message.error_message.removeprefix(named)
    for name in ("reference_step", "window"):
        if not hasattr(message, name):
            setattr(message, name, 0)
    if not hasattr(message, "correlated_step"):
        message.correlated_step = None
    for name in ("relative", "method"):
        if not hasattr(message, name):
            setattr(message, name, "" if name == "method" else False)
    message.skipped = not message.error_code and message.valid_fraction != message.valid_fraction
    message.remarks, message.corrections = [], []
    if not message.error_code and message.error_message:  # contained the remarks on a valid result
        message.remarks = [SimpleNamespace(code="", sentence=message.error_message, names=[], values=[])]
        message.error_message = ""
    if message.node == "phase":  # the method contained the corrections of the phase
        message.corrections = [_correction(text) for text in message.method.split(", ") if text]
        message.method = ""
    for node, name in _RMS.items():
        setattr(message, name, message.rms if message.node == node else nan)


def _correction(text: str) -> Any:
    blur = _LENS_BLUR.fullmatch(text)
    if blur:
        return SimpleNamespace(kind="lens_blur", size=float(blur[1]))
    return SimpleNamespace(kind=text, size=0.0)


_TRANSLATIONS: dict[str, Callable[[Any], None]] = {
    "fringedic_msgs/msg/Exposure": _translate_exposure,
    "fringedic_msgs/msg/LoadState": _translate_load,
    "fringedic_msgs/msg/NodeStatus": _translate_status,
    "fringedic_msgs/msg/Reference": _translate_reference,
    "fringedic_msgs/msg/StepStatus": _translate_step,
}
