from .distortion import BrownModel as BrownModel
from .distortion import DistortionMap as DistortionMap
from .grid import measure_distortion as measure_distortion
