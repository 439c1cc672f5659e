"""Several sensors in one frame, on independent virtual rigs: poses, agreement in the overlap, strain across the seam.

Each rig has its own poses, alignments and lenses. Its sensors are calibrated from frames of the grid and of the plane
on the stage, registered by three balls in three places, and measure a specimen before and after a travel of the
crosshead. The true pose and the true strain come from the virtual rig. Writes docs/validation/sensors.md; `--quick`
takes few rigs and small images, and after Ctrl-C the page contains the rigs that were measured so far.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as fringedic_ros does

import argparse
import copy
import dataclasses
import json
import math
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, wait
from dataclasses import dataclass
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.ndimage import distance_transform_edt
from scipy.spatial.transform import Rotation

from fringedic.calibration.session import CalibrationSession, Plane, Setting
from fringedic.errors import FringedicError
from fringedic.frames.collector import Stack
from fringedic.frames.records import FrameRecord
from fringedic.patterns.pattern import Orientation
from fringedic.patterns.sequences import PatternSequence, fringe_sequence
from fringedic.rig.model import RigModel
from fringedic.sensors import Feature, Registration, join_sensors, register
from fringedic.sensors.features import match_balls, measure_balls
from fringedic.steps import CouplingParameters, DicParameters, DisplacementTracker, PhaseParameters, ShapeTracker
from fringedic.steps.phase import phase_step
from fringedic.steps.step_results import PhaseResult
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration
from fringedic.virtual_rig.configuration import arranged

PAGE = Path(__file__).resolve().parents[1] / "docs" / "validation" / "sensors.md"
PLATES, CYLINDERS = 30, 4
QUICK_PLATES, QUICK_CYLINDERS = 3, 1
FILTERS = {"plate": (2.0,), "cylinder": (0.0, 2.0)}  # of the height, `z_filter_px`; 2 is the default
SMALLER = {"plate": 5, "cylinder": 4}  # than 1280x960 px along each side
QUICK_SMALLER = 5
SEED = 52_000  # of no test
PITCH = 10.0
SHIFTS = (4, 4, 8)
GRID_PITCH = 10.0  # [px]; the lines are as sharp for the pixels as those of the presets
GRID_ANGLES = (-12.0, 12.0)  # [degree]
PLANES = ((0.0, 0.0), (-12.0, 0.0), (-6.0, 0.0), (6.0, 0.0), (12.0, 0.0), (-9.0, -15.0), (0.0, -15.0), (9.0, -15.0))
"""Angle [degree] and height [mm] of the planes; the first one is measured again at the end."""
BALL_RADIUS = {"plate": 7.5, "cylinder": 6.5}  # [mm]
PLACES = {
    "plate": (
        ((-13.0, -9.0, 0.0), (12.5, -10.0, 3.0), (-2.0, 11.0, -4.0)),
        ((-11.0, -9.0, 8.0), (11.5, -10.0, -3.0), (-1.0, 10.0, 4.0)),
        ((-3.0, -9.0, -8.0), (13.5, -7.0, 3.0), (-5.0, 11.5, -9.0)),
    ),
    "cylinder": (
        ((-9.0, -14.0, 4.0), (8.0, 0.0, -6.0), (3.0, 14.0, 3.0)),
        ((6.0, -14.0, -7.0), (-8.0, 0.5, -4.0), (2.0, 14.5, 9.0)),
        ((-2.0, -15.0, -9.0), (9.0, -1.0, 5.0), (-7.0, 14.0, 0.0)),
    ),
}
"""Centres of three balls in three places [mm], in the frame of the specimen; no ball hides another."""
TRAVEL = 2e-4  # [m] of the crosshead
MATT = {"kind": "speckle", "floor": 0.95}


@dataclass
class Outcome:
    """What one rig gives; errors over sigma unless a unit is stated."""

    go: bool
    pose: list[float]  # rotation and translation of each placed sensor
    pose_um: float  # largest standard uncertainty of a translation
    mahalanobis: list[float]  # of each placed sensor: squared length of the error in units of its covariance, over 6
    overlap: dict[str, np.ndarray]  # sum of squares and number
    strain: dict[str, np.ndarray]  # by strain: of one sensor, of two, next to the seam: sum of squares and number
    step: dict[str, float]  # by strain: two sensors minus one, next to the seam [ustrain]
    radius: tuple[float, float] | None  # error and standard uncertainty [um]
    around: tuple[float, float] | None  # circumference strain: error and stated standard uncertainty [ustrain]


class Sensor(NamedTuple):
    """A virtual sensor with its calibration."""

    twin: VirtualRig
    model: RigModel


def entries_of(arrangement: str, place: str, smaller: int, generator: np.random.Generator) -> dict[str, Any]:
    """Return the entries of a sensor whose pose, alignment and lenses are random."""
    entries = copy.deepcopy(arranged(arrangement, place))
    for device in ("camera", "projector"):
        for length in ("columns", "rows"):
            entries[device][length] //= smaller
    entries["camera"]["pixel_size_um"] *= smaller
    entries["projector"]["focal_length_px"] /= smaller
    entries["texture"]["feature_um"] *= smaller
    pixel = entries["camera"]["pixel_size_um"]
    entries["stage"] = {"grid_pitch_mm": 1e-3 * GRID_PITCH * pixel, "grid_blur_um": 0.6 * pixel}
    placement = entries["placement"]
    placement["translation_mm"] = tuple((placement["translation_mm"] + generator.uniform(-1.5, 1.5, 3)).tolist())
    small = Rotation.from_rotvec(generator.uniform(-2.0, 2.0, 3), degrees=True)
    turned = small * Rotation.from_rotvec(placement["rotation_degree"], degrees=True)
    placement["rotation_degree"] = tuple(turned.as_rotvec(degrees=True).tolist())
    tilt_x, tilt_y = generator.uniform(-0.2, 0.2, 2).tolist()
    k1, p1 = generator.uniform(-0.04, 0.04), generator.uniform(-3e-4, 3e-4)
    entries["camera"] |= {"tilt_x_degree": tilt_x, "tilt_y_degree": tilt_y, "lens": {"k1": k1, "p1": p1}}
    roll, yaw, distortion = generator.uniform(-1, 1, 3).tolist()
    entries["projector"] |= {"roll_degree": 0.7 * roll, "yaw_degree": 0.2 * yaw, "k1": 0.03 * distortion}
    if arrangement == "plate":
        entries["specimen"] |= {"bow_mm": 0.0, "twist_per_mm": 0.0}  # its strain is the same everywhere
    return entries


def twins_of(arrangement: str, seed: int, smaller: int) -> dict[str, VirtualRig]:
    """Return the sensors of a random rig."""
    generator = np.random.default_rng(seed)
    names = ("left", "right") if arrangement == "plate" else ("a", "b", "c", "d")
    found = {}
    for name in names:
        entries = entries_of(arrangement, name, smaller, generator) | {"seed": seed}
        found[name] = VirtualRig(VirtualRigConfiguration.from_dict(entries))
    return found


def with_specimen(twin: VirtualRig, specimen: dict[str, Any]) -> VirtualRig:
    """Return the sensor in front of another specimen, which is matt and has no speckle to measure."""
    entries = twin.configuration.model_dump() | {"specimen": specimen}
    entries["texture"] = entries["texture"] | MATT
    return VirtualRig(VirtualRigConfiguration.from_dict(entries))


def sequence_of(twin: VirtualRig) -> PatternSequence:
    """Return the fringes of a step."""
    height, width = twin.projector_shape
    return fringe_sequence(width, height, [float(width), width / 5, PITCH], list(SHIFTS))


class Camera:
    """Takes the frames of a sensor; each has its own noise."""

    def __init__(self, first: int) -> None:
        self.number = first

    def white(self, twin: VirtualRig, count: int = 8) -> np.ndarray:
        """Return white frames."""
        image = np.full(twin.projector_shape, 255, np.uint8)
        self.number += count
        return np.array([twin.expose(image, 0.0, self.number - count + k) for k in range(count)])

    def phase(self, twin: VirtualRig, sensor: str, step: int, position: float = 0.0) -> PhaseResult:
        """Return the phase of a stack."""
        sequence = sequence_of(twin)
        frames = []
        for image in sequence:
            self.number += 1
            frames.append(twin.expose(image, position, self.number))
        records = [
            FrameRecord("bench", step, k, len(frames), pattern, 1000 * step + k, 0.01, sensor=sensor)
            for k, pattern in enumerate(sequence.patterns)
        ]
        return phase_step(Stack("bench", step, records, np.array(frames), step), PhaseParameters())


def calibrated(twin: VirtualRig, sensor: str, camera: Camera) -> RigModel:
    """Return the calibration of a sensor by the procedure of a user: grid, tilted grids, planes."""

    def plane(angle: float, height: float = 0.0, surface: str = "plain") -> VirtualRig:
        specimen = {"kind": "reference_plane", "surface": surface, "angle_degree": angle, "height_mm": height}
        entries = twin.configuration.model_dump() | {"specimen": specimen, "placement": {}}  # on its own stage
        return VirtualRig(VirtualRigConfiguration.from_dict(entries))

    session = CalibrationSession()
    grid_pitch = 1e-3 * twin.configuration.stage.grid_pitch_mm
    session.measure_grid(camera.white(plane(0.0, surface="grid")), grid_pitch)
    for angle in GRID_ANGLES:
        session.measure_tilted_grid(camera.white(plane(angle, surface="grid")), math.radians(angle))
    session.locate_pin_hole(0.0, Orientation.VERTICAL)
    height, width = twin.projector_shape
    identifier = f"{sensor} of {twin.configuration.seed}"
    session.begin(Setting(identifier, (width, height), sequence_of(twin).patterns[-1], sensor=sensor))
    for number, (angle, raised) in enumerate((*PLANES, PLANES[0])):
        seen = camera.phase(plane(angle, raised), sensor, number)
        session.add_plane(Plane(math.radians(angle), 1e-3 * raised, False, seen.phase, seen.sigma))
    result = session.calibrate(datetime.now(UTC))
    if not result.go:
        print(f"rig {twin.configuration.seed}, {sensor}: the calibration is NO-GO", flush=True)
    return result.model


def registered(sensors: dict[str, Sensor], arrangement: str, cameras: dict[str, Camera]) -> Registration:
    """Return the registration of the sensors by the balls."""
    radius = BALL_RADIUS[arrangement]
    features: list[Feature] = []
    for place, centres in enumerate(PLACES[arrangement]):
        specimen = {"kind": "spheres", "radius_mm": radius, "centres_mm": centres}
        first: list[Feature] = []
        for name, sensor in sensors.items():
            phase = cameras[name].phase(with_specimen(sensor.twin, specimen), name, place)
            shape = sensor.model.reconstruct(phase.phase, phase.pitch, phase.sigma)
            found = measure_balls(shape, sensor.model, 2e-3 * radius, len(centres), f"place {place}, ")
            first = first or found
            features += found if first is found else match_balls(first, found)
    return register(features, {name: each.model for name, each in sensors.items()})


def dataset_of(sensor: Sensor, name: str, phases: Sequence[PhaseResult], smooth: float) -> xr.Dataset:
    """Return the dataset of a sensor: the step after the travel of the crosshead against the one before."""
    dic, coupling = DicParameters(), CouplingParameters(z_filter_px=smooth)
    displacement, shape = DisplacementTracker(dic), ShapeTracker(coupling)
    shape.set_calibration(sensor.model)
    for step, phase in enumerate(phases):
        in_plane = displacement.step("bench", step, phase.stamp, phase.texture)
        maps = shape.step(phase, in_plane).displacement
    field = in_plane.field
    maps = maps.assign({f"displacement_sigma_{axis}": field[f"sigma_{axis}"] for axis in "xy"})
    numbers = {"reference_step": 0, "error": "", "valid_fraction": 1.0, "rms_displacement": 0.0}
    found = xr.concat([maps.assign(numbers).assign_coords(step=len(phases) - 1)], "step")
    parameters = {"dic": dic.model_dump(mode="json"), "coupling": coupling.model_dump(mode="json")}
    found.attrs = {
        "sensor": name,
        "experiment": "bench",
        "calibration": json.dumps(_plain(sensor.model)),
        "parameters": json.dumps([{"from_step": 0, "parameters": parameters}]),
    }
    return found


def _plain(model: RigModel) -> dict[str, Any]:
    """Return a calibration as a dataset contains it."""
    return json.loads(json.dumps(dataclasses.asdict(model), default=lambda each: np.asarray(each).tolist()))


def pose_scores(sensors: dict[str, Sensor], found: Registration) -> tuple[list[float], list[float], float]:
    """Return errors over sigma, their squared lengths over six, and the largest sigma of a translation [um]."""
    turn, origin = sensors[found.reference].twin.pose
    scores, lengths, largest = [], [], 0.0
    for name in found.placed:
        own, place = sensors[name].twin.pose
        pose, covariance = found.poses[name], found.pose_covariance(name)
        rotation = Rotation.from_matrix(pose.matrix @ (turn.T @ own).T).as_rotvec()
        error = np.concatenate([rotation, np.subtract(pose.translation, turn.T @ (place - origin))])
        sigma = np.sqrt(np.diag(covariance))
        scores += (error / sigma).tolist()
        lengths.append(float(error @ np.linalg.solve(covariance, error)) / 6)
        largest = max(largest, 1e6 * float(sigma[3:].max()))
    return scores, lengths, largest


def true_strain(arrangement: str, twin: VirtualRig, axes: np.ndarray) -> dict[str, float]:
    """Return the Green-Lagrange strain of the specimen along rows (around) and columns of the joined map.

    Parameters
    ----------
    arrangement, twin
        The specimen, and the reference sensor.
    axes
        Rows: directions of rows and columns of the map in the frame of the reference sensor. Those around a cylinder
        are its own, on a plate they are turned against its edges.
    """
    specimen = twin.configuration.specimen
    stretch = 1.0 + 1e3 * TRAVEL / specimen.gauge_length_mm
    narrow = 1.0 - specimen.poisson * (stretch - 1.0)
    shear = 0.0
    if arrangement == "cylinder":
        angle = math.radians(specimen.twist_degree_per_mm) * 1e3 * TRAVEL / specimen.gauge_length_mm  # per mm
        shear = angle * specimen.radius_mm * narrow
    tensor = np.array([[narrow**2 - 1, narrow * shear], [narrow * shear, stretch**2 + shear**2 - 1]]) / 2
    if arrangement == "plate":
        along = (axes[:2] @ twin.pose[0].T)[:, :2]
        tensor = along @ tensor @ along.T
    return {"e_11": tensor[0, 0], "e_22": tensor[1, 1], "e_12": tensor[0, 1]}


def near_seam(several: np.ndarray, within: int, closed: bool) -> np.ndarray:
    """Return where the number of sensors changes from one to two or back within some points."""
    wide = np.concatenate([several[:, -within - 1 :], several, several[:, : within + 1]], axis=1) if closed else several
    reach = np.ones(wide.shape, bool)
    for count in (1, 2):
        reach &= distance_transform_edt(wide != count) <= within
    return reach[:, within + 1 : -within - 1] if closed else reach


def total(scores: np.ndarray) -> np.ndarray:
    """Return the sum of squares and the number of what is measured."""
    known = scores[np.isfinite(scores)].astype(float)
    return np.array([np.sum(known**2), known.size])


def radius_of(step: xr.Dataset, sensors: dict[str, Sensor], registration: Registration) -> tuple[float, float]:
    """Return the radius of the cylinder through the joined surface minus the true one, and its uncertainty [um].

    The uncertainty is that of errors which points have in common, of poses and calibrations; each point has those of
    the sensor that looks at it most directly.
    """
    turn, origin = sensors[registration.reference].twin.pose
    points = np.stack([step[name].values.astype(float) for name in "xyz"])
    points = points[:, np.isfinite(points).all(axis=0)]
    world = turn @ points + origin[:, None]
    specimen = next(iter(sensors.values())).twin.configuration.specimen
    true = 1e-3 * specimen.radius_mm
    angle = np.arctan2(world[0], world[2])
    design = np.stack([np.ones_like(angle), np.sin(angle), np.cos(angle), world[1] * np.sin(angle)], axis=1)
    design = np.column_stack([design, world[1] * np.cos(angle)])
    fitted = np.linalg.lstsq(design, np.hypot(world[0], world[2]) - true, rcond=None)[0]
    normal = turn.T @ np.stack([np.sin(angle), 0 * angle, np.cos(angle)])
    some = slice(None, None, max(1, points.shape[1] // 4000))
    points, normal = points[:, some], normal[:, some]
    facing = [normal.T @ registration.poses[name].matrix[:, 2] for name in sensors]
    nearest = np.argmax(facing, axis=0)
    along = np.zeros((points.shape[1], len(registration.common_covariance)))
    for number, (name, sensor) in enumerate(sensors.items()):
        pose, mine = registration.poses[name], nearest == number
        own = pose.matrix.T @ (points[:, mine] - np.reshape(pose.translation, (3, 1)))
        errors = registration.position_errors(name, sensor.model, own)
        along[mine] = np.einsum("ikn,in->nk", errors, normal[:, mine])
    weights = np.linalg.lstsq(design[some], along, rcond=None)[0][0]
    return 1e6 * float(fitted[0]), 1e6 * math.sqrt(float(weights @ registration.common_covariance @ weights))


def measure(arrangement: str, seed: int, smaller: int) -> dict[float, Outcome] | str:
    """Calibrate, register and measure one rig: its figures by the filter; return why if it cannot be done."""
    twins = twins_of(arrangement, seed, smaller)
    cameras = {name: Camera(100_000 * number) for number, name in enumerate(twins)}
    try:
        sensors = {name: Sensor(twin, calibrated(twin, name, cameras[name])) for name, twin in twins.items()}
        registration = registered(sensors, arrangement, cameras)
        phases = {
            name: [cameras[name].phase(twin, name, step, at) for step, at in enumerate((0.0, TRAVEL))]
            for name, twin in twins.items()
        }
        found = {}
        for smooth in FILTERS[arrangement]:
            datasets = {name: dataset_of(sensor, name, phases[name], smooth) for name, sensor in sensors.items()}
            joined = join_sensors(datasets, registration)
            found[smooth] = figures(arrangement, sensors, registration, joined)
    except FringedicError as error:
        return f"{arrangement} {seed}: {error}"
    print(f"measured: {arrangement} {seed}", flush=True)
    return found


def figures(arrangement: str, sensors: dict[str, Sensor], registration: Registration, joined: xr.Dataset) -> Outcome:
    """Return the figures of a joined surface."""
    step = joined.isel(step=-1)
    chart = json.loads(joined.attrs["chart"])
    closed = bool(chart.get("closed", False))
    several = step["sensors"].values
    near = near_seam(several, joined.attrs["strain_window"], closed)
    strain, jump = {}, {}
    around = None
    for name, truth in true_strain(arrangement, sensors[registration.reference].twin, np.array(chart["axes"])).items():
        error = step[name].values - truth
        sigma = step[f"sigma_{name}"].values
        places = {"one": several == 1, "two": several == 2, "seam": near}
        for place, where in places.items():
            strain[f"{name} {place}"] = total((error / sigma)[where])
        two, one = (error[near & (several == count)] for count in (2, 1))
        jump[name] = 1e6 * float(np.nanmean(two) - np.nanmean(one))
        if closed and name == "e_11":
            known = np.isfinite(error)
            windows = known.sum() / joined.attrs["strain_window"] ** 2
            stated = math.sqrt(float(np.mean(sigma[known] ** 2)) / windows)
            around = 1e6 * float(error[known].mean()), 1e6 * stated
    scores, lengths, largest = pose_scores(sensors, registration)
    return Outcome(
        str(registration.verdict).startswith("GO"),
        scores,
        largest,
        lengths,
        {name: total(step[f"overlap_{name}"].values) for name in ("shape", "u", "v", "w")},
        strain,
        jump,
        radius_of(step, sensors, registration) if closed else None,
        around,
    )


class Page:
    """Rows of the table."""

    def __init__(self) -> None:
        self.rows: list[tuple[str, str, str]] = []

    def add(self, figure: str, measured: str, target: str = "") -> None:
        """Take a row, and show it."""
        self.rows.append((figure, measured, target))
        print(f"{figure:84} {measured:>34} {target:>12}", flush=True)


def pooled(parts: Iterable[np.ndarray]) -> str:
    """Return the RMS of all scores of several rigs, and the range of those of each."""
    known = [each for each in parts if each[1]]
    whole = np.sum(known, axis=0)
    each = np.sqrt([squares / count for squares, count in known])
    return f"{math.sqrt(whole[0] / whole[1]):.2f} ({each.min():.2f} to {each.max():.2f})"


def mean_of(values: Sequence[float], unit: str) -> str:
    """Return a mean over the rigs with its standard uncertainty by their scatter."""
    if len(values) < 2:
        return f"{values[0]:+.1f} {unit}"
    return f"{np.mean(values):+.1f} ± {np.std(values, ddof=1) / math.sqrt(len(values)):.1f} {unit}"


def fill_poses(page: Page, arrangement: str, found: Sequence[Outcome]) -> None:
    """Add the rows of the registration of an arrangement."""
    rigs = counted(arrangement, found)
    scores = np.concatenate([each.pose for each in found])
    lengths = np.concatenate([each.mahalanobis for each in found])
    page.add(f"{rigs}: registrations that are GO", f"{sum(each.go for each in found)}")
    page.add(
        f"{rigs}: error of the pose over sigma, RMS of {scores.size} numbers, largest",
        f"{math.sqrt(np.mean(scores**2)):.2f}, {np.abs(scores).max():.1f}",
        "0.8 to 1.25",
    )
    page.add(
        f"{rigs}: error of the pose over its covariance, root of the mean square per number",
        f"{math.sqrt(lengths.mean()):.2f}",
        "0.8 to 1.25",
    )
    page.add(f"{rigs}: stated standard uncertainty of the position, median", f"{median(found):.0f} µm")


def counted(arrangement: str, found: Sequence[Outcome]) -> str:
    """Return how many rigs."""
    return f"{len(found)} {arrangement}s" if len(found) > 1 else f"one {arrangement}"


def fill(page: Page, arrangement: str, smooth: float, found: Sequence[Outcome]) -> None:
    """Add the rows of the joined surfaces of an arrangement."""
    rigs = f"{counted(arrangement, found)}, filter {smooth:g} px"
    for name in ("shape", "u", "v", "w"):
        page.add(
            f"{rigs}: difference of {name} in the overlap over sigma, together (single rigs)",
            pooled(each.overlap[name] for each in found),
            "0.9 to 1.1",
        )
    places = {"seam": "next to the seam", "one": "of one sensor", "two": "of two sensors"}
    for strain in ("e_11", "e_22", "e_12"):
        for place, words in places.items():
            page.add(
                f"{rigs}: z-score of {strain} {words}, together (single rigs)",
                pooled(each.strain[f"{strain} {place}"] for each in found),
                "0.9 to 1.1",
            )
    for strain in ("e_11", "e_22", "e_12"):
        steps = [each.step[strain] for each in found]
        page.add(f"{rigs}: step of {strain} at the seam", mean_of(steps, "µstrain"), "none")
    if arrangement == "cylinder":
        fill_circumference(page, rigs, found)


def median(found: Sequence[Outcome]) -> float:
    """Return the median of the largest standard uncertainty of a position [um]."""
    return float(np.median([each.pose_um for each in found]))


def fill_circumference(page: Page, rigs: str, found: Sequence[Outcome]) -> None:
    """Add the rows of the closed circumference."""
    names = {"radius": "radius of the surface", "around": "mean strain around the circumference"}
    for name, words in names.items():
        unit = "µm" if name == "radius" else "µstrain"
        values = np.array([getattr(each, name) for each in found])
        error, sigma = values.T
        page.add(f"{rigs}: error of the {words}", mean_of(error.tolist(), unit))
        page.add(f"{rigs}: stated standard uncertainty of it, RMS", f"{math.sqrt(np.mean(sigma**2)):.1f} {unit}")
        page.add(
            f"{rigs}: error of the {words} over sigma, RMS", f"{math.sqrt(np.mean((error / sigma) ** 2)):.2f}", "<= 1"
        )


def write(page: Page, smaller: dict[str, int], failed: Sequence[str], minutes: float, note: str) -> None:
    """Write the page; the note is empty if everything was measured that is planned."""
    rows = "\n".join(f"| {figure} | {measured} | {target} |" for figure, measured, target in page.rows)
    sizes = {name: f"{1280 // each}x{960 // each} px" for name, each in smaller.items()}
    without = (
        "\nRigs without a result, as a ball lies at the border of a view or for another reason:\n\n"
        + "\n".join(f"- {each}" for each in failed)
        + "\n"
        if failed
        else ""
    )
    PAGE.write_text(
        f"""# Several sensors: measured figures

