"""The virtual rig (digital twin): images of its camera, with the exact shape and displacement."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from typing import Any, Self

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, gaussian_filter

from fringedic.errors import CrossheadRangeError, ImageError
from fringedic.virtual_rig import exposure, tracing
from fringedic.virtual_rig.configuration import (
    CylinderSpecimen,
    ReferencePlaneSpecimen,
    RigidSpecimen,
    SpheresSpecimen,
    VirtualRigConfiguration,
    preset,
)
from fringedic.virtual_rig.motions import Motion
from fringedic.virtual_rig.optics import (
    camera_optics,
    camera_pin_hole,
    placement_matrices,
    projector_optics,
    projector_pin_hole,
)
from fringedic.virtual_rig.specimens import make_surface
from fringedic.virtual_rig.texture import make_texture, reflectance_at

Map = NDArray[np.float64]

_KEPT_VIEWS = 2  # of the reference and the deformed state
_INSTANTS = 5  # of an exposure that a motion blurs
_SHARP = 0.02  # [px] of motion during an exposure that blurs nothing
# A pixel whose material point projects farther than this from its centre counts as not found [px]: a thousand times
# the limit of convergence.
_TOLERANCE = 1e-6
# Parts that may throw shadows are searched at every pixel and, outside of the camera's view, on a grid over the
# specimen of this many points along each side; they are marked in blocks of projector pixels.
_SHADOW_GRID = 400
_SHADOW_BLOCK = 4


@dataclass
class View:
    """Quantities that are the same for all frames at one crosshead position; NaN beside the specimen.

    Attributes
    ----------
    X, Y : (row, column)
        Material coordinates of the point that each pixel sees [m].
    projector_column, projector_row : (row, column)
        Projector pixel coordinates of the point.
    lit : (row, column) bool
        The projector sees the point.
    gain, offset : (row, column) float32
        Grey level = gain * projected light + offset.
    residual
        Largest distance between a pixel and the projection of its point [px].
    """

    X: Map
    Y: Map
    projector_column: Map
    projector_row: Map
    lit: NDArray[np.bool_]
    gain: NDArray[np.float32]
    offset: NDArray[np.float32]
    residual: float
    _weights: dict[str, tuple[NDArray[np.int32], NDArray[np.float32]]] = field(default_factory=dict)
    _edges: dict[str, NDArray[np.float32]] = field(default_factory=dict)

    def weights(self, axis: str, size: int, defocus: float) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Return the first projector column (or row) that lights each pixel, and the weights from there on; cached."""
        if axis not in self._weights:
            coordinate = self._coordinate(axis)
            first = np.empty(coordinate.shape, np.int32)
            weights = np.empty((*coordinate.shape, exposure.taps_of(defocus)), np.float32)
            exposure.spread_weights(coordinate, defocus, size, first, weights)
            self._weights[axis] = first, weights
        return self._weights[axis]

    def edge(self, axis: str, size: int, defocus: float) -> NDArray[np.float32]:
        """Return the sum of the weights of all projector columns (or rows) at each pixel; cached."""
        if axis not in self._edges:
            self._edges[axis] = np.empty(self.lit.shape, np.float32)
            exposure.edge_weight(self._coordinate(axis), defocus, size, self._edges[axis])
        return self._edges[axis]

    def _coordinate(self, axis: str) -> Map:
        return self.projector_column if axis == "column" else self.projector_row


