"""Registration of sensors: the poses of all from objects that several of them measured (bundle adjustment).

The unknowns are six numbers of each sensor but the reference, and the position of every object. The observations are
positions of balls and planes in the rig frame of each sensor. Their errors are noise, independent for each object, and
errors of the sensor's calibration, which are common to all its objects. Generalised least squares with the covariance
of both gives the poses with the smallest variance, their covariance, and their covariance with the errors of the
calibrations: the latter is needed for the uncertainty of a distance between points of two sensors.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np

from fringedic.camera.findings import Finding
from fringedic.errors import CalibrationError
from fringedic.patterns.pattern import Orientation
from fringedic.rig.model import RigModel
from fringedic.rig.uncertainty import principal_directions
from fringedic.sensors.features import Feature, FeatureKind, errors_at, rigid_fit, rotation_between
from fringedic.sensors.findings import RegistrationFinding, RegistrationVerdict
from fringedic.sensors.poses import SensorPose

_STEPS = 20
_CONVERGED = 1e-9  # of a standard deviation
_UNEXPLAINED = 4.0  # standard deviations of chi square, as of a calibration
_SINGULAR = 1e-12  # smallest eigenvalue of the scaled normal equations
_FREE = 5e-3  # [m]; noise alone makes directions that no object determines finite
_COARSE = 1e-4  # [m]; a sensor that is placed worse is not registered


@dataclass(frozen=True)
class Residual:
    """How far an object is from where one sensor measured it.

    Attributes
    ----------
    sensor, name
        Of the sensor and of the object.
    deviation
        Length of the residual [m]; of a plane that along its normal.
    sigmas
        Largest test value of its components: the weighted residual over its standard deviation.
    """

    sensor: str
    name: str
    deviation: float
    sigmas: float


@dataclass(frozen=True, eq=False)
class Registration:
    """Poses of sensors in one frame.

    Attributes
    ----------
    reference
        The sensor whose rig frame is the common one.
    poses
        Of every sensor by its name; that of the reference is the identity.
    covariance : (6 n, 6 n)
        Of the poses of the other sensors in their order: small rotation [rad] and translation [m], see
        `SensorPose.moved`.
    directions
        By sensor: the directions (direction, parameter) of the covariance of its calibration.
    shared
        By sensor: covariance (6 n, direction) of the poses with the error of the calibration along each direction.
    calibrations
        Identifier of the calibration of each sensor.
    orientation
        Direction of the fringes.
    chi_square, freedom
        Of the residuals.
    residuals
        Of every observation.
    findings
        Remarks.
    created
        Time.
    edited
        Whether a person has edited its file.
    """

    reference: str
    poses: Mapping[str, SensorPose]
    covariance: np.ndarray
    directions: Mapping[str, np.ndarray]
    shared: Mapping[str, np.ndarray]
    calibrations: Mapping[str, str]
    chi_square: float
    freedom: int
    residuals: tuple[Residual, ...]
    orientation: Orientation = Orientation.VERTICAL
    findings: tuple[Finding, ...] = ()
    created: datetime = field(default_factory=lambda: datetime.now(UTC))
    edited: bool = False

    @property
    def placed(self) -> list[str]:
        """The sensors whose pose was estimated, in the order of `covariance`."""
        return [each for each in self.poses if each != self.reference]

    @property
    def reduced_chi_square(self) -> float:
        """Chi square over its degrees of freedom; NaN without any."""
        return self.chi_square / self.freedom if self.freedom else math.nan

    @property
    def verdict(self) -> RegistrationVerdict:
        """Whether the poses can be used."""
        codes = {each.code for each in self.findings}
        if codes & {RegistrationFinding.CONTRADICTION, RegistrationFinding.UNCERTAIN}:
            return RegistrationVerdict.NO_GO
        return RegistrationVerdict.WITH_CARE if codes else RegistrationVerdict.GO

    def require(self, identifiers: Mapping[str, str]) -> None:
        """Refuse sensors without a pose, and calibrations other than those that the sensors were registered with.

        Parameters
        ----------
        identifiers
            Of the calibration in use, by sensor.

        Raises
        ------
        CalibrationError
            One of them.
        """
        self.require_poses(identifiers)
        for name, other in self.other_calibrations(identifiers):
            if other is not None:
                raise CalibrationError(
                    f"the sensor '{name}' was measured with the calibration of '{other}': the cameras or the "
                    f"calibration files of '{name}' and '{other}' are exchanged; exchange them back in the rig file"
                )
            raise CalibrationError(
                f"the sensor '{name}' was measured with the calibration '{identifiers[name]}', but registered with "
                f"'{self.calibrations[name]}', which has another frame: register the sensors again with the "
                "calibrations in use"
            )

    def other_calibrations(self, identifiers: Mapping[str, str]) -> Iterator[tuple[str, str | None]]:
        """Yield the sensors whose calibration is another than the registered one.

        Each comes with the sensor that was registered with this calibration, or None.
        """
        for name, identifier in identifiers.items():
            if self.calibrations[name] != identifier:
                yield name, next((each for each, known in self.calibrations.items() if known == identifier), None)

    def require_poses(self, sensors: Iterable[str]) -> None:
        """Refuse sensors without a pose (`CalibrationError`)."""
        for name in sensors:
            if name not in self.poses:
                raise CalibrationError(
                    f"the sensor '{name}' has no pose in the registration, which contains {', '.join(self.poses)}: "
                    "register it with the others"
                )

    def pose_covariance(self, sensor: str) -> np.ndarray:
        """Return the covariance (6, 6) of the pose of a sensor; zero for the reference."""
        if sensor == self.reference:
            return np.zeros((6, 6))
        first = 6 * self.placed.index(sensor)
        return self.covariance[first : first + 6, first : first + 6]

    def position_errors(self, sensor: str, model: RigModel, points: np.ndarray) -> np.ndarray:
        """Return how points of a sensor depend on the errors that points have in common, (3, error, n) [m].

        Parameters
        ----------
        sensor
            Its name.
        model
            Its calibration.
        points : (3, n)
            In the rig frame of the sensor [m].

        Returns
        -------
        ndarray
            In the common frame. The errors are those of the poses, and one for each direction of the calibration of
            each sensor, as in `common_covariance`.
        """
        sizes = [len(self.covariance), *(len(each) for each in self.directions.values())]
        starts = dict(zip(self.directions, np.cumsum(sizes)[:-1].tolist(), strict=True))
        found = np.zeros((3, sum(sizes), points.shape[1]))
        if sensor != self.reference:
            first = 6 * self.placed.index(sensor)
            found[:, first : first + 6] = self.poses[sensor].error_matrix(points)
        directions = self.directions[sensor]
        if len(directions):
            own = errors_at(model, points, self.orientation, directions)
            found[:, starts[sensor] : starts[sensor] + len(own)] = np.einsum(
                "ij,kjn->ikn", self.poses[sensor].matrix, own
            )
        return found

    @property
    def common_covariance(self) -> np.ndarray:
        """Covariance of the errors of poses and calibrations together, in the order of `position_errors`."""
        crossed = np.hstack([self.covariance, *(self.shared[each] for each in self.directions)])
        size = crossed.shape[1]
        whole = np.eye(size)
        count = len(self.covariance)
        whole[:count] = crossed
        whole[:, :count] = crossed.T
        whole[:count, :count] = self.covariance
        return whole


def register(
    features: Sequence[Feature],
    models: Mapping[str, RigModel],
    *,
    reference: str | None = None,
    orientation: Orientation = Orientation.VERTICAL,
) -> Registration:
    """Place sensors in one frame by the objects that several of them measured.

    Parameters
    ----------
    features
        Of `measure_balls` and `measure_plane`; those of one object have the same name. Objects that one sensor alone
        measured are ignored.
    models
        Calibration of each sensor by its name.
    reference
        The sensor whose rig frame becomes the common one; by default the first.
    orientation
        Direction of the fringes.

    Returns
    -------
    Registration
        Poses with their covariance, residuals and a verdict.

    Raises
    ------
    CalibrationError
        A sensor has no object in common with the others, or the objects do not determine its pose.

    References
    ----------
    B. Triggs, P. McLauchlan, R. Hartley, A. Fitzgibbon (2000), Bundle adjustment - a modern synthesis, Vision
    Algorithms: Theory and Practice, Springer, 298-372.
    W. Baarda (1968), A testing procedure for use in geodetic networks, Netherlands Geodetic Commission 2 (5).
    """
    reference = next(iter(models)) if reference is None else reference
    if reference not in models:
        raise CalibrationError(f"there is no sensor '{reference}': choose one of {', '.join(sorted(models))}")
    if len(models) < 2:
        raise CalibrationError(f"only the sensor '{reference}' is there: a registration needs two or more")
    seen_by = {each.name: {other.sensor for other in features if other.name == each.name} for each in features}
    used = [each for each in features if len(seen_by[each.name]) > 1]
    bundle = _Bundle(used, _start(used, list(models), reference), reference, models)
    bundle.solve()
    return bundle.result(orientation)


def _start(features: Sequence[Feature], sensors: list[str], reference: str) -> dict[str, SensorPose]:
    """Return approximate poses, sensor by sensor from the reference on."""
    poses = {reference: SensorPose()}
    while len(poses) < len(sensors):
        placed = {each.name: each for each in features if each.sensor in poses}
        options = {
            sensor: [each for each in features if each.sensor == sensor and each.name in placed]
            for sensor in sensors
            if sensor not in poses
        }
        sensor = max(options, key=lambda each: len(options[each]))
        own = options[sensor]
        if not own:
            raise CalibrationError(
                f"the sensor '{sensor}' measured no object that {', '.join(sorted(poses))} measured, too: the overlap "
                "is empty; place the object where both see it"
            )
        poses[sensor] = _place(own, [placed[each.name] for each in own], poses)
    return {sensor: poses[sensor] for sensor in sensors}


def _place(own: Sequence[Feature], others: Sequence[Feature], poses: Mapping[str, SensorPose]) -> SensorPose:
    """Return the pose that moves features onto those of placed sensors."""
    balls = [(a, b) for a, b in zip(own, others, strict=True) if a.kind is FeatureKind.BALL]
    planes = [(a, b) for a, b in zip(own, others, strict=True) if a.kind is FeatureKind.PLANE]
    if len(balls) >= 3 and not planes:
        points = np.stack([a.position for a, _ in balls], axis=1)
        targets = np.stack([poses[b.sensor].apply(b.position) for _, b in balls], axis=1)
        return SensorPose.of(*rigid_fit(points, targets)[:2])
    vectors = [a.axes[0] for a, _ in planes]
    aims = [poses[b.sensor].turn(b.axes[0]) for _, b in planes]
    if balls:
        middle = np.mean([a.position for a, _ in balls], axis=0)
        aim = np.mean([poses[b.sensor].apply(b.position) for _, b in balls], axis=0)
        size = max(float(np.linalg.norm(a.position - middle)) for a, _ in balls) or 1.0
        vectors += [(a.position - middle) / size for a, _ in balls]
        aims += [(poses[b.sensor].apply(b.position) - aim) / size for _, b in balls]
    rotation = rotation_between(np.stack(vectors, axis=1), np.stack(aims, axis=1))
    rows, sides = [], []
    for a, b in planes:
        normal, point = poses[b.sensor].turn(b.axes[0]), poses[b.sensor].apply(b.position)
        rows.append(normal)
        sides.append(normal @ (point - rotation @ a.position))
    for a, b in balls:
        rows += list(np.eye(3))
        sides += list(poses[b.sensor].apply(b.position) - rotation @ a.position)
    return SensorPose.of(rotation, np.linalg.lstsq(np.array(rows), np.array(sides), rcond=None)[0])


class _Bundle:
    """The estimate of poses and objects."""

    def __init__(
        self,
        features: Sequence[Feature],
        poses: dict[str, SensorPose],
        reference: str,
        models: Mapping[str, RigModel],
    ) -> None:
        self.features, self.poses, self.reference, self.models = features, poses, reference, models
        self.placed = [each for each in poses if each != reference]
        self.directions = {name: principal_directions(model) for name, model in models.items()}
        self.objects: dict[str, np.ndarray] = {}  # centre of a ball (3,); point and normal of a plane (2, 3)
        for each in features:
            pose = poses[each.sensor]
            point = pose.apply(each.position)
            value = point if each.kind is FeatureKind.BALL else np.stack([point, pose.turn(each.axes[0])])
            self.objects.setdefault(each.name, value)
        self.noise, self.shared = self._errors()

    def _errors(self) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the covariance of noise and the errors (3 n, direction) by the calibration of each sensor."""
        size = 3 * len(self.features)
        noise = np.zeros((size, size))
        shared = {name: np.zeros((size, len(each))) for name, each in self.directions.items()}
        for index, each in enumerate(self.features):
            place = slice(3 * index, 3 * index + 3)
            turn = self.poses[each.sensor].matrix if each.kind is FeatureKind.BALL else np.eye(3)
            noise[place, place] = turn @ each.covariance @ turn.T
            shared[each.sensor][place] = turn @ each.errors.T
        return noise, shared

    def _residuals(self, poses: Mapping[str, SensorPose], objects: Mapping[str, np.ndarray]) -> np.ndarray:
        found: list[np.ndarray | list[float]] = []
        for each in self.features:
            pose, thing = poses[each.sensor], objects[each.name]
            if each.kind is FeatureKind.BALL:
                found.append(pose.apply(each.position) - thing)
                continue
            point, normal = thing
            turned = pose.turn(each.axes.T).T
            found.append([normal @ (pose.apply(each.position) - point), turned[1] @ normal, turned[2] @ normal])
        return np.concatenate(found)

    def _moved(self, change: np.ndarray) -> tuple[dict[str, SensorPose], dict[str, np.ndarray]]:
        poses = dict(self.poses)
        for index, sensor in enumerate(self.placed):
            poses[sensor] = self.poses[sensor].moved(change[6 * index : 6 * index + 6])
        first = 6 * len(self.placed)
        objects = {}
        for index, (name, thing) in enumerate(self.objects.items()):
            own = change[first + 3 * index : first + 3 * index + 3]
            objects[name] = thing + own if thing.ndim == 1 else _moved_plane(thing, own)
        return poses, objects

    def _derivative(self) -> np.ndarray:
        """Return the derivatives of the residuals by the changes of poses and objects, as `_moved` takes them."""
        found = np.zeros((3 * len(self.features), 6 * len(self.placed) + 3 * len(self.objects)))
        places = {name: 6 * len(self.placed) + 3 * index for index, name in enumerate(self.objects)}
        poses = {name: 6 * index for index, name in enumerate(self.placed)}
        for index, each in enumerate(self.features):
            rows, pose, thing = slice(3 * index, 3 * index + 3), self.poses[each.sensor], self.objects[each.name]
            by_pose = pose.error_matrix(each.position)
            at = places[each.name]
            if each.kind is FeatureKind.BALL:
                by_object = -np.eye(3)
            else:
                point, normal = thing
                first, second = _directions_in(normal)
                away, along = pose.apply(each.position) - point, pose.turn(each.axes[1:].T).T
                # a rotation a changes the product of a turned direction e and the normal n by a . (e x n)
                turned = [np.concatenate([np.cross(axis, normal), np.zeros(3)]) for axis in along]
                by_pose = np.stack([normal @ by_pose, *turned])
                by_object = np.array(
                    [[-1.0, first @ away, second @ away], *([0.0, first @ axis, second @ axis] for axis in along)]
                )
            if each.sensor != self.reference:
                found[rows, poses[each.sensor] : poses[each.sensor] + 6] = by_pose
            found[rows, at : at + 3] = by_object
        return found

    def solve(self) -> None:
        """Find poses and objects (Gauss-Newton)."""
        for _ in range(_STEPS):
            self.derivative = self._derivative()
            total = self.noise + sum(each @ each.T for each in self.shared.values())
            # scaled to unit variances: lengths and slopes differ by powers of ten
            scale = 1.0 / np.sqrt(np.diag(total))
            self.weight = scale[:, None] * np.linalg.inv(total * np.outer(scale, scale)) * scale
            normal = self.derivative.T @ self.weight @ self.derivative
            unit = 1.0 / np.sqrt(np.diag(normal))
            scaled = normal * np.outer(unit, unit)
            values, vectors = np.linalg.eigh(scaled)
            if values[0] < _SINGULAR:
                self._refuse(vectors[:, 0] * unit)
            self.covariance = unit[:, None] * np.linalg.inv(scaled) * unit
            free = np.sqrt(np.diag(self.covariance))[: 6 * len(self.placed)].reshape(-1, 6)[:, 3:]
            if free.max() > _FREE:
                self._refuse(np.repeat(free.max(axis=1), 6))
            step = -self.covariance @ self.derivative.T @ self.weight @ self._residuals(self.poses, self.objects)
            self.poses, self.objects = self._moved(step)
            self.noise, self.shared = self._errors()
            if np.all(np.abs(step) < _CONVERGED * np.sqrt(np.diag(self.covariance)) + 1e-15):
                break

    def _refuse(self, direction: np.ndarray) -> None:
        """Say which sensor is not determined."""
        sizes = [float(np.abs(direction[6 * index : 6 * index + 6]).max()) for index in range(len(self.placed))]
        sensor = self.placed[int(np.argmax(sizes))]
        raise CalibrationError(
            f"the objects do not determine the pose of the sensor '{sensor}': planes have to be tilted about two axes, "
            "or measure three balls"
        )

    def result(self, orientation: Orientation) -> Registration:
        """Return poses, covariance, residuals and remarks."""
        count = 6 * len(self.placed)
        residual = self._residuals(self.poses, self.objects)
        gain = -self.covariance @ self.derivative.T @ self.weight
        chi_square, freedom = float(residual @ self.weight @ residual), len(residual) - self.derivative.shape[1]
        # errors are correlated: the test of one observation weights its residual with all others (Baarda 1968)
        weighted = self.weight @ residual
        left = self.weight - self.weight @ self.derivative @ self.covariance @ self.derivative.T @ self.weight
        sigma = np.sqrt(np.maximum(np.diag(left), 1e-9 * np.diag(self.weight)))
        residuals = tuple(
            Residual(
                each.sensor,
                each.name,
                float(np.linalg.norm(residual[3 * i : 3 * i + 3]))
                if each.kind is FeatureKind.BALL
                else abs(float(residual[3 * i])),
                float(np.abs(weighted[3 * i : 3 * i + 3] / sigma[3 * i : 3 * i + 3]).max()),
            )
            for i, each in enumerate(self.features)
        )
        registration = Registration(
            self.reference,
            self.poses,
            self.covariance[:count, :count],
            self.directions,
            {name: (gain @ each)[:count] for name, each in self.shared.items()},
            {name: model.identifier for name, model in self.models.items()},
            chi_square,
            freedom,
            residuals,
            orientation,
        )
        found = tuple(_findings(registration, self.features))
        return Registration(**{**vars(registration), "findings": found})