This page shows whether the poses of several sensors, the difference of their surfaces in the overlap and the strain
across the seam are as uncertain as stated. The method is explained in [Several sensors](../sensors.md).
`python benchmarks/sensors.py` measures the figures again and writes this page.
{note}
*Measured on {date.today()} with frames of the virtual rig, {minutes:.0f} minutes. Every rig has random poses (1.5 mm
and 2 degrees about the arrangement), alignments and lenses of camera and projector. Plates: two sensors,
{sizes["plate"]}. Cylinders: four sensors around the full circumference, radius 20 mm, {sizes["cylinder"]}. 8 bits, read
noise 1 grey level, shot noise variance 0.02 per grey level. Each sensor is calibrated from its frames: the grid at 0
and ±12 degrees, nine planes; then three balls in three places register them. Pitches: width of the projector, a fifth
of it and 10 px with 4, 4 and 8 shifts. Travel of the crosshead 0.2 mm: tension of a flat plate, tension and torsion of
a cylinder. Filter: standard deviation of the Gaussian that smooths the surfaces (`coupling.z_filter_px`, 2 px by
default); the windows of correlation and strain are the defaults. Figures together are the RMS over all points of all
rigs; in brackets those of the rigs with the smallest and the largest one. Next to the seam: within one window of the
strain on both sides of the border between one and two sensors; the step is the mean error of the points of two sensors
minus that of the points of one, with its standard uncertainty by the scatter of the rigs.*

