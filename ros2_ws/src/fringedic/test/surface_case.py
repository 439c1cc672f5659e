"""A surface before and after a motion as exact phases and image displacements, and clouds of known functions."""

from collections.abc import Callable

import numpy as np
import xarray as xr

from fringedic.rig.model import RigModel

WIDTH, HEIGHT = 240, 180
H0 = 0.6
PITCH = 10.0
RIG = RigModel(
    camera_width=WIDTH,
    camera_height=HEIGHT,
    camera_distance=H0,
    pixel_size=50e-6,
    pixel_aspect=1.01,
    principal_column=-200.0,  # a corner of a large field, where perspective is strong
    principal_row=400.0,
    camera_tilt_x=0.003,
    camera_tilt_y=-0.002,
    projector_width=800,
    projector_height=600,
    projector_position=(0.2, 0.01, 0.55),
    projector_rotation=(0.003, 0.002, -0.002),
    projector_focal_length=5000.0,
    projector_principal_column=399.5,
    projector_principal_row=299.5,
)
Field = Callable[[np.ndarray, np.ndarray], np.ndarray]
Motion = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]
COLUMN, ROW = np.meshgrid(np.arange(float(WIDTH)), np.arange(float(HEIGHT)))


def lines_of_sight(column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    direction = np.stack([column, row, np.ones_like(row)], axis=-1) @ RIG.ray_matrix.T
    return direction[..., 0] / direction[..., 2], direction[..., 1] / direction[..., 2]


def pixel_of(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    seen = np.stack([x, y, z - H0], axis=-1) @ np.linalg.inv(RIG.ray_matrix).T
    return seen[..., 0] / seen[..., 2], seen[..., 1] / seen[..., 2]


def seen_point(surface: Field, column: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    ray_x, ray_y = lines_of_sight(column, row)
    z = np.zeros_like(row)
    for _ in range(60):
        before, z = z, surface(ray_x * (z - H0), ray_y * (z - H0))
        if np.abs(z - before).max() < 1e-16:
            break
    return ray_x * (z - H0), ray_y * (z - H0), z


def flat(x: np.ndarray, _: np.ndarray) -> np.ndarray:
    return 0 * x


def at_rest(x: np.ndarray, _y: np.ndarray, _z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return x * 0, x * 0, x * 0


def relief(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 2e-3 * np.cos(2 * np.pi * x / 0.03 + 1) * np.cos(2 * np.pi * y / 0.04) + 0.05 * x


def motion(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    u = 0.15e-3 + 3e-3 * x + 0.01 * z - 1e-3 * y
    v = -0.21e-3 + 1e-3 * x - 2e-3 * y
    return u, v, 0.12e-3 + 0.1e-3 * np.sin(2 * np.pi * x / 0.03) - 0.01 * x


class Case:
    """A surface before and after a motion, as exact phases and image displacements."""

    def __init__(self, surface: Field = relief, moves: Motion = motion) -> None:
        self.x, self.y, self.z = seen_point(surface, COLUMN, ROW)
        self.u, self.v, self.w = moves(self.x, self.y, self.z)
        column, row = pixel_of(self.x + self.u, self.y + self.v, self.z + self.w)
        self.displacement_x, self.displacement_y = column - COLUMN, row - ROW
        # the material point that each pixel sees after the motion
        origin_column, origin_row = COLUMN.copy(), ROW.copy()
        for _ in range(30):
            x, y, z = seen_point(surface, origin_column, origin_row)
            u, v, w = moves(x, y, z)
            column, row = pixel_of(x + u, y + v, z + w)
            origin_column += COLUMN - column
            origin_row += ROW - row
            if max(np.abs(COLUMN - column).max(), np.abs(ROW - row).max()) < 1e-11:
                break
        self.phase = RIG.phase(self.x, self.y, self.z, PITCH)
        self.phase_after = RIG.phase(x + u, y + v, z + w, PITCH)

    def measured(self, fringe: float, pixel: float, seed: int = 0) -> tuple[xr.Dataset, xr.Dataset, xr.Dataset]:
        """Shapes and displacement with noise of so many fringes and pixels."""
        rng = np.random.default_rng(seed)
        sigma = np.full(self.phase.shape, 2 * np.pi * fringe, np.float32)
        shapes = [
            RIG.reconstruct((phase + rng.normal(size=phase.shape) * sigma).astype(np.float32), PITCH, sigma)
            for phase in (self.phase, self.phase_after)
        ]
        fields = {
            "displacement_x": self.displacement_x + pixel * rng.normal(size=self.phase.shape),
            "displacement_y": self.displacement_y + pixel * rng.normal(size=self.phase.shape),
            "sigma_x": np.full(self.phase.shape, pixel),
            "sigma_y": np.full(self.phase.shape, pixel),
        }
        displacement = xr.Dataset(
            {name: (("row", "column"), field.astype(np.float32)) for name, field in fields.items()},
            coords={"row": np.arange(HEIGHT), "column": np.arange(WIDTH)},
        )
        return shapes[0], shapes[1], displacement


def cloud_of(
    surface: Field, moves: Motion, rows: int = 60, columns: int = 80, size: float = 5e-5
) -> tuple[xr.Dataset, np.ndarray, np.ndarray]:
    x, y = np.meshgrid(size * (np.arange(columns) - 31.5), -size * (np.arange(rows) - 20.0))
    z = surface(x, y)
    fields = dict(zip("xyzuvw", (x, y, z, *moves(x, y, z)), strict=True))
    return (
        xr.Dataset(
            {name: (("row", "column"), field) for name, field in fields.items()},
            coords={"row": np.arange(rows), "column": np.arange(columns)},
        ),
        x,
        y,
    )
