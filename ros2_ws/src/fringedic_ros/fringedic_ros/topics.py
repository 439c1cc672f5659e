"""Topics of a rig that a recording contains, by their names relative to the namespace of the rig."""

from __future__ import annotations

STEP = "experiment/step"
PROGRAMME = "programme/status"
REFERENCE = "experiment/reference"
PLANE = "experiment/plane"
CALIBRATION = "calibration"
NODE_PARAMETERS = "node_parameters"
IMAGE = "camera/image_raw"
EXPOSURE = "camera/exposure"
LOAD_STATE = "load_frame/state"

SAMPLE_TOPICS = (LOAD_STATE, "load_frame/wrench", "load_frame/joint_states")

# All inputs of the results: a test can be evaluated again from these topics alone.
RAW_TOPICS = (
    IMAGE,
    "camera/camera_info",
    EXPOSURE,
    "camera/clock",
    STEP,
    PROGRAMME,
    REFERENCE,
    PLANE,
    CALIBRATION,
    NODE_PARAMETERS,
    *SAMPLE_TOPICS,
    "signals",
    "load_frame/clock",
    "extensometer/strain",
    "extensometer/sigma",
    "extensometer/valid",
    "/tf_static",
)

# Results of the processing nodes.
DERIVED_TOPICS = (
    "phase/map",
    "phase/sigma",
    "phase/modulation",
    "phase/texture",
    "phase/status",
    "dic/displacement",
    "dic/sigma",
    "dic/camera_info",
    "dic/preview",
    "dic/status",
    "coupling/shape",
    "coupling/displacement",
    "coupling/status",
)

# Topics of each processing node: those that it publishes, and those that it subscribes to.
PUBLISHED = {
    name: tuple(topic for topic in DERIVED_TOPICS if topic.startswith(f"{name}/"))
    for name in ("phase", "dic", "coupling")
}
PROCESSING_INPUTS = {
    "phase": (STEP, IMAGE, EXPOSURE),
    "dic": (REFERENCE, STEP, "phase/status", "phase/texture", IMAGE, EXPOSURE),
    "coupling": (
        CALIBRATION,
        STEP,
        EXPOSURE,
        "phase/status",
        "phase/map",
        "phase/sigma",
        "phase/texture",
        "dic/status",
        "dic/displacement",
        "dic/sigma",
        "dic/camera_info",
    ),
}

# Nodes that must not miss a message of the processing nodes.
READERS = (*PUBLISHED, "recorder", "experiment", "player")
# Nodes that may miss messages. Their subscriptions count, so that none of them is taken for one of the readers.
WATCHERS = ("operator",)