| figure | measured | target |
|---|---:|---:|
{rows}
{without}
The errors of a calibration are common to all points of a rig, so that the difference of the shape is larger in one rig
than in another. The filter of the height moves a convex surface inwards. Reference positions are corrected for that,
except for a part of it at a grazing angle, which no uncertainty contains: both sensors of an overlap on the cylinder
see it at about 45 degrees, and the rows of two filters show it. A window of the strain is large beside the part
that two sensors see, so that its z-scores come from few independent windows. The stated uncertainty of the mean strain
assumes that windows which do not overlap are independent.
"""
    )


def main() -> None:
    """Measure the rigs and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few rigs, small images")
    quick = parser.parse_args().quick
    smaller = dict.fromkeys(SMALLER, QUICK_SMALLER) if quick else SMALLER
    counts = {
        "cylinder": QUICK_CYLINDERS if quick else CYLINDERS,  # they last longer and come first
        "plate": QUICK_PLATES if quick else PLATES,
    }
    begin = time.perf_counter()
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        waiting = {
            name: [pool.submit(measure, name, SEED + k, smaller[name]) for k in range(count)]
            for name, count in counts.items()
        }
        try:
            wait([each for of_kind in waiting.values() for each in of_kind])
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
    ended = {
        name: [each.result() for each in of_kind if not each.cancelled() and each.exception() is None]
        for name, of_kind in waiting.items()
    }
    note = "\nA short form with few rigs and small images (`--quick`).\n" if quick else early_end(counts, ended)
    report(ended, smaller, (time.perf_counter() - begin) / 60, note)


Results = dict[str, list[dict[float, Outcome] | str]]


def early_end(counts: dict[str, int], results: Results) -> str:
    """Return the note of a page that lacks rigs because the measurement was ended; empty if it lacks none."""
    parts = [f"{len(results[name])} of {count} {name}s" for name, count in counts.items() if len(results[name]) < count]
    return f"\nThe measurement was ended early, after {' and '.join(parts)}.\n" if parts else ""


def report(results: Results, smaller: dict[str, int], minutes: float, note: str) -> None:
    """Print the rows and write the page."""
    page, failed = Page(), []
    for name in ("plate", "cylinder"):
        failed += [each for each in results[name] if isinstance(each, str)]
        found = [each for each in results[name] if not isinstance(each, str)]
        if not found:
            continue
        fill_poses(page, name, [each[FILTERS[name][0]] for each in found])
        for smooth in FILTERS[name]:
            fill(page, name, smooth, [each[smooth] for each in found])
    print(*failed, sep="\n", flush=True)
    write(page, smaller, failed, minutes, note)


if __name__ == "__main__":
    main()
