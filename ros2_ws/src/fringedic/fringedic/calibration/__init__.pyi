from .calibrate import calibrate_rig as calibrate_rig
from .check import CheckVerdict as CheckVerdict
from .check import RigCheck as RigCheck
from .check import check_rig as check_rig
from .fit_results import Verdict as Verdict
from .result import RigCalibration as RigCalibration
from .session import CalibrationSession as CalibrationSession
