"""Plan of a rig: predicted uncertainties, their sources, what would reduce them, geometry and warnings.

Nothing is measured. `planned_patch` predicts the uncertainties on patches of the surface; here they are averaged over
the field of view, divided into their sources, and predicted again for rigs with one change.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import groupby

import numpy as np
import xarray as xr

from fringedic.correlation.transfer import shortest_period
from fringedic.errors import RigSetupError
from fringedic.patterns.pattern import Orientation, PatternKind
from fringedic.phase.noise import phase_deviation
from fringedic.planning.plan_warnings import PlanWarning, find_warnings, steepest_light
from fringedic.planning.planned_patch import QUANTITIES, NoiseFactors, Patch, PatchUncertainty, patch_width
from fringedic.planning.planned_rig import PlannedRig

_GAUSS = np.polynomial.legendre.leggauss(3)  # exact for a variance that grows with the square of the distance
ANGLES = tuple(math.radians(each) for each in range(5, 61, 5))
_ANGLE_STEP = math.radians(10.0)
_WIDEST_ANGLE = math.radians(60.0)
_INSENSITIVE = 0.01  # noise of z with the other direction of the fringes over that of the plan
_NEARLY = 1.1  # times the smallest noise of z is near enough: a smaller angle gives fewer shadows
_FINEST_PITCH = 4.0  # [projector px], the finest that the change of the pitch proposes


class NoiseSource(Enum):
    """Where an uncertainty comes from, with the field of `NoiseFactors`."""

    PHASE_PHOTON = "phase_photon"
    PHASE_READ = "phase_read"
    TEXTURE_PHOTON = "texture_photon"
    TEXTURE_READ = "texture_read"


class PlanChange(Enum):
    """One change of a planned rig."""

    TWICE_THE_FRAMES = "twice the frames"
    TWICE_THE_FULL_WELL = "twice the full well"
    HALF_THE_READ_NOISE = "half the read noise"
    FINER_PITCH = "finest pitch x 0.7"
    WIDER_ANGLE = "angle + 10 degree"
    WIDER_WINDOW = "displacement window x 1.5"
    WIDER_FILTER = "filter of z x 2"
    WIDER_STRAIN_WINDOW = "strain window x 1.5"


@dataclass(frozen=True, eq=False)
class Plan:
    """Prediction for a planned rig; `fringedic.planning.sentences` writes it as text.

    Attributes
    ----------
    planned
        The rig.
    centre, field
        Uncertainties in the middle of the image, and root mean square over the image.
    shares
        Part of the variance by quantity and source, at the centre; they sum to 1.
    changes
        Uncertainty over that of the plan, at the centre, for each possible change and each quantity.
    directions
        Noise of z relative to that of the plan, by direction of the fringes.
    angles
        (angle [rad], noise of z relative to that of the plan).
    angle, recommended_angle
        Between camera and projector [rad], as planned, and the smallest one with a noise of z within 10 % of the best
        that the slopes allow.
    resolution
        Shortest period of a displacement wave that keeps 90 % of its amplitude [px].
    warnings
        What to look at before buying.
    """

    planned: PlannedRig
    centre: PatchUncertainty
    field: PatchUncertainty
    shares: dict[str, dict[NoiseSource, float]]
    changes: dict[PlanChange, dict[str, float]]
    directions: dict[Orientation, float]
    angles: tuple[tuple[float, float], ...]
    angle: float
    recommended_angle: float
    resolution: float
    warnings: tuple[PlanWarning, ...]

    def dominant(self, quantity: str) -> tuple[NoiseSource, float]:
        """Return the largest source of a quantity and its share of the variance."""
        return max(self.shares[quantity].items(), key=lambda item: item[1])

    def best_change(self, quantity: str) -> tuple[PlanChange, float]:
        """Return the change that reduces a quantity most, and the factor."""
        factors = {change: each[quantity] for change, each in self.changes.items()}
        return min(factors.items(), key=lambda item: item[1])

    @property
    def recommended_orientation(self) -> Orientation:
        """Direction of the fringes with the smaller noise of z."""
        return min(self.directions, key=self.directions.__getitem__)


def make_plan(planned: PlannedRig) -> Plan:
    """Predict the uncertainties of a planned rig.

    The predictions contain the noise of the camera through phase, in-plane displacement, coupling and strain. They do
    not contain the calibration (its report states it), the light that changes with a turning surface, vibration, or the
    attenuation of waves shorter than the resolution.

    Parameters
    ----------
    planned
        The rig, from `PlannedRig.of`.

    Raises
    ------
    RigSetupError
        The fringes hardly move with the height of the surface.

    Examples
    --------
    >>> from fringedic.configuration.rig_file import RigFile
    >>> from fringedic.planning import PlannedRig
    >>> virtual = {"preset": "plate", "size": "small"}
    >>> rig = {"camera": {"source": "virtual"}, "projector": {"source": "virtual"}, "virtual_rig": virtual}
    >>> plan = make_plan(PlannedRig.of(RigFile.model_validate(rig)))
    >>> bool(10e-6 < plan.centre.sigma["z"] < 1e-3), plan.recommended_orientation.name
    (True, 'VERTICAL')
    """
    own = plane_noise(planned)
    directions = {each: plane_noise(_with_orientation(planned, each)) / own for each in Orientation}
    if not directions[Orientation(1 - planned.orientation)] > _INSENSITIVE:  # NaN when the plan's own is infinite
        shown, better = (each.name.lower() for each in (planned.orientation, Orientation(1 - planned.orientation)))
        raise RigSetupError(
            f"{shown} fringes hardly move with the height of the surface, because the projector stands along them; set "
            f"sequence.orientation to {better}"
        )
    patch = _centre_patch(planned)
    centre = patch.uncertainty()
    angles = tuple((each, plane_noise(_at_angle(planned, each)) / own) for each in ANGLES)
    field = field_uncertainty(planned)
    # The variances are linear in those of the sources.
    doubled = {each: patch.uncertainty(NoiseFactors(**{each.value: 2.0})).sigma for each in NoiseSource}
    shares = {}
    for name in QUANTITIES:
        added = {each: max(doubled[each][name] ** 2 - centre.sigma[name] ** 2, 0.0) for each in NoiseSource}
        total = sum(added.values())
        shares[name] = {each: value / total if total else math.nan for each, value in added.items()}
    factors = {}
    for change, apply in _APPLY.items():
        changed = apply(planned)
        if changed is not None:
            sigma = _centre_patch(changed).uncertainty().sigma
            factors[change] = {name: sigma[name] / centre.sigma[name] for name in QUANTITIES}
    return Plan(
        planned=planned,
        centre=centre,
        field=field,
        shares=shares,
        changes=factors,
        directions=directions,
        angles=angles,
        angle=planned.angle,
        recommended_angle=recommend_angle(planned),
        resolution=shortest_period(planned.dic.window, planned.dic.method),
        warnings=tuple(find_warnings(planned, field)),
    )


def recommend_angle(planned: PlannedRig) -> float:
    """Return the smallest angle of the projector [rad] whose noise of z is within 10 % of the best.

    Angles at which the steepest slope would get no light are left out; the projector stays at its distance.
    """
    limit = steepest_light(planned)
    allowed = [each for each in ANGLES if each <= limit] or [ANGLES[0]]
    noise = [plane_noise(_at_angle(planned, each)) for each in allowed]
    return next(angle for angle, each in zip(allowed, noise, strict=True) if each <= _NEARLY * min(noise))


def field_uncertainty(planned: PlannedRig, margin: float = 0.0) -> PatchUncertainty:
    """Return the root mean square uncertainties over the image (Gauss-Legendre quadrature on 3 x 3 patches).

    Parameters
    ----------
    planned
        The rig.
    margin
        Width of the border that is left out on all sides [px].
    """
    rig = planned.model
    nodes, weights = _GAUSS
    # patches have a width themselves: their places have the second moment that is left of the image's
    own = patch_width(planned) / 2
    columns, rows = (
        (length - 1) / 2 + nodes * math.sqrt(max((length / 2 - margin) ** 2 - own**2, 0.0))
        for length in (rig.camera_width, rig.camera_height)
    )
    found = [Patch.at(planned, column, row).uncertainty() for row in rows for column in columns]
    weight = np.outer(weights, weights).ravel() / 4

    def root_mean(values: Sequence[float]) -> float:
        return float(np.sqrt(weight @ np.square(values)))

    return PatchUncertainty(
        sigma={name: root_mean([each.sigma[name] for each in found]) for name in QUANTITIES},
        phase=root_mean([each.phase for each in found]),
        in_plane=(root_mean([each.in_plane[0] for each in found]), root_mean([each.in_plane[1] for each in found])),
        level=float(weight @ [each.level for each in found]),
        modulation=float(weight @ [each.modulation for each in found]),
        measured=float(weight @ [each.measured for each in found]),
    )


def plane_noise(planned: PlannedRig) -> float:
    """Return the root mean square noise of z over the image on a surface without texture [m].

    It is infinite where the fringes do not change with the height.
    """
    rig, pitch, orientation = planned.model, planned.layout.pitches[-1], planned.orientation
    nodes, weights = _GAUSS
    columns, rows = ((length - 1) / 2 * (1 + nodes) for length in (rig.camera_width, rig.camera_height))
    points = planned.points(*np.meshgrid(columns, rows))
    irradiance, sensor = planned.irradiance(points), planned.configuration.sensor
    mean, amplitude = planned.modulation(pitch, planned.projector_blur(points))
    white = planned.full_scale * sensor.white_level
    deviation = np.sqrt(planned.noise.variance(white * (sensor.ambient_light + irradiance * mean)))
    sigma = phase_deviation(deviation, white * irradiance * amplitude, planned.layout.counts[-1])
    image = xr.DataArray(
        np.float32(rig.phase(points[0], points[1], points[2], pitch, orientation)),  # as `absolute_phase`
        dims=("row", "column"),
        coords={"row": rows, "column": columns},
    )
    noise = rig.reconstruct(image, pitch, image.copy(data=np.float32(sigma)), orientation)["noise_z"].to_numpy()
    mean_square = float(np.sum(np.outer(weights, weights) / 4 * noise.astype(float) ** 2))
    return math.sqrt(mean_square) if math.isfinite(mean_square) else math.inf


def _centre_patch(planned: PlannedRig) -> Patch:
    rig = planned.model
    return Patch.at(planned, (rig.camera_width - 1) / 2, (rig.camera_height - 1) / 2)


def _twice_the_frames(planned: PlannedRig) -> PlannedRig:
    groups = [list(group) for _, group in groupby(planned.patterns, key=lambda each: (each.kind, each.pitch))]
    repeated = [group if group[0].kind == PatternKind.GRAY_CODE else 2 * group for group in groups]
    return replace(planned, patterns=tuple(pattern for group in repeated for pattern in group))


def _with_sensor(planned: PlannedRig, read: float, shot: float) -> PlannedRig:
    sensor = planned.configuration.sensor
    update = {
        "read_noise_grey_level": read * sensor.read_noise_grey_level,
        "shot_noise_grey_level": shot * sensor.shot_noise_grey_level,
    }
    changed = planned.configuration.model_copy(update={"sensor": sensor.model_copy(update=update)})
    return replace(planned, configuration=changed)


def _finer_pitch(planned: PlannedRig) -> PlannedRig | None:
    finest = planned.layout.pitches[-1]
    if 0.7 * finest < _FINEST_PITCH or any(each.kind == PatternKind.GRAY_CODE for each in planned.patterns):
        return None
    patterns = tuple(replace(each, pitch=0.7 * finest) if each.pitch == finest else each for each in planned.patterns)
    return replace(planned, patterns=patterns)


def _at_angle(planned: PlannedRig, angle: float) -> PlannedRig:
    """Return the rig with its projector moved around the origin, at the same distance."""
    position = np.array(planned.model.projector_position)
    across = position[:2] / np.linalg.norm(position[:2])
    x, y = np.linalg.norm(position) * math.sin(angle) * across
    moved = (float(x), float(y), float(np.linalg.norm(position) * math.cos(angle)))
    return replace(planned, model=dataclasses.replace(planned.model, projector_position=moved))


def _wider_angle(planned: PlannedRig) -> PlannedRig | None:
    angle = planned.angle + _ANGLE_STEP
    return _at_angle(planned, angle) if angle <= _WIDEST_ANGLE else None


def _with_orientation(planned: PlannedRig, orientation: Orientation) -> PlannedRig:
    return replace(planned, patterns=tuple(replace(each, orientation=orientation) for each in planned.patterns))


def _wider_filter(planned: PlannedRig) -> PlannedRig:
    width = 2 * planned.coupling.z_filter_px or 1.0
    return replace(planned, coupling=planned.coupling.model_copy(update={"z_filter_px": width}))


def _wider_strain_window(planned: PlannedRig) -> PlannedRig:
    window = round(1.5 * planned.coupling.strain_window_px)
    return replace(planned, coupling=planned.coupling.model_copy(update={"strain_window_px": window}))


_APPLY: dict[PlanChange, Callable[[PlannedRig], PlannedRig | None]] = {
    PlanChange.TWICE_THE_FRAMES: _twice_the_frames,
    # the same read noise in electrons is half as many grey levels
    PlanChange.TWICE_THE_FULL_WELL: lambda planned: _with_sensor(planned, read=0.5, shot=0.5),
    PlanChange.HALF_THE_READ_NOISE: lambda planned: _with_sensor(planned, read=0.5, shot=1.0),
    PlanChange.FINER_PITCH: _finer_pitch,
    PlanChange.WIDER_ANGLE: _wider_angle,
    PlanChange.WIDER_WINDOW: lambda planned: replace(
        planned, dic=planned.dic.model_copy(update={"window": round(1.5 * planned.dic.window)})
    ),
    PlanChange.WIDER_FILTER: _wider_filter,
    PlanChange.WIDER_STRAIN_WINDOW: _wider_strain_window,
}
