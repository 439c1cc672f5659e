"""Codes of everything that a calibration or a check of the rig can remark."""

from __future__ import annotations

from enum import IntEnum, StrEnum


class ImageProblem(StrEnum):
    """Why an image contradicts the others, with the values of each."""

    WRONG_ORDER = "wrong_order"  # orders
    PARTLY_WRONG_ORDER = "partly_wrong_order"  # share
    MOVED_OR_FLICKER = "moved_or_flicker"  # ripple [rad]
    OTHER_ANGLE = "other_angle"  # angle, stated [rad]
    OTHER_HEIGHT = "other_height"  # lift [m]
    OTHER_PLACE = "other_place"  # angle, stated [rad], lift [m]
    NOT_THIS_PLANE = "not_this_plane"
    TEXT = "problem_in_words"  # of a file of an older version; the subject is the sentence


class CalibrationWarning(StrEnum):
    """Warnings of a calibration, with the values of each."""

    OUTLIERS = "outliers"  # share
    RIPPLE = "ripple"  # amplitude [rad]
    COMMON_RIPPLE = "common_ripple"  # harmonic, amplitude [rad]
    NARROW_ANGLES = "narrow_angles"  # span [rad]
    TILT_UNKNOWN = "tilt_unknown"
    TILT_FROM_ONE_PLANE = "tilt_from_one_plane"
    FEW_PLANES = "few_planes"  # count
    NOT_TESTED = "not_tested"
    UNCERTAIN_HEIGHT = "uncertain_height"  # sigma [m], action, reduced [m]; before version 0.3 sigma alone
    NOT_CONVERGED = "not_converged"
    UNEXPLAINED = "unexplained"  # blocks (so many count as one), sigma (of u or v, over a motion along z)
    UNCERTAIN_MOTION = "uncertain_motion"  # sigma (of u or v, over a motion along z), action, reduced (sigma after it)
    DRIFT = "drift"  # change, noise [m]
    DRIFT_UNKNOWN = "drift_unknown"
    TEXT = "warning_in_words"  # of a file of an older version; the subject is the sentence


class Action(IntEnum):
    """What can be measured in addition to a calibration."""

    GRIDS = 0  # the grid on the plane at angle 0 and tilted to both sides
    ANGLES = 1  # planes at angles twice as large
    PLANES = 2  # twice as many planes


class CheckProblem(StrEnum):
    """Why a rig does not hold its calibration."""

    BENT = "plate_bent"  # the flat plate comes out bent
    SCALE = "wrong_scale"  # the known distance comes out wrong


class CheckWarning(StrEnum):
    """Warnings of a check of the rig."""

    OLD = "check_old"
    DRIFT = "check_drift"
    SCALE_NOT_CHECKED = "scale_not_checked"
