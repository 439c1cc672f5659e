from .model import RigModel as RigModel
from .six_parameter import SixParameterModel as SixParameterModel
