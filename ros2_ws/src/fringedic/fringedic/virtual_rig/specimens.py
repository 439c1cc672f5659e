"""Specimens of the virtual rig: the parameters of the compiled surface functions, in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fringedic.virtual_rig import tracing
from fringedic.virtual_rig.configuration import (
    CylinderSpecimen,
    LeatherSpecimen,
    PlacementConfiguration,
    PlateSpecimen,
    ReferencePlaneSpecimen,
    RigidSpecimen,
    SkinSpecimen,
    Specimen,
    SpheresSpecimen,
    StageConfiguration,
    TextureConfiguration,
    slope,
)
from fringedic.virtual_rig.optics import placement_matrices, rotation_x, rotation_y, rotation_z
from fringedic.virtual_rig.texture import furrow_strokes, stroke_field

_MM = 1e-3
_SHAPES = {"plane": tracing.PLANE, "sphere": tracing.SPHERE, "stepped": tracing.STEPPED, "balls": tracing.BALLS}


@dataclass(frozen=True)
class Surface:
    """A specimen in the form that the ray tracing needs.

    Attributes
    ----------
    kind, coefficients
        Which surface function, and its parameters.
    outline
        First and last X, first and last Y [m] of the specimen in material coordinates.
    relief
        Strokes of height [m] added to z.
    placed
        Whether the frame of the specimen is not that of the sensor.
    pose
        From the frame of the specimen to that of the sensor, see `tracing.DeformedSurface`.
    """

    kind: int
    coefficients: NDArray[np.float64]
    outline: NDArray[np.float64]
    relief: tracing.StrokeField
    placed: bool
    pose: NDArray[np.float64]

    def deformed(self, position: float) -> tracing.DeformedSurface:
        """Return the surface at a crosshead position [m]."""
        return tracing.DeformedSurface(self.kind, self.coefficients, position, self.placed, self.pose, *self.relief)


def make_surface(
    specimen: Specimen,
    stage: StageConfiguration,
    texture: TextureConfiguration,
    seed: int,
    placement: PlacementConfiguration,
) -> Surface:
    """Return the surface of a specimen; the relief of skin follows the furrows of its texture."""
    plate = stage if isinstance(specimen, ReferencePlaneSpecimen) else specimen
    half_width, half_height = plate.half_width_mm * _MM, plate.half_height_mm * _MM
    outline = np.array([-half_width, half_width, -half_height, half_height])
    strokes = np.empty((0, 6))
    match specimen:
        case RigidSpecimen():
            kind, coefficients = tracing.RIGID, _rigid(specimen)
        case PlateSpecimen():
            kind, coefficients = tracing.PLATE, _plate(specimen)
        case SkinSpecimen():
            kind, coefficients = tracing.SKIN, _skin(specimen)
            strokes = furrow_strokes(outline, 1e-6 * texture.feature_um, seed)
            strokes[:, 5] *= -1e-6 * specimen.relief_um
        case LeatherSpecimen():
            kind, coefficients = tracing.LEATHER, _leather(specimen)
        case CylinderSpecimen():
            kind, coefficients = tracing.CYLINDER, _cylinder(specimen)
        case SpheresSpecimen():
            centres = [each * _MM for centre in specimen.centres_mm for each in centre]
            kind, coefficients = tracing.SPHERES, [specimen.radius_mm * _MM, specimen.width_mm * _MM, *centres]
        case ReferencePlaneSpecimen():
            # A positive angle rotates the plate by -angle about its axis, before it is lifted.
            through = _MM * np.array([stage.axis_x_mm, 0.0, stage.axis_z_mm])
            yaw, pitch = math.radians(stage.axis_yaw_degree), math.radians(stage.axis_pitch_degree)
            axis = rotation_z(yaw) @ rotation_x(pitch)
            turned = axis @ rotation_y(-math.radians(specimen.angle_degree)) @ axis.T
            origin = through - turned @ through + [0.0, 0.0, specimen.height_mm * _MM]
            kind, coefficients = tracing.REFERENCE_PLANE, [*origin, *turned[:, 0], *turned[:, 1]]
    rotation, translation = placement_matrices(placement)
    pose = np.concatenate([rotation.T.ravel(), -rotation.T @ translation])
    return Surface(
        kind,
        np.array(coefficients, dtype=np.float64),
        outline,
        stroke_field(strokes, outline),
        not placement.is_identity,
        pose,
    )


def _rigid(s: RigidSpecimen) -> list[float]:
    height = s.height_mm * _MM
    match s.shape:
        case "plane":
            shape = [height, slope(s.angle_degree), slope(s.angle_y_degree), 0.0, 0.0]
        case "sphere":
            shape = [height, s.radius_mm * _MM, 0.0, 0.0, 0.0]
        case "balls":
            radius = s.radius_mm * _MM
            # the base plane cuts the balls where their slope is the steepest one
            shape = [height, radius, 0.5 * s.spacing_mm * _MM, radius * math.cos(math.radians(s.cap_degree)), 0.0]
        case "stepped":
            lengths = (s.step_mm, s.transition_mm, s.block_half_width_mm, s.step_y_mm)
            shape = [height, *(length * _MM for length in lengths)]
    rotation = [math.radians(rate) / _MM for rate in s.rotation_degree_per_mm]
    return [_SHAPES[s.shape], *shape, *s.translation, *rotation]


def _plate(s: PlateSpecimen) -> list[float]:
    return [
        s.gauge_length_mm * _MM,
        s.poisson,
        s.bow_mm * _MM,
        s.straightening_mm * _MM,
        slope(s.angle_degree),
        slope(s.angle_y_degree),
        s.twist_per_mm / _MM,
    ]


def _cylinder(s: CylinderSpecimen) -> list[float]:
    twist = math.radians(s.twist_degree_per_mm) / _MM / (s.gauge_length_mm * _MM)
    return [s.radius_mm * _MM, s.gauge_length_mm * _MM, s.poisson, twist, s.bulge]


def _skin(s: SkinSpecimen) -> list[float]:
    # Pulling at an angle to the stiff direction shears the strain band, symmetrically about 0 and 90 degrees.
    angle = math.radians(2.0 * s.device_angle_degree)
    return [
        s.radius_x_mm * _MM,
        s.radius_y_mm * _MM,
        s.band_mm * _MM,
        s.pad_reach_mm * _MM,
        s.poisson * (1.0 - s.anisotropy * math.cos(angle)),
        s.anisotropy * math.sin(angle),
        0.5 * s.anisotropy * math.sin(angle),
        s.dip,
    ]


def _leather(s: LeatherSpecimen) -> list[float]:
    along = math.radians(s.fold_direction_degree)
    return [
        s.fold_mm * _MM,
        s.fold_width_mm * _MM,
        math.sin(along),
        -math.cos(along),
        s.fold_x_mm * _MM,
        s.fold_y_mm * _MM,
        s.screw_x_mm * _MM,
        s.screw_y_mm * _MM,
        s.growth_mm * _MM,
        s.flattening_mm * _MM,
        math.radians(s.rotation_degree_per_mm) / _MM,
        s.stretch_per_mm / _MM,
        s.curvature_per_m,
        s.lift_per_m_per_mm / _MM,
    ]
