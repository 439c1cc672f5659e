__version__: str

from .accessor import ExperimentAccessor as ExperimentAccessor
from .calibration import RigCalibration as RigCalibration
from .calibration import RigCheck as RigCheck
from .calibration import calibrate_rig as calibrate_rig
from .calibration import check_rig as check_rig
from .camera import DistortionMap as DistortionMap
from .camera import measure_distortion as measure_distortion
from .campaign import open_campaign as open_campaign
from .configuration import load_programme as load_programme
from .configuration import load_rig_file as load_rig_file
from .correlation import Reference as Reference
from .correlation import accumulate as accumulate
from .correlation import measure_displacement as measure_displacement
from .datasets import open_experiment as open_experiment
from .datasets import process_bag as process_bag
from .errors import FringedicError as FringedicError
from .evaluation import compare_experiments as compare_experiments
from .frames.region import Region as Region
from .images import measure_images as measure_images
from .models import compare_model as compare_model
from .models import compare_shape as compare_shape
from .models import read_model as read_model
from .patterns import ResponseCurve as ResponseCurve
from .patterns import fringe_sequence as fringe_sequence
from .patterns import gray_code_sequence as gray_code_sequence
from .patterns import one_image_sequence as one_image_sequence
from .phase import ImageMotion as ImageMotion
from .phase import absolute_phase as absolute_phase
from .phase import demodulate as demodulate
from .phase import demodulate_moving as demodulate_moving
from .phase import unwrap_hierarchical as unwrap_hierarchical
from .phase import unwrap_spatial as unwrap_spatial
from .report import write_report as write_report
from .rig import RigModel as RigModel
from .rig_setup.advice import Advice as Advice
from .rig_setup.recommended_settings import advise_settings as advise_settings
from .rig_setup.response import measure_response as measure_response
from .surface import CylinderFrame as CylinderFrame
from .surface import PreparedShape as PreparedShape
from .surface import SpecimenFrame as SpecimenFrame
from .surface import couple as couple
from .surface import surface_strain as surface_strain
from .surface import to_local_frame as to_local_frame

def replacement_of(folder: str) -> str | None: ...
