"""Artefacts of an acceptance test before a virtual rig: their rendered and reconstructed surfaces."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import xarray as xr

from fringedic.calibration.acceptance import Artefact, Artefacts, Place
from fringedic.patterns.pattern import ProjectedPattern
from fringedic.patterns.render import render_pattern
from fringedic.phase import measure_phase
from fringedic.rig.model import RigModel
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

_TRAVEL = 1e-3  # [m]: the crosshead brings the artefact from the origin to its place
_CAP_DEGREE = 70.0  # the balls end at this angle from their tops


def measure_virtual_artefact(
    virtual: VirtualRigConfiguration,
    patterns: Sequence[ProjectedPattern],
    model: RigModel,
    place: Place,
    artefacts: Artefacts,
) -> xr.Dataset:
    """Return the surface of an artefact at a place, from rendered frames of the virtual rig.

    Parameters
    ----------
    virtual
        The virtual rig; the artefact replaces its specimen.
    patterns
        Of one step.
    model
        Calibration of the rig.
    place, artefacts
        What is placed where.
    """
    radius = 0.5e3 * artefacts.diameter
    is_plane, is_bar = place.artefact is Artefact.PLANE, place.artefact is Artefact.BALL_BAR
    spacing = 1e3 * artefacts.spacing if is_bar else 0.0
    width, height = (1e3 * each for each in artefacts.volume[:2])
    specimen = {
        "kind": "rigid",
        "shape": "plane" if is_plane else "balls",
        "half_width_mm": 0.5 * width if is_plane else 0.5 * spacing + 1.1 * radius,
        "half_height_mm": 0.5 * height if is_plane else 1.1 * radius,
        # the centres of the balls are at the origin before the rotation
        "height_mm": 0.0 if is_plane else radius * math.cos(math.radians(_CAP_DEGREE)),
        "radius_mm": radius,
        "spacing_mm": spacing,
        "cap_degree": _CAP_DEGREE,
        "translation": tuple(each / _TRAVEL for each in place.centre),
        "rotation_degree_per_mm": tuple(math.degrees(each) for each in place.rotation),
    }
    entries = virtual.model_dump() | {
        "specimen": specimen,
        "texture": {"kind": "speckle", "feature_um": virtual.texture.feature_um, "coverage": 0.01, "floor": 0.95},
        "load_frame": {"maximum_position_mm": 1e3 * _TRAVEL},
    }
    twin = VirtualRig(VirtualRigConfiguration.from_dict(entries))
    height, width = twin.projector_shape
    frames = np.array(
        [twin.expose(render_pattern(each, width, height), _TRAVEL, number) for number, each in enumerate(patterns)]
    )
    phase, _ = measure_phase(frames, patterns)
    finest = patterns[-1]
    return model.reconstruct(phase.phase, finest.pitch, phase.sigma, finest.orientation)