class VirtualRig:
    """Digital twin of projector, camera and specimen.

    Every camera pixel sees exactly one material point, found by solving the projection of the deformed surface. Light
    and texture are analytic functions at that point. The crosshead position [m] is the load; the specimen is undeformed
    at 0. A camera ray is assumed to meet the specimen once, so that the specimen must not occlude itself for the
    camera. It may occlude itself for the projector, which gives shadows.

    Parameters
    ----------
    configuration
        The rig; see `VirtualRigConfiguration` and `from_preset`.

    Examples
    --------
    >>> rig = VirtualRig.from_preset("plate", size="tiny")
    >>> image = rig.expose(np.full(rig.projector_shape, 250, np.uint8), position=0.0, frame=0)
    >>> image.shape, image.dtype
    ((120, 160), dtype('uint8'))
    """

    def __init__(self, configuration: VirtualRigConfiguration) -> None:
        self.configuration = configuration
        self._camera = camera_pin_hole(configuration.camera)
        self._projector = projector_pin_hole(configuration.projector)
        self._surface = make_surface(
            configuration.specimen,
            configuration.stage,
            configuration.texture,
            configuration.seed,
            configuration.placement,
        )
        is_plane = isinstance(configuration.specimen, ReferencePlaneSpecimen)
        self._texture = (
            None if is_plane else make_texture(configuration.texture, self._surface.outline, configuration.seed)
        )
        self._views: OrderedDict[float, View] = OrderedDict()
        self._latest_light: tuple[View, NDArray[np.uint8], NDArray[np.float32]] | None = None

    @classmethod
    def from_preset(cls, name: str, *, size: str = "full", ideal: bool = False, seed: int = 0) -> Self:
        """Return a rig of a preset.

        Parameters
        ----------
        name
            ``plate``, ``skin``, ``leather``, ``cylinder``, ``rigid``, ``plane``, ``sphere``, ``stepped`` or
            ``reference_plane``.
        size
            ``full`` (camera 1280x960 px, projector 800x600 px), ``small`` (a quarter) or ``tiny`` (an eighth).
        ideal
            Without errors of alignment and without noise.
        seed
            Seed of texture and noise.

        Raises
        ------
        VirtualRigError
            The name or the size is unknown.
        """
        return cls(VirtualRigConfiguration.from_dict({**preset(name, size=size, ideal=ideal), "seed": seed}))

    def with_specimen(self, specimen: Mapping[str, Any]) -> Self:
        """Return a rig of the same camera, projector, sensor and stage with another specimen.

        Parameters
        ----------
        specimen
            Entries of the section ``specimen``, with its ``kind``; such as ``{"kind": "reference_plane", "surface":
            "grid", "angle_degree": 10.0}``.

        Raises
        ------
        VirtualRigError
            An entry is unknown, missing or out of range.
        """
        entries = self.configuration.model_dump() | {"specimen": dict(specimen)}
        return type(self)(VirtualRigConfiguration.from_dict(entries))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the camera's image."""
        return self.configuration.camera.rows, self.configuration.camera.columns

    @property
    def projector_shape(self) -> tuple[int, int]:
        """Rows and columns of the projector's image."""
        return self.configuration.projector.rows, self.configuration.projector.columns

    @property
    def maximum_position(self) -> float:
        """Largest crosshead position [m]."""
        return 1e-3 * self.configuration.load_frame.maximum_position_mm

    def optics(self) -> dict[str, Any]:
        """Return the true optical parameters [m, rad, px] with the names of ``fringedic_msgs/RigCalibration``.

        They do not contain the lens, see `straight_pixels`.
        """
        return {
            "model": "general",
            **camera_optics(self.configuration.camera),
            **projector_optics(self.configuration.projector),
        }

    def straight_pixels(self) -> tuple[Map, Map]:
        """Return column and row [px] at which the camera would see, without its lens, what it sees at each pixel."""
        column, row = np.empty(self.shape), np.empty(self.shape)
        tracing.straight_pixels(self._camera, column, row)
        return column, row

    def expose(
        self, projector_image: NDArray[np.uint8], position: float, frame: int, *, exposure_factor: float = 1.0
    ) -> NDArray[np.unsignedinteger]:
        """Take one picture.

        Parameters
        ----------
        projector_image : uint8 (projector rows, projector columns)
            What the projector shows.
        position
            Crosshead position [m].
        frame
            Number of the frame; together with the rig's seed it determines the noise.
        exposure_factor
            Exposure time relative to the one of the sensor's white level.

        Returns
        -------
        ndarray
            Grey levels, uint8 (row, column), or uint16 for cameras of more than 8 bits.

        Raises
        ------
        ImageError
            The image is not as large as the projector's.
        CrossheadRangeError
            The position is outside the specimen's range.
        """
        return self.expose_parts([(projector_image, 1.0)], position, frame, exposure_factor=exposure_factor)

    def expose_beside(
        self,
        projector_image: NDArray[np.uint8],
        position: float,
        frame: int,
        others: Sequence[tuple[VirtualRig, NDArray[np.uint8]]],
    ) -> NDArray[np.unsignedinteger]:
        """Take one picture while projectors of other sensors on the same specimen light it, too (crosstalk).

        Parameters
        ----------
        projector_image, position, frame
            See `expose`, also for result and errors.
        others
            The other sensors, each with the image that its projector shows.
        """
        level = self._level([(projector_image, 1.0)], position)
        for other, image in others:
            view = self._view_of(other, position)
            level = level + view.gain * other._light(view, image)  # noqa: SLF001 (the same class)
        return self._sense(level, 1.0, frame)

    def _view_of(self, other: VirtualRig, position: float) -> View:
        """Return what this camera sees in the light of another sensor's projector."""
        own, (rotation, translation), (turned, moved) = self.view(position), self.pose, other.pose
        projector = other._projector.copy()
        distance, height = np.linalg.norm(projector[:3]), projector[2]
        projector[:3] = rotation.T @ (turned @ projector[:3] + moved - translation)
        projector[3:12] = (rotation.T @ turned @ projector[3:12].reshape(3, 3)).ravel()
        # the irradiance is relative to that at the origin of the other sensor
        brighter = distance**3 / height * projector[2] / np.linalg.norm(projector[:3]) ** 3
        maps = tracing.LightMaps(*(np.empty_like(own.X) for _ in range(4)))
        tracing.light_geometry(self._camera, projector, self._surface.deformed(position), own.X, own.Y, maps)
        irradiance = brighter * maps.irradiance
        lit = irradiance > 0.0
        sensor = self.configuration.sensor
        white = own.offset / np.float32(max(sensor.ambient_light, 1e-9))  # the surface in the light of level 1
        gain = np.where(lit, white * irradiance, 0.0).astype(np.float32)
        return View(own.X, own.Y, maps.column, maps.row, lit, gain, np.zeros_like(gain), own.residual)

    def expose_parts(
        self,
        parts: Sequence[tuple[NDArray[np.uint8], float]],
        position: float,
        frame: int,
        *,
        exposure_factor: float = 1.0,
        travel: float = 0.0,
    ) -> NDArray[np.unsignedinteger]:
        """Take one picture during which the light of the projector changes, or the crosshead moves.

        Parameters
        ----------
        parts
            Images of the projector, uint8 (projector rows, projector columns), each with its part of the light of a
            whole exposure; see `pattern_weights`.
        position, frame, exposure_factor
            See `expose`, also for result and errors; the position is that of the middle of the exposure.
        travel
            Way of the crosshead during the exposure, at constant speed [m]; below a fiftieth of a pixel nothing blurs.
        """
        instants = _INSTANTS if abs(travel) > _SHARP * 1e-6 * self.configuration.camera.pixel_size_um else 1
        positions = np.clip(position + travel * _middles(instants), 0.0, self.maximum_position)
        return self._sense(self._mean_level(parts, positions if travel else [position]), exposure_factor, frame)

    def expose_moving(
        self,
        projector_image: NDArray[np.uint8],
        motion: Motion,
        time: float,
        exposure_time: float,
        frame: int,
        *,
        instants: int = _INSTANTS,
    ) -> NDArray[np.unsignedinteger]:
        """Take one picture while the crosshead moves: the mean of several instants of the exposure (motion blur).

        Parameters
        ----------
        projector_image, frame
            See `expose`, also for result and errors.
        motion
            Position of the crosshead as a function of time.
        time, exposure_time
            Middle and duration of the exposure [s].
        instants
            Number of instants, at the middles of equal parts of the exposure.

        Examples
        --------
        >>> from fringedic.virtual_rig import ConstantRate
        >>> rig = VirtualRig.from_preset("plate", size="tiny")
        >>> white = np.full(rig.projector_shape, 250, np.uint8)
        >>> still = rig.expose_moving(white, ConstantRate(start=1e-4, rate=0.0), time=2.0, exposure_time=0.01, frame=0)
        >>> bool((still == rig.expose(white, position=1e-4, frame=0)).all())
        True
        """
        positions = [motion.position(float(time + exposure_time * part)) for part in _middles(instants)]
        return self._sense(self._mean_level([(projector_image, 1.0)], positions), 1.0, frame)

    def _mean_level(
        self, parts: Sequence[tuple[NDArray[np.uint8], float]], positions: Sequence[float] | NDArray[np.float64]
    ) -> NDArray[np.float32]:
        """Return the mean of the grey levels at several positions of the crosshead, see `_level`."""
        if max(positions) == min(positions):
            return self._level(parts, positions[0])
        levels = np.zeros(self.shape)
        for position in positions:
            levels += self._level(parts, position)
        return (levels / len(positions)).astype(np.float32)

    def _level(self, parts: Sequence[tuple[NDArray[np.uint8], float]], position: float) -> NDArray[np.float32]:
        """Return the grey levels of a sharp lens without noise, for the exposure time of the white level."""
        view = self.view(position)
        light = np.zeros(self.shape, np.float32)
        for projector_image, weight in parts:
            if projector_image.shape != self.projector_shape or projector_image.dtype != np.uint8:
                raise ImageError(
                    f"the projector shows uint8 images of {self.projector_shape} rows and columns, "
                    f"not {projector_image.dtype} of {projector_image.shape}"
                )
            if weight > 0.0:
                light += np.float32(weight) * self._light(view, projector_image)
        return view.gain * light + view.offset

    def _sense(self, level: NDArray[np.float32], exposure_factor: float, frame: int) -> NDArray[np.unsignedinteger]:
        """Return the frame of the sensor behind the lens."""
        sensor = self.configuration.sensor
        image = np.empty(self.shape, np.uint8 if sensor.bits == 8 else np.uint16)
        level = np.float32(exposure_factor) * level
        if sensor.lens_blur_px > 0.0:
            level = gaussian_filter(level, sensor.lens_blur_px, mode="nearest")
        exposure.expose_sensor(
            level,
            sensor.read_noise_grey_level**2,
            sensor.shot_noise_grey_level,
            sensor.response,
            2**sensor.bits - 1,
            self.configuration.seed,
            frame,
            image,
        )
        return image

    def _light(self, view: View, projector_image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return the light of the projector at every pixel; the latest is cached for a camera that runs freely."""
        if self._latest_light is not None:
            latest_view, latest_image, light = self._latest_light
            if latest_view is view and np.array_equal(latest_image, projector_image):
                return light
        projector = self.configuration.projector
        defocus = projector.defocus_px
        response = (np.linspace(0.0, 1.0, 256) ** projector.gamma).astype(np.float32)
        light = np.empty(view.lit.shape, np.float32)
        if (projector_image == projector_image[:1]).all():
            edge = view.edge("row", projector.rows, defocus)
            weights = view.weights("column", projector.columns, defocus)
            exposure.light_along(response[projector_image[0]], *weights, edge, light)
        elif (projector_image == projector_image[:, :1]).all():
            edge = view.edge("column", projector.columns, defocus)
            weights = view.weights("row", projector.rows, defocus)
            exposure.light_along(response[projector_image[:, 0]], *weights, edge, light)
        else:
            columns = view.weights("column", projector.columns, defocus)
            rows = view.weights("row", projector.rows, defocus)
            exposure.light_of(response[projector_image], *columns, *rows, light)
        self._latest_light = view, projector_image.copy(), light
        return light

    def view(self, position: float) -> View:
        """Return the geometry at a crosshead position [m]; the latest two are cached.

        Raises
        ------
        CrossheadRangeError
            The position is outside the specimen's range.
        """
        if not 0.0 <= position <= self.maximum_position * (1.0 + 1e-9):
            raise CrossheadRangeError(
                f"crosshead position {position * 1e3:g} mm is outside 0 to {self.maximum_position * 1e3:g} mm"
            )
        position = float(position)  # an integer would compile all kernels again
        if position not in self._views:
            X, Y, residual = self._solve(position)
            left, right, low, high = self._surface.outline
            beside = ~((residual < _TOLERANCE) & (left <= X) & (right >= X) & (low <= Y) & (high >= Y))
            X[beside] = Y[beside] = np.nan
            column, row, irradiance, facing = self._light_geometry(position, X, Y)
            hidden = ~(facing > 0.0)
            for values in (X, Y, column, row, irradiance, residual):
                values[hidden] = np.nan

            if self._texture is not None:
                texture = reflectance_at(self._texture, self.configuration.texture.floor, X, Y)
            else:
                value = np.empty(self.shape)
                stage, specimen = self.configuration.stage, self.configuration.specimen
                if isinstance(specimen, ReferencePlaneSpecimen) and specimen.surface == "grid":
                    turned, pitch = math.radians(stage.grid_turned_degree), 1e-3 * stage.grid_pitch_mm
                    blur = 1e-6 * stage.grid_blur_um if stage.grid_kind == "lines" else 0.0
                    tracing.printed_grid(stage.albedo, stage.ink, pitch, turned, blur, X, Y, value)
                    texture = value
                else:
                    texture = np.where(np.isnan(X), 0.0, stage.albedo)
            sensor = self.configuration.sensor
            full_scale = 2**sensor.bits - 1
            white = full_scale * sensor.white_level * texture
            lit = self._lit(position, X, Y, column, row, irradiance)
            self._views[position] = View(
                X=X,
                Y=Y,
                projector_column=column,
                projector_row=row,
                lit=lit,
                gain=np.where(lit, white * irradiance, 0.0).astype(np.float32),
                offset=np.where(hidden, full_scale * sensor.background, white * sensor.ambient_light).astype(
                    np.float32
                ),
                residual=float(np.max(residual, initial=0.0, where=~hidden)),
            )
            if len(self._views) > _KEPT_VIEWS:
                self._views.popitem(last=False)
        self._views.move_to_end(position)
        return self._views[position]

    def _solve(self, position: float) -> tuple[Map, Map, Map]:
        """Return the material points (X, Y) [m] that the pixels see, and the residual [px]."""
        surface, residual = self._surface.deformed(position), np.empty(self.shape)
        if not self._surface.placed and surface.kind not in (tracing.CYLINDER, tracing.SPHERES):
            X, Y = np.empty(self.shape), np.empty(self.shape)
            tracing.solve_pixels(self._camera, surface, X, Y, residual)
            return X, Y, residual
        X, Y = self._starts()
        tracing.solve_from_starts(self._camera, surface, X, Y, residual)
        if surface.kind == tracing.CYLINDER:  # around it, X begins again
            half = self._surface.outline[1]
            X = np.remainder(X + half, 2.0 * half) - half
        return X, Y, residual

    def _starts(self) -> tuple[Map, Map]:
        """Return where the lines of sight meet the specimen's plane z = 0, or its cylinder; NaN where they miss."""
        camera, (rotation, translation) = self._camera, self.pose
        row, column = np.indices(self.shape, dtype=np.float64)
        seen = np.stack(
            [(column - camera[14]) / camera[12], (camera[15] - row) / camera[13], np.full(self.shape, -1.0)]
        )
        direction = np.tensordot(rotation @ camera[3:12].reshape(3, 3), seen, axes=1)
        origin = rotation @ camera[:3] + translation
        if self._surface.kind == tracing.SPHERES:
            return self._starts_on_spheres(origin, direction)
        if self._surface.kind != tracing.CYLINDER:
            along = -origin[2] / direction[2]
            return origin[0] + along * direction[0], origin[1] + along * direction[1]
        radius = self._surface.coefficients[0]
        a = direction[0] ** 2 + direction[2] ** 2
        b = direction[0] * origin[0] + direction[2] * origin[2]
        square = b * b - a * (origin[0] ** 2 + origin[2] ** 2 - radius**2)
        along = np.where(square > 0.0, -(b + np.sqrt(np.maximum(square, 0.0))) / a, np.nan)
        x, y, z = (origin[axis] + along * direction[axis] for axis in range(3))
        return radius * np.arctan2(x, z), y

    def _starts_on_spheres(self, origin: Map, direction: Map) -> tuple[Map, Map]:
        radius, width, *rest = self._surface.coefficients
        centres = np.array(rest).reshape(-1, 3)
        X, Y, nearest = (np.full(self.shape, each) for each in (np.nan, np.nan, np.inf))
        a = (direction**2).sum(axis=0)
        for number, centre in enumerate(centres):
            away = origin - centre
            b = np.tensordot(away, direction, axes=1)
            square = b * b - a * (away @ away - radius**2)
            along = np.where(square > 0.0, -(b + np.sqrt(np.maximum(square, 0.0))) / a, np.inf)
            x, y, z = away[:, None, None] + np.where(np.isfinite(along), along, 0.0) * direction
            hit = along < nearest
            place = (number + 0.5 - 0.5 * len(centres)) * width
            X[hit] = (place + radius * np.arctan2(x, z))[hit]
            Y[hit] = (radius * np.arcsin(np.clip(y / radius, -1.0, 1.0)))[hit]
            nearest[hit] = along[hit]
        return X, Y

    @property
    def pose(self) -> tuple[Map, Map]:
        """Rotation (3, 3) and translation (3,) [m] from this sensor's rig frame to the frame of the specimen."""
        return placement_matrices(self.configuration.placement)

    def _points(self, position: float, X: Map, Y: Map) -> tuple[Map, Map, Map]:
        x, y, z = np.empty_like(X), np.empty_like(X), np.empty_like(X)
        tracing.surface_points(self._surface.deformed(position), X, Y, x, y, z)
        return x, y, z

    def _seen(self, x: Map, y: Map, z: Map) -> tuple[Map, Map]:
        column, row = np.empty_like(x), np.empty_like(x)
        tracing.project_points(self._camera, x, y, z, column, row)
        return column, row

    def _light_geometry(self, position: float, X: Map, Y: Map) -> tracing.LightMaps:
        maps = tracing.LightMaps(*(np.empty_like(X) for _ in range(4)))
        tracing.light_geometry(self._camera, self._projector, self._surface.deformed(position), X, Y, maps)
        return maps

    def _lit(self, position: float, X: Map, Y: Map, column: Map, row: Map, irradiance: Map) -> NDArray[np.bool_]:
        """Return the points that the projector reaches: facing it, and not behind other parts of the specimen.

        A light path meets the surface again only behind a part that faces away from the projector, and that part lies
        on the same path: only points at the same projector pixels as averted parts can be in shadow.
        """
        specimen = self.configuration.specimen
        if isinstance(specimen, ReferencePlaneSpecimen | CylinderSpecimen | SpheresSpecimen) or (
            isinstance(specimen, RigidSpecimen) and specimen.shape == "plane"
        ):
            return irradiance > 0.0  # no lit part behind another; the shadow of a ball on another is left out
        left, right, low, high = self._surface.outline
        grid = np.meshgrid(np.linspace(left, right, _SHADOW_GRID), np.linspace(low, high, _SHADOW_GRID))
        grid_column, grid_row, grid_irradiance, _ = self._light_geometry(position, *grid)
        averted, averted_grid = irradiance <= 0.0, grid_irradiance <= 0.0
        if not averted.any() and not averted_grid.any():
            return irradiance > 0.0

        touched = np.zeros([n // _SHADOW_BLOCK + 3 for n in self.projector_shape], bool)

        def block(column: Map, row: Map) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
            i = np.clip(row / _SHADOW_BLOCK + 1.0, 0.0, touched.shape[0] - 1).astype(np.intp)
            j = np.clip(column / _SHADOW_BLOCK + 1.0, 0.0, touched.shape[1] - 1).astype(np.intp)
            return i, j

        touched[block(column[averted], row[averted])] = True
        touched[block(grid_column[averted_grid], grid_row[averted_grid])] = True
        touched = binary_dilation(touched, np.ones((3, 3), bool))
        lit = irradiance > 0.0
        suspected = lit.copy()
        suspected[lit] = touched[block(column[lit], row[lit])]
        heights = [self._points(position, *grid)[2], self._points(position, X, Y)[2]]
        top = max(float(np.nanmax(z)) for z in heights)
        search = tracing.ShadowSearch(self._surface.outline, top, 1e-6 * self.configuration.camera.pixel_size_um)
        tracing.cast_shadows(self._projector, self._surface.deformed(position), search, X, Y, suspected, lit)
        return lit

    def truth(self, position: float, reference_position: float = 0.0) -> xr.Dataset:
        """Return exact shape and displacement of the points that the pixels of the reference image see.

        Parameters
        ----------
        position
            Crosshead position [m] of the deformed state.
        reference_position
            Crosshead position [m] of the reference image.

        Returns
        -------
        xarray.Dataset
            On (row, column) of the reference image, NaN beside the specimen: ``x``, ``y``, ``z`` [m] the reference
            shape; ``u``, ``v``, ``w`` [m] the displacement; ``displacement_x``, ``displacement_y`` [px] that in the
            image, ``deformed(p + d(p)) = reference(p)``; ``valid``: the point is seen in both images; ``lit``: the
            projector reaches it in the reference state. On the pixels of the deformed image itself: ``z_deformed``
            [m], ``projector_column`` [px] and ``lit_deformed``.
        """
        reference, deformed = self.view(reference_position), self.view(position)
        rows, columns = self.shape
        x0, y0, z0 = self._points(reference_position, reference.X, reference.Y)
        x, y, z = self._points(position, reference.X, reference.Y)
        column, row = self._seen(x0, y0, z0)
        seen_column, seen_row = self._seen(x, y, z)
        within_columns = (seen_column > -_TOLERANCE) & (seen_column < columns - 1 + _TOLERANCE)
        within_rows = (seen_row > -_TOLERANCE) & (seen_row < rows - 1 + _TOLERANCE)

        def image(
            values: NDArray[Any], units: str, description: str
        ) -> tuple[tuple[str, str], NDArray[Any], dict[str, str]]:
            return ("row", "column"), values, {"units": units, "long_name": description}

        return xr.Dataset(
            {
                "x": image(x0, "m", "reference position to the right"),
                "y": image(y0, "m", "reference position upwards"),
                "z": image(z0, "m", "reference height towards the camera"),
                "u": image(x - x0, "m", "displacement to the right"),
                "v": image(y - y0, "m", "displacement upwards"),
                "w": image(z - z0, "m", "displacement towards the camera"),
                "displacement_x": image(seen_column - column, "px", "in-plane displacement x (right)"),
                "displacement_y": image(seen_row - row, "px", "in-plane displacement y (down)"),
                "valid": image(within_columns & within_rows, "1", "point seen in both images"),
                "lit": image(reference.lit, "1", "lit by the projector in the reference state"),
                "z_deformed": image(
                    self._points(position, deformed.X, deformed.Y)[2], "m", "height at the deformed image's own pixels"
                ),
                "projector_column": image(
                    deformed.projector_column, "px", "projector column at the deformed image's own pixels"
                ),
                "lit_deformed": image(deformed.lit, "1", "lit by the projector at the deformed image's own pixels"),
            },
            coords={"row": np.arange(rows), "column": np.arange(columns)},
            attrs={"position_m": position, "reference_position_m": reference_position},
        )

    def save_truth(self, path: str | PathLike[str], positions: list[float], reference_position: float = 0.0) -> None:
        """Write the truth of several load steps as NetCDF, float32, with the dimension ``step``.

        Parameters
        ----------
        path
            File to write.
        positions
            Crosshead position [m] of each step.
        reference_position
            Crosshead position [m] of the reference image.
        """
        steps = []
        for position in positions:
            step = self.truth(position, reference_position)
            steps.append(
                step.map(lambda values: values.astype(np.float32) if values.dtype == float else values, keep_attrs=True)
            )
        of_reference = ["x", "y", "z", "lit"]
        truth = xr.concat([step.drop_vars(of_reference) for step in steps], dim="step", combine_attrs="drop_conflicts")
        truth = truth.merge(steps[0][of_reference])
        truth["position"] = ("step", np.asarray(positions), {"units": "m", "long_name": "crosshead position"})
        truth.attrs = {"reference_position_m": reference_position}
        truth.to_netcdf(
            path, engine="h5netcdf", encoding={name: {"zlib": True, "complevel": 1} for name in truth.data_vars}
        )


def _middles(instants: int) -> NDArray[np.float64]:
    """Return the middles of equal parts of an exposure, relative to its middle and duration.

    Examples
    --------
    >>> _middles(2)
    array([-0.25,  0.25])
    """
    return (np.arange(instants) + 0.5) / instants - 0.5
