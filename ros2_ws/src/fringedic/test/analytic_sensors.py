"""Datasets of sensors around a plate or a cylinder, written down from lines of sight without any rendering."""

from __future__ import annotations

import dataclasses
import json
import math
from types import SimpleNamespace

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from fringedic.patterns.pattern import Orientation
from fringedic.rig.model import RigModel
from fringedic.sensors.features import Feature, FeatureKind, errors_at

RADIUS = 0.02
STRAIN, POISSON = 2e-3, 0.3
ROWS, COLUMNS = 120, 160
NOISE = 3e-6  # [m] of heights
IN_PLANE = 1e-6  # [px] of displacements: white noise, negligible beside that of the heights
PLACES = 1e-3 * np.array(
    [
        ((-16.0, -9.0, 0.0), (15.0, -11.0, 3.0), (-2.0, 12.0, -4.0)),
        ((-12.0, -9.0, 8.0), (13.0, -11.0, -3.0), (-1.0, 11.0, 4.0)),
        ((-3.0, -9.0, -8.0), (17.0, -7.0, 3.0), (-5.0, 13.0, -9.0)),
    ]
)
"""Centres of three balls [m] in three places."""
_UNCERTAIN = {
    "camera_distance": 6e-5,
    "pixel_size": 3e-9,
    "camera_tilt_x": 6e-5,
    "camera_tilt_y": 6e-5,
    "projector_x": 3e-5,
    "projector_z": 3e-5,
    "projector_yaw": 3e-5,
    "projector_focal_length": 0.15,
}


