"""Acceptance test with balls, a ball bar and a plane, in the manner of the guideline VDI/VDE 2634 part 2.

Probing errors of form and size come from a ball at ten places of the measured volume, the sphere-spacing error from a
ball bar at seven places, the flatness measurement error from a plane at six places. Each error is the worst one of its
places. Conformity with the guideline is not claimed: the artefacts have to be calibrated, and the places realised.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import xarray as xr
from scipy.ndimage import gaussian_filter, uniform_filter
from scipy.spatial.transform import Rotation

from fringedic.errors import CalibrationError
from fringedic.wording.numbers import number_text

REJECTED = 3e-3  # of the points of each artefact may be left out
CAP = math.radians(45.0)  # a ball is evaluated up to this angle from the direction to the camera
BALL_RANGE, LEAST_SPACING, LEAST_PLANE = (0.1, 0.2), 0.3, 0.5  # sizes of the artefacts over the diagonal of the volume
_FEWEST = 100  # an artefact needs so many points
_CELL = 0.25  # normals vote for the centre of a ball in cells of this part of its radius
_MEANS = 5  # the mean around the most voted cell converges in so many passes
_NEAR = 0.1  # points nearer to a ball's surface than this part of its radius belong to it
_SHOWN = 4000  # so many residuals are kept of each place
_CORNERS = ((-1, 1, -1, 1), (-1, -1, 1, 1))  # signs of x and y
_STEPS = 20  # the Gauss-Newton method converges in about five


class Artefact(StrEnum):
    """What is measured."""

    BALL = "ball"
    BALL_BAR = "ball bar"
    PLANE = "plane"


class AcceptanceError(StrEnum):
    """Characteristics that an acceptance test compares with their maximum permissible errors."""

    FORM = "probing error, form"
    SIZE = "probing error, size"
    SPACING = "sphere-spacing error"
    FLATNESS = "flatness measurement error"


@dataclass(frozen=True)
class Place:
    """Where an artefact is placed in the rig frame.

    Attributes
    ----------
    artefact
        Ball, ball bar or plane.
    centre
        (x, y, z) of its middle [m].
    rotation
        Rotation vector [rad]; without rotation a bar lies along x and a plane faces the camera.
    """

    artefact: Artefact
    centre: tuple[float, float, float]
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Artefacts:
    """Calibrated sizes of the artefacts, and the measured volume [m].

    Attributes
    ----------
    diameter, spacing
        Diameter of the balls, distance of the centres of the bar.
    volume
        Extent along x, y and z.
    """

    diameter: float
    spacing: float
    volume: tuple[float, float, float]

    @property
    def diagonal(self) -> float:
        """Diagonal of the measured volume [m]."""
        return math.hypot(*self.volume)

    def places(self) -> list[Place]:
        """Return the 23 places: ten of the ball, seven of the bar, six of the plane."""
        x, y, z = _reach(self, self.diameter)
        corners = [(i * x, j * y, k * z) for k in (-1, 1) for j in (-1, 1) for i in (-1, 1)]
        diagonal = math.atan2(self.volume[1], self.volume[0])
        tilt = math.asin(min(2 * z / self.spacing, math.sin(math.radians(30.0))))
        turned = [
            ((0.0, 0.0, z), (0.0, 0.0, 0.0)),
            ((0.0, 0.0, -z), (0.0, 0.0, 0.0)),
            ((0.0, 0.0, 0.0), (0.0, 0.0, math.pi / 2)),
            ((0.0, 0.0, 0.0), (0.0, 0.0, diagonal)),
            ((0.0, 0.0, 0.0), (0.0, 0.0, -diagonal)),
            ((0.0, 0.0, 0.0), (0.0, tilt, 0.0)),
            ((0.0, 0.0, 0.0), (0.0, -tilt, 0.0)),
        ]
        return [
            *[Place(Artefact.BALL, centre) for centre in ((0.0, 0.0, 0.0), *corners, (0.0, 0.0, z))],
            *[Place(Artefact.BALL_BAR, centre, rotation) for centre, rotation in turned],
            *_plane_places(self),
        ]


@dataclass(frozen=True, eq=False)
class PlaceResult:
    """Errors of an artefact at one place.

    Attributes
    ----------
    place
        Where it was.
    errors
        Signed errors by characteristic [m]; the form and the flatness are ranges and positive.
    residuals : (3, n)
        x, y [m] and the distance from the fitted sphere or plane [m] of some of the points.
    points
        Number of evaluated points.
    """

    place: Place
    errors: dict[AcceptanceError, float]
    residuals: np.ndarray
    points: int


@dataclass(frozen=True, eq=False)
class Acceptance:
    """Result of an acceptance test.

    Attributes
    ----------
    artefacts
        Their sizes.
    limits
        Maximum permissible errors [m]; characteristics without one are reported only.
    results
        Of every place.
    """

    artefacts: Artefacts
    limits: dict[AcceptanceError, float]
    results: tuple[PlaceResult, ...]

    def worst(self, error: AcceptanceError) -> float:
        """Return the signed error of the largest magnitude over all places [m]; NaN when it was not measured."""
        values = [each.errors[error] for each in self.results if error in each.errors]
        return max(values, key=abs, default=math.nan)

    @property
    def exceeded(self) -> tuple[AcceptanceError, ...]:
        """Characteristics that exceed their limit."""
        return tuple(error for error, limit in self.limits.items() if not abs(self.worst(error)) <= limit)

    @property
    def passed(self) -> bool:
        """Whether no characteristic exceeds its limit."""
        return not self.exceeded


@dataclass(frozen=True, eq=False)
class Sphere:
    """A fitted sphere: centre (3,) and radius [m], and the distance of each point from it [m], positive outside."""

    centre: np.ndarray
    radius: float
    distances: np.ndarray


def fit_sphere(points: np.ndarray) -> Sphere:
    """Fit a sphere to points (3, n) [m] by the least squares of their distances from it.

    Raises
    ------
    CalibrationError
        There are fewer points than a fit needs.

    Examples
    --------
    >>> angle, height = np.random.default_rng(1).uniform(0, 1, (2, 500))
    >>> side = np.sqrt(1 - height**2)
    >>> x, y = side * np.cos(2 * np.pi * angle), side * np.sin(2 * np.pi * angle)
    >>> sphere = fit_sphere(0.01 * np.stack([x, y, height]) + [[0.1], [0.2], [0.3]])
    >>> sphere.centre.round(6).tolist(), round(sphere.radius, 6)
    ([0.1, 0.2, 0.3], 0.01)
    """
    if points.shape[1] < _FEWEST:
        raise CalibrationError(
            f"{points.shape[1]} points were measured on a ball, at least {_FEWEST} are needed: light it better, or use "
            "a larger ball"
        )
    middle = points.mean(axis=1, keepdims=True)
    near = points - middle
    # |p|^2 = 2 c p + (r^2 - |c|^2) is linear and good enough to begin with
    basis = np.vstack([2 * near, np.ones(near.shape[1])]).T
    start = np.linalg.lstsq(basis, np.sum(near**2, axis=0), rcond=None)[0]
    values = np.array([*start[:3], math.sqrt(start[3] + start[:3] @ start[:3])])
    for _ in range(_STEPS):
        away = near - values[:3, None]
        distance = np.linalg.norm(away, axis=0)
        jacobian = np.vstack([-away / distance, -np.ones(distance.size)]).T
        step = np.linalg.lstsq(jacobian, values[3] - distance, rcond=None)[0]
        values += step
        if np.abs(step).max() < 1e-12:
            break
    distances = np.linalg.norm(near - values[:3, None], axis=0) - values[3]
    return Sphere(values[:3] + middle[:, 0], float(values[3]), distances)


def find_balls(shape: xr.Dataset, diameter: float, number: int) -> list[np.ndarray]:
    """Return the points (3, n) [m] on the caps of so many balls of a known diameter.

    The normals of a smoothed surface vote for centres: those of a ball of this radius agree in one place, those of
    other surfaces do not.

    Parameters
    ----------
    shape
        ``x``, ``y``, ``z`` [m] from `RigModel.reconstruct`, NaN where not measured.
    diameter
        Of the balls [m].
    number
        How many there are in view.

    Raises
    ------
    CalibrationError
        The surface shows fewer balls of this diameter.
    """
    radius = diameter / 2
    points = np.stack([np.asarray(shape[name], float) for name in "xyz"])
    if np.count_nonzero(np.isfinite(points[2])) < _FEWEST:
        raise CalibrationError("too little of the surface is measured to find a ball in it: light it better")
    votes = points - radius * _normals(points, radius)
    camera = np.array([0.0, 0.0, float(shape.attrs["camera_distance"])])
    found = []
    for _ in range(number):
        centre = _most_voted(votes, radius)
        sphere_points = _cap(points, centre, radius, camera)
        for _ in range(3):
            sphere = fit_sphere(sphere_points)
            sphere_points = _cap(points, sphere.centre, sphere.radius, camera)
        if abs(sphere.radius - radius) > _NEAR * radius:
            raise CalibrationError(
                f"no ball of {number_text(1e3 * diameter, 3)} mm was found: the roundest part of the surface has a "
                f"diameter of {number_text(2e3 * sphere.radius, 3)} mm; check the diameter and that every "
                "ball is in view and matt"
            )
        found.append(sphere_points)
        beside = np.linalg.norm(votes - sphere.centre[:, None, None], axis=0) > diameter
        votes = np.where(beside, votes, np.nan)
    return found


def measure_place(place: Place, shape: xr.Dataset, artefacts: Artefacts) -> PlaceResult:
    """Return the errors of an artefact from its measured surface.

    Parameters
    ----------
    place
        What was placed where.
    shape
        From `RigModel.reconstruct`; dark or not measured around balls, and the plane alone in view.
    artefacts
        Calibrated sizes.

    Raises
    ------
    CalibrationError
        The artefact was not found, or stands nearer to another of the places.
    """
    if place.artefact is Artefact.PLANE:
        points = np.stack([np.asarray(shape[name], float) for name in "xyz"]).reshape(3, -1)
        kept, distances = _without_outliers(points[:, np.isfinite(points[2])], _plane_distances)
        _check_place(place, _plane_corners(*_fit_plane(kept), artefacts), artefacts)
        return _result(place, {AcceptanceError.FLATNESS: float(np.ptp(distances))}, kept, distances)
    number = 2 if place.artefact is Artefact.BALL_BAR else 1
    caps = [
        _without_outliers(each, lambda points: fit_sphere(points).distances)
        for each in find_balls(shape, artefacts.diameter, number)
    ]
    spheres = [fit_sphere(kept) for kept, _ in caps]
    _check_place(place, np.array([each.centre for each in spheres]), artefacts)
    if place.artefact is Artefact.BALL_BAR:
        spacing = float(np.linalg.norm(spheres[1].centre - spheres[0].centre))
        errors = {AcceptanceError.SPACING: spacing - artefacts.spacing}
    else:
        form, size = float(np.ptp(spheres[0].distances)), 2 * spheres[0].radius - artefacts.diameter
        errors = {AcceptanceError.FORM: form, AcceptanceError.SIZE: size}
    kept, distances = (np.concatenate(parts, axis=-1) for parts in zip(*caps, strict=True))
    return _result(place, errors, kept, distances)


def _check_place(place: Place, found: np.ndarray, artefacts: Artefacts) -> None:
    """Refuse an artefact that was not moved: its points (n, 3) [m] are nearer to those of another place."""

    def away(other: Place) -> float:
        turn = Rotation.from_rotvec(other.rotation)
        if other.artefact is Artefact.PLANE:
            nominal = _plane_corners(np.array(other.centre), turn.apply((0.0, 0.0, 1.0)), artefacts)
        else:
            half = artefacts.spacing / 2 if other.artefact is Artefact.BALL_BAR else 0.0
            centres: np.ndarray = other.centre + turn.apply([(-half, 0.0, 0.0), (half, 0.0, 0.0)])
            nominal = centres if half else centres[:1]
        # nothing distinguishes the two balls of a bar
        return min(float(np.linalg.norm(each - nominal, axis=1).max()) for each in (found, found[::-1]))

    others = [each for each in enumerate(artefacts.places(), start=1) if each[1].artefact is place.artefact]
    number, nearest = min([(0, place), *others], key=lambda each: away(each[1]))  # itself, where two places coincide
    if nearest is not place:
        raise CalibrationError(
            f"the {place.artefact} is {number_text(1e3 * away(place), 3)} mm away from it and nearer to place "
            f"{number}: move it to every place, and repeat the test"
        )


def _plane_corners(middle: np.ndarray, normal: np.ndarray, artefacts: Artefacts) -> np.ndarray:
    """Return where a plane cuts the four edges of the volume along z, (4, 3) [m]."""
    x, y = (np.array(signs) * each / 2 for signs, each in zip(_CORNERS, artefacts.volume[:2], strict=True))
    z = middle[2] - (normal[0] * (x - middle[0]) + normal[1] * (y - middle[1])) / normal[2]
    return np.stack([x, y, z], axis=1)


def _result(
    place: Place, errors: dict[AcceptanceError, float], points: np.ndarray, distances: np.ndarray
) -> PlaceResult:
    every = max(1, distances.size // _SHOWN)
    residuals = np.stack([points[0, ::every], points[1, ::every], distances[::every]])
    return PlaceResult(place, errors, residuals, distances.size)


def _without_outliers(
    points: np.ndarray, distances_of: Callable[[np.ndarray], np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return points and distances without the few that may be rejected; the rest is fitted again."""
    distances = np.abs(distances_of(points))
    kept = points[:, np.argsort(distances)[: math.ceil((1 - REJECTED) * distances.size)]]
    return kept, distances_of(kept)