def _directions_in(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two orthogonal directions in the plane of a normal."""
    first = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    first /= np.linalg.norm(first)
    return first, np.cross(normal, first)


def _moved_plane(plane: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Return point and normal of a plane that moved along its normal and turned about two axes in it."""
    point, normal = plane
    first, second = _directions_in(normal)
    turned = normal + change[1] * first + change[2] * second
    return np.stack([point + change[0] * normal, turned / np.linalg.norm(turned)])


def _findings(registration: Registration, features: Sequence[Feature]) -> Iterable[Finding]:
    if not registration.freedom:
        yield Finding(RegistrationFinding.NOT_TESTED)
    elif registration.reduced_chi_square > 1 + _UNEXPLAINED * math.sqrt(2 / registration.freedom):
        worst = max(registration.residuals, key=lambda each: each.sigmas)
        values = {"deviation": worst.deviation, "sigmas": worst.sigmas}
        yield Finding(RegistrationFinding.CONTRADICTION, f"sensor '{worst.sensor}', {worst.name}", values)
    for sensor in registration.placed:
        middle = np.mean([each.position for each in features if each.sensor == sensor], axis=0)
        by = registration.poses[sensor].error_matrix(middle)
        sigma = math.sqrt(float(np.trace(by @ registration.pose_covariance(sensor) @ by.T)))
        if sigma > _COARSE:
            yield Finding(RegistrationFinding.UNCERTAIN, f"sensor '{sensor}'", {"sigma": sigma})
