"""Calibration of the rig by a plane at known angles or heights (3.2), and the check that it still holds."""

from fringedic.calibration.calibrate import calibrate_rig
from fringedic.calibration.check import RigCheck, check_rig
from fringedic.calibration.result import RigCalibration

__all__ = ["RigCalibration", "RigCheck", "calibrate_rig", "check_rig"]
