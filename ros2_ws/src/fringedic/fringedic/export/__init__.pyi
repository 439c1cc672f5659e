from .meshes import write_mesh as write_mesh
from .writing import FORMATS as FORMATS
from .writing import Exported as Exported
from .writing import export_dataset as export_dataset
