"""The models of the rig that a calibration compares."""

from __future__ import annotations

from enum import StrEnum

from fringedic.rig.geometry import GENERAL, SIX_PARAMETER


class ModelVariant(StrEnum):
    """A model of the rig, from few to many parameters."""

    SIX_PARAMETER = SIX_PARAMETER
    GENERAL = GENERAL
    GENERAL_K1 = f"{GENERAL} + k1"  # with the projector's radial distortion
    GENERAL_K1_Y = f"{GENERAL} + k1 + y"  # and the projector's position along the fringes, which shifts its centre
    GENERAL_BROWN = f"{GENERAL} + k1 k2 p1 p2 k3"  # with Brown's five coefficients

    @property
    def family(self) -> str:
        """Name of the model in files: "six_parameter" or "general"."""
        return SIX_PARAMETER if self is ModelVariant.SIX_PARAMETER else GENERAL

    @property
    def has_k1(self) -> bool:
        """Whether the projector's radial distortion is fitted."""
        return self in (ModelVariant.GENERAL_K1, ModelVariant.GENERAL_K1_Y, ModelVariant.GENERAL_BROWN)

    @property
    def has_centre(self) -> bool:
        """Whether the centre of this distortion is fitted."""
        return self is ModelVariant.GENERAL_K1_Y

    @property
    def has_five(self) -> bool:
        """Whether all five coefficients of the distortion are fitted."""
        return self is ModelVariant.GENERAL_BROWN
