"""Which topics of a rig a recording holds, by their names relative to the rig's namespace."""

from __future__ import annotations

STEP = "experiment/step"
REFERENCE = "experiment/reference"
PLANE = "experiment/plane"
CALIBRATION = "calibration"
NODE_PARAMETERS = "node_parameters"
IMAGE = "camera/image_raw"
EXPOSURE = "camera/exposure"

SAMPLE_TOPICS = ("load_frame/state", "load_frame/wrench", "load_frame/joint_states")

# Everything that the results follow from. Without these a test cannot be evaluated again.
RAW_TOPICS = (
    IMAGE,
    "camera/camera_info",
    EXPOSURE,
    "camera/clock",
    STEP,
    REFERENCE,
    PLANE,
    CALIBRATION,
    NODE_PARAMETERS,
    *SAMPLE_TOPICS,
    "load_frame/clock",
    "extensometer/strain",
    "extensometer/sigma",
    "extensometer/valid",
    "/tf_static",
)

# What the processing nodes compute from them.
DERIVED_TOPICS = (
    "phase/map",
    "phase/sigma",
    "phase/modulation",
    "phase/texture",
    "phase/status",
    "dic/displacement",
    "dic/sigma",
    "dic/camera_info",
    "dic/status",
    "coupling/shape",
    "coupling/displacement",
    "coupling/status",
)

# Which of them each processing node publishes, and who must not miss any.
PUBLISHED = {
    name: tuple(topic for topic in DERIVED_TOPICS if topic.startswith(f"{name}/"))
    for name in ("phase", "dic", "coupling")
}
READERS = (*PUBLISHED, "recorder", "experiment", "player")

# What each processing node listens to: a replay begins when all of these have found each other.
PROCESSING_INPUTS = {
    "phase": (IMAGE, EXPOSURE, STEP),
    "dic": (IMAGE, EXPOSURE, STEP, REFERENCE, "phase/texture", "phase/status"),
    "coupling": (
        STEP,
        REFERENCE,
        CALIBRATION,
        "phase/map",
        "phase/sigma",
        "phase/status",
        "dic/displacement",
        "dic/sigma",
        "dic/status",
    ),
}
