from .agreement import Agreement as Agreement
from .comparison import compare_model as compare_model
from .model import Model as Model
from .model import read_model as read_model
from .placement import FreeDirections as FreeDirections
from .placement import Placement as Placement
from .placement import PointPair as PointPair
from .placement import place_model as place_model
