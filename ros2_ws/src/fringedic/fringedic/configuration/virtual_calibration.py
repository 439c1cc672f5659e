"""Exact parameters of a virtual rig as a calibration."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

from fringedic.camera import DistortionMap
from fringedic.configuration.sections import VIRTUAL_RIG
from fringedic.rig.model import RigModel
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration
from fringedic.virtual_rig.configuration import LensConfiguration, ReferencePlaneSpecimen
from fringedic.virtual_rig.optics import camera_optics, projector_optics

LENS_ORDER = 20  # of the polynomials that replace the lens of a virtual rig; their error is below 2e-6 px
LENS_POINTS = 60


def calibration_of(virtual_rig: VirtualRigConfiguration) -> RigModel:
    """Return the exact parameters of a virtual rig as a calibration."""
    optics: dict[str, Any] = {**camera_optics(virtual_rig.camera), **projector_optics(virtual_rig.projector)}
    return RigModel(
        **optics, camera_distortion=_distortion_of(virtual_rig), identifier="virtual rig", source=VIRTUAL_RIG
    )


def _distortion_of(virtual_rig: VirtualRigConfiguration) -> DistortionMap | None:
    """Return the distortion of the lens of a virtual rig as polynomials; None without distortion."""
    camera = virtual_rig.camera
    if camera.lens == LensConfiguration():
        return None
    # the plain plane as specimen needs no texture
    bare = VirtualRig(virtual_rig.model_copy(update={"specimen": ReferencePlaneSpecimen()}))
    rows, columns = (np.unique(np.linspace(0, n - 1, LENS_POINTS).astype(int)) for n in (camera.rows, camera.columns))
    fits = [
        np.linalg.pinv(chebyshev.chebvander(2 * places / (n - 1) - 1, LENS_ORDER))
        for places, n in ((rows, camera.rows), (columns, camera.columns))
    ]
    straight_column, straight_row = (each[np.ix_(rows, columns)] for each in bare.straight_pixels())
    shifts = straight_column - columns, straight_row - rows[:, np.newaxis]
    return DistortionMap(camera.columns, camera.rows, *(fits[0] @ shift @ fits[1].T for shift in shifts))
