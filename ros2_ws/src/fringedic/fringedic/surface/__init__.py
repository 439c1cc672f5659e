"""Material points of a surface: 3D displacement (eq. 12), its components along the surface, and the surface's strain.

The shape is known at every pixel of each step, the in-plane displacement tells which pixel a material point has moved
to. All lengths are in metre in the rig frame; NaN is "not measured".
"""

from fringedic.surface.coupling import couple
from fringedic.surface.frames import CylinderFrame, SpecimenFrame
from fringedic.surface.local import to_local_frame
from fringedic.surface.prepared import PreparedShape
from fringedic.surface.strain import surface_strain

__all__ = [
    "CylinderFrame",
    "PreparedShape",
    "SpecimenFrame",
    "couple",
    "surface_strain",
    "to_local_frame",
]