class Sensors:
    """Sensors with the errors of their calibrations, drawn from the covariance that these state."""

    def __init__(self, kind: str, seed: int) -> None:
        self.kind = kind
        self.generator = np.random.default_rng(seed)
        if kind == "plate":
            angles = {"left": (-9.0, -0.019), "right": (9.0, 0.019)}
            self.poses = {
                name: (Rotation.from_euler("y", angle, degrees=True), np.array([x, 0.0, 0.0]))
                for name, (angle, x) in angles.items()
            }
        else:
            self.poses = {
                name: (
                    Rotation.from_euler("y", angle, degrees=True),
                    RADIUS * np.array([math.sin(math.radians(angle)), 0.0, math.cos(math.radians(angle))]),
                )
                for name, angle in zip("abcd", (0, 90, 180, -90), strict=True)
            }
        self.models = {name: _model(name) for name in self.poses}
        self._drawn = {name: self.generator.standard_normal(len(_UNCERTAIN)) for name in self.poses}

    def error(self, sensor: str, points: np.ndarray) -> np.ndarray:
        """Return the error of points (3, ...) by the calibration [m]."""
        errors = errors_at(self.models[sensor], np.nan_to_num(points).reshape(3, -1), Orientation.VERTICAL)
        return np.tensordot(self._drawn[sensor], errors, axes=1).reshape(points.shape)

    def features(self) -> list[Feature]:
        """Return balls that neighbouring sensors measure."""
        names = list(self.poses)
        around = len(names) > 2
        found = []
        for first in range(len(names) if around else 1):
            for place, centres in enumerate(PLACES):
                for sensor in (names[first], names[(first + 1) % len(names)]):
                    found += [self.ball(sensor, f"{first}.{place}.{ball}", at) for ball, at in enumerate(centres)]
        return found

    def ball(self, sensor: str, name: str, centre: np.ndarray) -> Feature:
        """Return a ball [m] that a sensor measured."""
        rotation, translation = self.poses[sensor]
        sigma = np.array([1e-6, 1e-6, 2e-6])
        own = rotation.inv().apply(centre - translation)
        seen = own + self.error(sensor, own[:, None])[:, 0] + sigma * self.generator.standard_normal(3)
        errors = errors_at(self.models[sensor], seen[:, None], Orientation.VERTICAL)[..., 0]
        return Feature(FeatureKind.BALL, sensor, name, seen, np.eye(3), np.diag(sigma**2), errors, 500, 1e-6)

    def displacement(self, points: np.ndarray) -> np.ndarray:
        """Return the displacement (3, ...) [m] of points in the frame of the specimen: tension along y."""
        across = -POISSON * STRAIN * points[0], -POISSON * STRAIN * points[2]
        return np.stack([across[0], STRAIN * points[1], across[1] if self.kind == "cylinder" else 0 * points[2]])

    def dataset(self, sensor: str) -> xr.Dataset:
        """Return the dataset of a sensor with one loaded step."""
        rotation, translation = self.poses[sensor]
        turn, draw = rotation.as_matrix(), self.generator.standard_normal
        points = np.tensordot(turn.T, self._seen(sensor) - translation[:, None, None], axes=1)
        world = np.tensordot(turn, points, axes=1) + translation[:, None, None]
        moved = points + np.tensordot(turn.T, self.displacement(world), axes=1)
        before, after = (
            np.stack([at[0] / (at[2] - 0.4), at[1] / (at[2] - 0.4), 1 + 0 * at[2]]) for at in (points, moved)
        )
        by_pixel = [np.gradient(moved, axis=axis) for axis in (2, 1)]
        measured = points + self.error(sensor, points) + before * (NOISE * draw((ROWS, COLUMNS)))
        deformed = moved + self.error(sensor, moved) + after * (NOISE * draw((ROWS, COLUMNS)))
        for change in by_pixel:
            deformed = deformed + change * (IN_PLANE * draw((ROWS, COLUMNS)))
        own = self.models[sensor]
        common = [errors_at(own, np.nan_to_num(at).reshape(3, -1), Orientation.VERTICAL) for at in (points, moved)]
        variance = ((common[1] - common[0]) ** 2).sum(axis=0).reshape(points.shape)
        variance += NOISE**2 * (before**2 + after**2) + IN_PLANE**2 * (by_pixel[0] ** 2 + by_pixel[1] ** 2)
        known = np.where(np.isfinite(deformed).all(axis=0), 1.0, np.nan)
        maps = dict(zip("xyzuvw", (*measured, *(deformed - measured)), strict=True))
        maps |= {f"sigma_{name}": np.sqrt(each) for name, each in zip("uvw", variance, strict=True)}
        maps |= dict.fromkeys(("noise_z", "noise_z_deformed"), NOISE * known)
        maps |= dict.fromkeys(("displacement_sigma_x", "displacement_sigma_y"), IN_PLANE * known)
        found = xr.Dataset(
            {name: (("step", "row", "column"), values[None]) for name, values in maps.items()},
            {"step": [1], "row": np.arange(ROWS), "column": np.arange(COLUMNS)},
        )
        numbers = {"reference_step": 0, "error": "", "valid_fraction": 1.0, "rms_displacement": 0.0}
        found = found.assign({name: ("step", [value]) for name, value in numbers.items()})
        parameters = {"dic": {"window": 32, "method": "dense"}, "coupling": {"z_filter_px": 0.0, "strain_window_px": 9}}
        found.attrs = {
            "sensor": sensor,
            "experiment": self.kind,
            "calibration": json.dumps(dataclasses.asdict(own)),
            "parameters": json.dumps([{"from_step": 0, "parameters": parameters}]),
        }
        return found

    def _seen(self, sensor: str) -> np.ndarray:
        """Return the points that the pixels see (3, row, column) in the frame of the specimen, NaN beside it."""
        rotation, translation = self.poses[sensor]
        column, row = np.meshgrid(np.arange(float(COLUMNS)), np.arange(float(ROWS)))
        rays = np.tensordot(self.models[sensor].ray_matrix, np.stack([column, row, np.ones_like(row)]), axes=1)
        rays = np.tensordot(rotation.as_matrix(), rays, axes=1)
        camera = rotation.apply([0.0, 0.0, 0.4]) + translation
        if self.kind == "plate":
            points = camera[:, None, None] - camera[2] / rays[2] * rays
            points[:, (np.abs(points[0]) > 0.045) | (np.abs(points[1]) > 0.02)] = np.nan
            return np.asarray(points)
        a, b = rays[0] ** 2 + rays[2] ** 2, rays[0] * camera[0] + rays[2] * camera[2]
        square = b * b - a * (camera[0] ** 2 + camera[2] ** 2 - RADIUS**2)
        along = np.where(square > 0, -(b + np.sqrt(np.maximum(square, 0.0))) / a, np.nan)
        points = camera[:, None, None] + along * rays
        facing = -(points[0] * rays[0] + points[2] * rays[2]) / RADIUS / np.linalg.norm(rays, axis=0)
        points[:, ~(facing > 0.42) | (np.abs(points[1]) > 0.02)] = np.nan
        return np.asarray(points)

    def in_frame_of_specimen(self, step: xr.Dataset) -> SimpleNamespace:
        """Return positions and displacements (3, row, column) of a joined step."""
        rotation, translation = next(iter(self.poses.values()))
        points, motion = (np.stack([step[name].values.astype(float) for name in names]) for names in ("xyz", "uvw"))
        turn = rotation.as_matrix()
        at = np.tensordot(turn, points, axes=1) + translation[:, None, None]
        return SimpleNamespace(points=at, motion=np.tensordot(turn, motion, axes=1))


def _model(sensor: str) -> RigModel:
    return RigModel(
        camera_width=COLUMNS,
        camera_height=ROWS,
        camera_distance=0.4,
        pixel_size=4e-4,
        pixel_aspect=1.0,
        principal_column=(COLUMNS - 1) / 2,
        principal_row=(ROWS - 1) / 2,
        projector_width=200,
        projector_height=150,
        projector_position=(0.18, 0.0, 0.38),
        projector_focal_length=850.0,
        projector_principal_column=99.5,
        projector_principal_row=74.5,
        sensor=sensor,
        identifier=f"of {sensor}",
        parameter_names=tuple(_UNCERTAIN),
        covariance=tuple(np.diag(np.square(list(_UNCERTAIN.values()))).ravel()),
    )