def _plane_distances(points: np.ndarray) -> np.ndarray:
    """Return the distances of points (3, n) from their plane of least squares [m]."""
    middle, normal = _fit_plane(points)
    return np.asarray((points - middle[:, None]).T @ normal)


def _fit_plane(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the middle and the unit normal towards the camera of the plane of least squares of points (3, n) [m]."""
    if points.shape[1] < _FEWEST:
        raise CalibrationError(f"{points.shape[1]} points were measured on the plane, at least {_FEWEST} are needed")
    middle = points.mean(axis=1)
    near = points - middle[:, None]
    normal = np.linalg.eigh(near @ near.T)[1][:, 0]
    return middle, normal * math.copysign(1.0, normal[2])


def _normals(points: np.ndarray, radius: float) -> np.ndarray:
    """Return unit normals (3, row, column) towards the camera of a surface smoothed over a sixth of the radius."""
    step = np.nanmedian(np.abs(np.diff(points[0], axis=1)))
    width = radius / 6 / float(step)
    known = np.isfinite(points[2])
    weight = gaussian_filter(known.astype(float), width)
    smooth = np.stack([gaussian_filter(np.where(known, each, 0.0), width) for each in points])
    smooth = np.where(known & (weight > 0.5), smooth / np.maximum(weight, 1e-9), np.nan)
    down, right = np.gradient(smooth, axis=(1, 2))
    normal = np.cross(right, -down, axis=0)  # x to the right, y upwards
    unit: np.ndarray = normal / np.linalg.norm(normal, axis=0)
    return unit


def _most_voted(votes: np.ndarray, radius: float) -> np.ndarray:
    """Return the place (3,) that most normals agree on."""
    known = votes[:, np.isfinite(votes).all(axis=0)]
    if known.shape[1] < _FEWEST:
        raise CalibrationError("fewer balls were found than are in view: check that every ball is in view and matt")
    low, cell = known.min(axis=1), _CELL * radius
    index = ((known - low[:, None]) / cell).astype(int)
    counts = np.zeros(index.max(axis=1) + 1)
    np.add.at(counts, tuple(index), 1)
    best = np.unravel_index(np.argmax(uniform_filter(counts, 3, mode="constant")), counts.shape)
    centre: np.ndarray = low + (np.array(best) + 0.5) * cell
    for _ in range(_MEANS):
        near = np.linalg.norm(known - centre[:, None], axis=0) < 2 * cell
        centre = known[:, near].mean(axis=1)
    return centre


def _cap(points: np.ndarray, centre: np.ndarray, radius: float, camera: np.ndarray) -> np.ndarray:
    """Return the points (3, n) near a sphere, on its cap towards the camera."""
    away = points - centre[:, None, None]
    distance = np.linalg.norm(away, axis=0)
    towards = (camera - centre) / np.linalg.norm(camera - centre)
    cosine = np.tensordot(towards, away, axes=1) / distance
    inside: np.ndarray = points[:, (np.abs(distance - radius) < _NEAR * radius) & (cosine > math.cos(CAP))]
    return inside


def _plane_places(artefacts: Artefacts) -> list[Place]:
    """Return planes that face the camera in front, in the middle and at the back, and inclined ones."""
    z = artefacts.volume[2] / 2
    tilt = math.atan2(artefacts.volume[2], math.hypot(*artefacts.volume[:2]))
    facing = [((0.0, 0.0, each), (0.0, 0.0, 0.0)) for each in (-z, 0.0, z)]
    inclined = [
        ((0.0, 0.0, 0.0), each) for each in ((tilt, 0.0, 0.0), (0.0, tilt, 0.0), (0.7 * tilt, -0.7 * tilt, 0.0))
    ]
    return [Place(Artefact.PLANE, centre, rotation) for centre, rotation in (*facing, *inclined)]


def _reach(artefacts: Artefacts, size: float) -> tuple[float, float, float]:
    """Return how far the middle of something of this size may be from the middle of the volume, along x, y, z [m]."""
    x, y, z = (max(each - size, 0.0) / 2 for each in artefacts.volume)
    return x, y, z


def unsuitable(artefacts: Artefacts) -> Sequence[Artefact]:
    """Return the artefacts whose size differs from that which the guideline asks for in this volume."""
    low, high = (part * artefacts.diagonal for part in BALL_RANGE)
    found = [] if low <= artefacts.diameter <= high else [Artefact.BALL]
    return found if artefacts.spacing >= LEAST_SPACING * artefacts.diagonal else [*found, Artefact.BALL_BAR]
