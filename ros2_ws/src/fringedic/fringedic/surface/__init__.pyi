from .coupling import couple as couple
from .flat import flat_strain as flat_strain
from .local_frame import to_local_frame as to_local_frame
from .prepared import PreparedShape as PreparedShape
from .specimen_frames import CylinderFrame as CylinderFrame
from .specimen_frames import SpecimenFrame as SpecimenFrame
from .strain import surface_strain as surface_strain
