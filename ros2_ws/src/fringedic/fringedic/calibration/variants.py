"""The models of the rig that a calibration compares."""

from __future__ import annotations

from enum import StrEnum

from fringedic.rig.geometry import GENERAL, SIX_PARAMETER


class ModelVariant(StrEnum):
    """A model of the rig."""

    SIX_PARAMETER = SIX_PARAMETER
    GENERAL = GENERAL  # free direction of the projector, distortion of its lens with a free centre, free rotation axis

    @classmethod
    def _missing_(cls, value: object) -> ModelVariant | None:
        """Return the general model for its parts in files before version 0.3, such as "general + k1"."""
        return cls.GENERAL if str(value).startswith(f"{GENERAL} + ") else None
