"""Topics that the phase node subscribes to, relative to the namespace of the rig."""

INPUTS = ("experiment/step", "camera/image_raw", "camera/exposure")
