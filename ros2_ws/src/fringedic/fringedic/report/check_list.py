"""Sentences of the check list for setting up a rig."""

from __future__ import annotations

from fringedic.rig_setup.check_list import ItemState, ListedItem, SetupItem

TITLES = {
    SetupItem.AXES: "Aim camera and projector",
    SetupItem.CAMERA_FOCUS: "Focus and exposure of the camera",
    SetupItem.PROJECTOR_FOCUS: "Focus of the projector",
    SetupItem.TIMING: "Timing of the projector",
    SetupItem.RESPONSE: "Response curve",
    SetupItem.CALIBRATE: "Calibration",
    SetupItem.CHECK: "Check of the calibration",
    SetupItem.REGION: "Region to be measured",
    SetupItem.NOISE: "Noise floor",
    SetupItem.ADVISE: "Recommended settings",
}
_FIRST = {
    SetupItem.AXES: "Show the crosshair, and turn camera and projector until both axes meet on the specimen.",
    SetupItem.CAMERA_FOCUS: "Show white light, turn the focus ring to the best focus, and set the exposure without "
    "saturated pixels.",
    SetupItem.PROJECTOR_FOCUS: "Show the focus lines, and turn the lens of the projector to the best focus.",
    SetupItem.TIMING: "Measure the delay of the projector, and use the recommended exposure and settle time.",
    SetupItem.RESPONSE: "Measure the response of the projector to grey levels, and use its curve.",
    SetupItem.CALIBRATE: "Print the grid, lay it on the reference plane, start, and follow the instructions.",
    SetupItem.CHECK: "Measure the reference plane and a gauge block, to see that the calibration is valid.",
    SetupItem.REGION: "Mount the specimen, and draw the part of the image that is to be measured.",
    SetupItem.NOISE: "Measure steps with the specimen at rest, before the test.",
    SetupItem.ADVISE: "Take three images at rest, and use the recommended window.",
}


def next_sentence(item: ListedItem) -> str:
    """Return what to do next about an item."""
    if item.state is ItemState.NOT_DONE:
        return _FIRST[item.item]
    if item.state is ItemState.DONE:
        return "Nothing to do."
    if item.state is ItemState.FAILED:
        return "The calibration did not pass it: calibrate again, and then repeat it."
    later = " and ".join(TITLES[each].lower() for each in item.superseded_by)
    return f"Repeat it, because {later} was done later."
