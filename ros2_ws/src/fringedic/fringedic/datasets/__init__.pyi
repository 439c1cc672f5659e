from .opening import find_dataset as find_dataset
from .opening import open_experiment as open_experiment
from .processing import dataset_from_derived as dataset_from_derived
from .processing import process_bag as process_bag
from .quantities import MAPS as MAPS
from .quantities import SCALARS as SCALARS
from .quantities import Quantity as Quantity
