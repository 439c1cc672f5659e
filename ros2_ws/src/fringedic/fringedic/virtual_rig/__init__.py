"""Digital twin of a rig: it renders what camera and projector would see, and knows the truth.

It imports nothing from the measuring modules: matrices and ray tracing are its own.
"""

from fringedic.virtual_rig.configuration import VirtualRigConfiguration, preset
from fringedic.virtual_rig.load_frame import LoadMode, LoadSample, SimulatedLoadFrame
from fringedic.virtual_rig.projector_timing import pattern_weights
from fringedic.virtual_rig.rig import VirtualRig

__all__ = [
    "LoadMode",
    "LoadSample",
    "SimulatedLoadFrame",
    "VirtualRig",
    "VirtualRigConfiguration",
    "pattern_weights",
    "preset",
]
