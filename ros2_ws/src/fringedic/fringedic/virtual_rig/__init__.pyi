from .configuration import VirtualRigConfiguration as VirtualRigConfiguration
from .configuration import preset as preset
from .fringe_scene import FringeScene as FringeScene
from .load_frame import CrossheadState as CrossheadState
from .load_frame import LoadSample as LoadSample
from .load_frame import SimulatedLoadFrame as SimulatedLoadFrame
from .projector_timing import pattern_weights as pattern_weights
from .rig import VirtualRig as VirtualRig
