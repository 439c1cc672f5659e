"""The calibration that a check of a rig examines."""

from __future__ import annotations

from pathlib import Path

from fringedic.configuration.rig_file import RigFile, fitting_calibration
from fringedic.errors import ConfigurationError
from fringedic.rig.model import RigModel


def calibration_to_check(rig: RigFile, rig_path: Path) -> RigModel:
    """Return the calibration of a rig with a projector.

    Raises
    ------
    ConfigurationError
        The rig has no projector, or no calibration that fits it.
    """
    model = fitting_calibration(rig, rig_path)
    if model is None or rig.projector is None:
        raise ConfigurationError(
            f"{rig_path}: has no {'calibration' if rig.projector else 'projector'}, so there is nothing to check"
        )
    return model
