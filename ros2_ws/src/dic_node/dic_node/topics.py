"""Topics that the dic node subscribes to, relative to the namespace of the rig."""

INPUTS = (
    "experiment/reference",
    "experiment/step",
    "phase/status",
    "phase/texture",
    "camera/image_raw",
    "camera/exposure",
)
