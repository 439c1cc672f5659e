"""Topics that the coupling node subscribes to, relative to the namespace of the rig."""

INPUTS = (
    "calibration",
    "experiment/step",
    "camera/exposure",
    "phase/status",
    "phase/map",
    "phase/sigma",
    "phase/texture",
    "dic/status",
    "dic/displacement",
    "dic/sigma",
    "dic/camera_info",
)
