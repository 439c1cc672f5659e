"""The three processing steps: frames to phase, texture to in-plane displacement, both to shape and 3D displacement.

The nodes and ``fringedic process`` call exactly these functions with the same arrays, so that live, replayed and desk
results are bit-identical. Every parameter is declared here once: type, default, bounds and meaning.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import cv2
import numpy as np
import xarray as xr
from pydantic import BaseModel, ConfigDict, Field, field_validator

from fringedic.correlation import Reference, measure_displacement
from fringedic.errors import (
    CalibrationMissingError,
    FrameMismatchError,
    NoCorrelationError,
    ReferenceMissingError,
    StepError,
    TooFewValidError,
)
from fringedic.increments import PixelGrid, Total, compose, interpolation_noise
from fringedic.phase import CameraNoise, measure_phase
from fringedic.region import Region
from fringedic.rig import RigModel
from fringedic.sequence import Orientation, PatternKind, Stack
from fringedic.surface import PreparedShape, couple, surface_strain, to_local_frame
from fringedic.surface.relative import near_plane
from fringedic.vector_statistics import measured_part_and_rms
from fringedic.watch import WatchedMotion, watched_motion

Kept = TypeVar("Kept")
LIT_NEIGHBOURHOOD = 9  # [px], larger than a speckle
MEDIAN_POINTS = 20_000  # of a field, enough for how far the whole of it has moved
WORTH = 0.1  # part of the points in view that a later reference has to bring back, since it adds noise


class Parameters(BaseModel):
    """Base of all node parameters: unknown names, other types, NaN and infinity are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class PhaseParameters(Parameters):
    """Parameters of the phase node."""

    read_noise_grey_level: float = Field(
        0.0,
        ge=0,
        le=1e4,
        description="Standard deviation of the camera's noise in the dark [grey level]; 0 estimates the noise from "
        "the frames of each step.",
    )
    shot_noise_grey_level: float = Field(
        0.0,
        ge=0,
        le=1e4,
        description="Variance of the noise per grey level of brightness [grey level]; not used when it is estimated.",
    )
    saturation_grey_level: float = Field(
        0.0,
        ge=0,
        le=65535,
        description="Grey level from which a pixel counts as saturated [grey level]; 0 is the pixels' full scale.",
    )
    minimum_modulation_grey_level: float = Field(
        0.0,
        ge=0,
        le=65535,
        description="Fringe amplitude that a pixel needs beyond what its noise asks for [grey level].",
    )
    minimum_valid_fraction: float = Field(
        0.05, ge=0, le=1, description="The step fails when a smaller part of the image has a phase [0 to 1]."
    )
    method: Literal["auto", "steps", "one_image"] = Field(
        "auto",
        description="steps: phase stepping; one_image: the last fringe image alone, for fast events, divided by the "
        "step's grey frame where there is one; auto: one_image when the step has one fringe image only.",
    )
    relative_phase: Literal["refuse", "accept"] = Field(
        "refuse",
        description="Whether a phase true up to whole fringes only is a result: that of one image, or of one pitch "
        "that repeats in view. Shapes made from it are those nearest to the reference plane, off by whole fringes "
        "where the specimen is not there.",
    )
    lens_blur_px: float = Field(
        0.0,
        ge=0,
        le=5,
        description="Blur of the camera's lens, standard deviation [px], that the phase of a textured surface is "
        "corrected for; 0 corrects nothing.",
    )
    maximum_error_fringe: float = Field(
        0.003,
        gt=0,
        le=1,
        description="The step fails when flicker, or motion of the surface along the light while its frames are taken, "
        "bends the phase by more than this RMS [fringe].",
    )
    maximum_motion_px: float = Field(
        0.2,
        gt=0,
        le=100,
        description="The step fails when the surface moves farther than this across the image while its frames are "
        "taken [px].",
    )


class DicParameters(Parameters):
    """Parameters of the dic node."""

    window: int = Field(
        32, ge=8, le=256, description="Width [px] of the bi-triangular window with the same noise as the one in use."
    )
    spacing: int = Field(1, ge=1, le=256, description="Distance of the measured points in both directions [px].")
    region: str = Field(
        "",
        description="Part of the reference image that is measured: polygons as `fringedic region` writes them, as one "
        "line of YAML; empty: all.",
    )
    method: Literal["dense", "zoi"] = Field(
        "dense",
        description="dense: window-weighted gradient least squares at every point; zoi: the phase fit of the paper.",
    )
    minimum_valid_fraction: float = Field(
        0.05, ge=0, le=1, description="The step fails when a smaller part of the points has a displacement [0 to 1]."
    )
    rereference_fraction: float = Field(
        0.8,
        ge=0,
        le=1,
        description="When fewer points than this part of the usual ones still agree with the reference, the step is "
        "measured against the last good one instead, and the displacements are composed [0 to 1]; 0 never does so.",
    )
    kept_steps: int = Field(
        16, ge=1, le=1000, description="Latest steps whose texture is kept, so that each can become the reference."
    )

    @field_validator("region")
    @classmethod
    def _is_a_region(cls, text: str) -> str:
        if text:
            Region.from_text(text)
        return text


class CouplingParameters(Parameters):
    """Parameters of the coupling node."""

    z_filter_px: float = Field(
        2.0,
        ge=0,
        le=50,
        description="Standard deviation of the Gaussian that smooths the surfaces before they are subtracted [px]; "
        "the published shape is not smoothed.",
    )
    local_frame_window_px: int = Field(
        21,
        ge=0,
        le=1001,
        description="Width of the window of the slopes, for the displacement along the surface and its normal "
        "[px]; 0 leaves these out.",
    )
    strain_window_px: int = Field(
        85, ge=0, le=1001, description="Width of the window of the surface strain [px]; 0 leaves the strain out."
    )
    minimum_valid_fraction: float = Field(
        0.05, ge=0, le=1, description="The step fails when a smaller part of the cloud is measured [0 to 1]."
    )
    kept_steps: int = Field(
        16, ge=1, le=1000, description="Latest steps whose phase is kept, so that each can become the reference."
    )
    watch_region_px: list[int] = Field(
        [0, 0, 0, 0],
        description="First column, first row, width and height [px] of what stands still during a test, such as a "
        "textured marker on the frame: its motion is drift of the rig and is said. Width 0: nothing is watched.",
    )

    @field_validator("watch_region_px")
    @classmethod
    def _is_a_rectangle(cls, region: list[int]) -> list[int]:
        if len(region) != 4 or min(region) < 0 or (region[2] == 0) != (region[3] == 0):
            raise ValueError(f"{region}: first column, first row, width and height are needed, none below 0")
        return region


@dataclass
class PhaseResult:
    """What the phase node publishes of a step.

    Attributes
    ----------
    stamp
        Stamp of the last exposure [ns].
    phase, sigma
        Absolute phase at the finest pitch and its standard deviation [rad], float32 (row, column), NaN where not
        measured.
    modulation, texture
        Fringe amplitude and mean of the whole stack [grey level], float32 (row, column); the texture is NaN in
        background and shadow.
    valid_fraction
        Pixels with a phase over all pixels.
    pitch, orientation
        The finest pitch [projector pixel], to which the phase belongs, and the direction of the fringes.
    rms
        Median of ``sigma`` [rad].
    relative
        The phase is true up to whole fringes only.
    remarks
        What should be known about this result.
    """

    experiment: str
    step: int
    stamp: int
    phase: np.ndarray
    sigma: np.ndarray
    modulation: np.ndarray
    texture: np.ndarray
    valid_fraction: float
    pitch: float
    orientation: Orientation
    rms: float
    relative: bool = False
    remarks: tuple[str, ...] = ()


@dataclass
class DicResult:
    """What the dic node publishes of a step.

    Attributes
    ----------
    reference_step
        The step from whose configuration the displacement counts.
    correlated_step
        The step whose texture this one's was compared with: the reference step, or a later one whose own displacement
        was composed with what was found, because the texture had changed too much.
    displacement, sigma
        (d_x, d_y) at the points of the grid and its standard deviation [px], float32 (row, column, 2), d_y > 0
        downwards, NaN where not measured.
    origin
        (row, column) of the first point [px].
    spacing
        Distance of the points [px].
    valid_fraction
        Measured points over all points of the region.
    rms
        Root mean square of the displacement's two components together [px].
    """

    experiment: str
    step: int
    stamp: int
    reference_step: int
    correlated_step: int
    displacement: np.ndarray
    sigma: np.ndarray
    origin: tuple[int, int]
    spacing: int
    valid_fraction: float
    rms: float


@dataclass
class CouplingResult:
    """What the coupling node publishes of a step.

    Attributes
    ----------
    reference_step
        The step this displacement is measured against.
    shape
        x, y, z, sigma_z of this step's surface at every camera pixel [m], float32 (row, column).
    displacement
        At the points of the displacement grid, float32 (row, column): x, y, z of the reference surface, u, v, w with
        sigma_u, sigma_v, sigma_w [m], and when asked for u_t, v_t, w_n [m] and e_11, e_22, e_12 [-] with sigma_e_11,
        sigma_e_22, sigma_e_12 [-].
    valid_fraction
        Measured points over all points of the displacement.
    rms
        Root mean square length of (u, v, w) [m].
    watched
        How far the watched region has moved; None when nothing is watched.
    """

    experiment: str
    step: int
    stamp: int
    reference_step: int
    shape: dict[str, np.ndarray]
    displacement: dict[str, np.ndarray]
    valid_fraction: float
    rms: float
    watched: WatchedMotion | None = None


def phase_step(stack: Stack, parameters: PhaseParameters) -> PhaseResult:
    """Measure the phase of one step (eq. 11), having looked for faults of its frames.

    Raises
    ------
    FrameMismatchError
        The stack holds no fringes, or is faulty: `WrongPatternError`, `FramesOutOfOrderError`, `FlickerError`,
        `MovedSurfaceError`.
    InvalidSequenceError
        Its frames give no phase, or a relative one that the parameters do not accept.
    TooFewValidError
        Less of the image has a phase than ``parameters.minimum_valid_fraction``; `SaturatedStackError` and
        `DarkStackError` where that is why.
    """
    where = f"experiment '{stack.experiment}', step {stack.step}"
    if stack.kind != PatternKind.FRINGES:
        raise FrameMismatchError(
            f"{where}: shows {stack.kind.name}, a phase needs fringes", experiment=stack.experiment, step=stack.step
        )
    read_noise = parameters.read_noise_grey_level
    try:
        measured, remarks = measure_phase(
            stack.frames,
            stack.projections,
            exposure_times=stack.exposure_times,
            method=parameters.method,
            accept_relative=parameters.relative_phase == "accept",
            noise=CameraNoise(read_noise, parameters.shot_noise_grey_level) if read_noise else None,
            saturation=parameters.saturation_grey_level or None,
            minimum_modulation=parameters.minimum_modulation_grey_level,
            lens_blur=parameters.lens_blur_px,
            largest_error=parameters.maximum_error_fringe,
            largest_motion=parameters.maximum_motion_px,
        )
    except StepError as error:
        raise type(error)(
            f"{where}: {error}", experiment=stack.experiment, step=stack.step, index=error.index
        ) from error
    fraction = float(measured.valid.mean())
    _check_fraction("a phase", fraction, parameters.minimum_valid_fraction, stack.experiment, stack.step)
    sigma = measured.sigma.values
    return PhaseResult(
        experiment=stack.experiment,
        step=stack.step,
        stamp=stack.stamp,
        phase=measured.phase.values,
        sigma=sigma,
        modulation=measured.modulation.values,
        texture=np.where(_lit_region(measured.valid.values), measured.texture.values, np.float32(np.nan)),
        valid_fraction=fraction,
        pitch=stack.projections[-1].pitch,
        orientation=stack.projections[-1].orientation,
        rms=float(np.nanmedian(sigma)),
        relative=bool(measured.phase.attrs["relative"]),
        remarks=tuple(remarks),
    )


def _lit_region(valid: np.ndarray) -> np.ndarray:
    """Return where the surface is: pixels most of whose neighbours have a phase.

    Background and shadow do not move with the surface and would pull the displacement beside them. A dark speckle
    without phase stays part of the surface.
    """
    return cv2.blur(valid.astype(np.float32), (LIT_NEIGHBOURHOOD, LIT_NEIGHBOURHOOD)) > 0.5


def white_texture(image: np.ndarray) -> np.ndarray:
    """Return the texture of a white exposure: the image itself as float32 [grey level]."""
    return image.astype(np.float32)


class _References:
    """Which step is the reference of each experiment: the one that was set, otherwise the first that succeeded."""

    def __init__(self) -> None:
        self._chosen: dict[str, int] = {}

    def set(self, experiment: str, step: int) -> None:
        self._chosen[experiment] = step

    def of(self, experiment: str, step: int) -> int:
        return self._chosen.get(experiment, step)

    def succeeded(self, experiment: str, step: int) -> None:
        self._chosen.setdefault(experiment, step)


class _LatestSteps(OrderedDict[tuple[str, int], Kept]):
    """What is kept of the latest steps; the reference step is never given up."""

    def keep(self, key: tuple[str, int], value: Kept, number: int, reference: tuple[str, int]) -> None:
        self[key] = value
        self.move_to_end(key)
        for oldest in list(self)[: max(len(self) - number, 0)]:
            if oldest != reference:
                del self[oldest]


@dataclass(frozen=True)
class _Link:
    """A step that later ones can be compared with, and the displacement that leads to it.

    Attributes
    ----------
    displacement, sigma
        Against the reference step [px], (row, column, 2); None for the reference step itself.
    prepared
        The texture, once it has been prepared.
    """

    step: int
    texture: np.ndarray
    displacement: np.ndarray | None = None
    sigma: np.ndarray | None = None
    prepared: Reference | None = None


class DisplacementTracker:
    """Measures the in-plane displacement of each step against the reference step's texture.

    The displacement of the previous two steps, extrapolated, is the start of the next one; the measurement itself is
    against the reference image, so that errors do not add up. When the texture changes so much that too little agrees
    with the reference image, the last good step takes its place and its displacement is composed with what is measured
    against it, until that one changes too much as well. Kept in memory: the reference texture, the textures of the
    latest ``kept_steps`` steps (any of them can become the reference), four displacement fields.

    Parameters
    ----------
    parameters
        May be replaced between steps by assigning to `parameters`.
    """

    def __init__(self, parameters: DicParameters) -> None:
        self._parameters = parameters
        self._references = _References()
        self._textures: _LatestSteps[np.ndarray] = _LatestSteps()
        self._prepared: tuple[tuple[str, int], Reference] | None = None
        self._measured_against: tuple[str, int] | None = None
        self._history: list[tuple[int, np.ndarray]] = []
        self._link: _Link | None = None
        self._last: _Link | None = None
        self._agreed = 0.0
        self._wanted = 1.0  # part of the grid's points that lie in the region

    @property
    def parameters(self) -> DicParameters:
        """Parameters of the steps to come."""
        return self._parameters

    @parameters.setter
    def parameters(self, parameters: DicParameters) -> None:
        if parameters.spacing != self._parameters.spacing:
            self._begin()
        if parameters != self._parameters:
            self._parameters = parameters
            self._prepared = None
            if self._link is not None:
                self._link = replace(self._link, prepared=None)

    def set_reference(self, experiment: str, step: int) -> None:
        """Make a step the reference of the following ones; it may be one that is still to come."""
        self._references.set(experiment, step)

    def step(self, experiment: str, step: int, stamp: int, texture: np.ndarray) -> DicResult:
        """Measure one step; the reference step itself has no displacement where it can be measured.

        Parameters
        ----------
        texture
            The surface without fringes [grey level], float32 (row, column).

        Raises
        ------
        ReferenceMissingError
            The reference step was not measured or is no longer kept.
        FrameMismatchError
            The texture has another size than the reference.
        TooFewValidError
            Fewer points are measured than ``parameters.minimum_valid_fraction``.
        """
        parameters = self._parameters
        key = (experiment, step)
        reference_key = (experiment, self._references.of(experiment, step))
        reference = self._reference(reference_key, key, texture)
        if reference_key != self._measured_against or key == reference_key:
            self._begin()
            self._measured_against = reference_key
        link = self._link or _Link(reference_key[1], texture, prepared=reference)
        if key == reference_key:
            measured = self._measure(link, texture, None)
            agreed = _agreement(measured, texture.shape)
        else:
            link, measured, agreed = self._follow(link, texture, step)
        found = np.stack([measured.displacement_x.values, measured.displacement_y.values], axis=-1)
        sigma = np.stack([measured.sigma_x.values, measured.sigma_y.values], axis=-1)
        if key == reference_key:
            found = np.where(measured.valid.values[..., np.newaxis], np.float32(0), np.float32(np.nan))
            found = np.repeat(found, 2, axis=-1)
        displacement = found
        if link.displacement is not None:
            displacement, sigma = self._composed(link, measured)
        fraction, length = measured_part_and_rms(displacement[..., 0], displacement[..., 1])
        fraction /= self._wanted
        _check_fraction("a displacement", fraction, parameters.minimum_valid_fraction, experiment, step)

        self._references.succeeded(experiment, step)
        self._prepared = (reference_key, reference)
        self._textures.keep(key, texture, parameters.kept_steps, reference_key)
        self._agreed = max(self._agreed, agreed)
        if link.displacement is not None and link.step != (self._link.step if self._link else None):
            self._history = []
        self._link = link if link.displacement is not None else None
        self._history = [*self._history[-1:], (step, found)]
        self._last = _Link(step, texture, displacement, sigma)
        return DicResult(
            experiment=experiment,
            step=step,
            stamp=stamp,
            reference_step=reference_key[1],
            correlated_step=link.step,
            displacement=displacement,
            sigma=sigma,
            origin=(int(measured.row[0]), int(measured.column[0])),
            spacing=parameters.spacing,
            valid_fraction=fraction,
            rms=length,
        )

    def _begin(self) -> None:
        """Forget what led to the present step: from here on steps are compared with the reference step."""
        self._history = []
        self._link = self._last = None
        self._agreed = 0.0

    def _measure(self, link: _Link, texture: np.ndarray, initial: tuple[np.ndarray, np.ndarray] | None) -> xr.Dataset:
        assert link.prepared is not None
        return measure_displacement(link.prepared, texture, initial=initial, method=self._parameters.method)

    def _follow(self, link: _Link, texture: np.ndarray, step: int) -> tuple[_Link, xr.Dataset, float]:
        """Measure against the present link, or against the last good step where that is worth it.

        Returns the link that was used, what was measured against it, and how much agrees.
        """
        measured, agreed, failure, last = None, 0.0, None, self._last
        try:
            measured = self._measure(self._ready(link), texture, self._predicted(step))
            agreed = _agreement(measured, texture.shape)
        except NoCorrelationError as error:
            failure = error
        least = self._parameters.rereference_fraction
        if measured is not None and agreed >= least * self._agreed:
            return self._ready(link), measured, agreed
        if least > 0 and last is not None and last.step != link.step:
            fresh = self._ready(last)
            with suppress(NoCorrelationError):
                other = self._measure(fresh, texture, None)
                other_agreed = _agreement(other, texture.shape)
                if measured is None or other_agreed > agreed + WORTH:
                    return fresh, other, other_agreed
        if measured is None:
            assert failure is not None
            raise failure
        return link, measured, agreed

    def _ready(self, link: _Link) -> _Link:
        """The link with its texture prepared for comparison."""
        if link.prepared is not None:
            return link
        parameters = self._parameters
        return replace(link, prepared=Reference(link.texture, window=parameters.window, spacing=parameters.spacing))

    def _composed(self, link: _Link, measured: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
        """The displacement since the reference step and its sigma, (row, column, 2) each."""
        assert link.displacement is not None and link.sigma is not None
        grid = PixelGrid.of(measured)
        total = compose(
            Total(np.moveaxis(link.displacement, -1, 0), np.moveaxis(link.sigma, -1, 0) ** 2),
            grid,
            np.stack([measured.displacement_x.values, measured.displacement_y.values]),
            np.stack([measured.sigma_x.values, measured.sigma_y.values]),
            grid,
            noise_gain=interpolation_noise(grid.spacing, None, self._parameters.window, self._parameters.method),
        )
        fields = (total.displacement, np.sqrt(total.variance))
        displacement, sigma = (np.ascontiguousarray(np.moveaxis(each, 0, -1), np.float32) for each in fields)
        return displacement, sigma

    def _reference(self, reference_key: tuple[str, int], key: tuple[str, int], texture: np.ndarray) -> Reference:
        if self._prepared is not None and self._prepared[0] == reference_key and key != reference_key:
            reference = self._prepared[1]
        else:
            image = texture if key == reference_key else self._textures.get(reference_key)
            if image is None:
                raise _no_reference(key, reference_key)
            parameters = self._parameters
            mask = Region.from_text(parameters.region).mask_for(image.shape) if parameters.region else None
            self._wanted = 1.0 if mask is None else float(mask[:: parameters.spacing, :: parameters.spacing].mean())
            reference = Reference(image, window=parameters.window, spacing=parameters.spacing, mask=mask)
        size = self._textures.get(reference_key, texture).shape
        if size != texture.shape:
            raise FrameMismatchError(
                f"experiment '{key[0]}', step {key[1]}: the texture is {texture.shape[1]}x{texture.shape[0]} px, "
                f"its reference step {reference_key[1]} has {size[1]}x{size[0]} px",
                experiment=key[0],
                step=key[1],
            )
        return reference

    def _predicted(self, step: int) -> tuple[np.ndarray, np.ndarray] | None:
        """Continue the motion of the two steps measured last; None, for a global search, before they are known.

        Steps are counted by their numbers: one may have failed, and a reference may lie between them or behind.
        """
        if len(self._history) < 2 or self._history[0][0] == self._history[1][0]:
            return None
        (earlier_step, earlier), (last_step, last) = self._history
        predicted = last + np.float32((step - last_step) / (last_step - earlier_step)) * (last - earlier)
        predicted = np.where(np.isnan(predicted), last, predicted)
        return predicted[..., 0], predicted[..., 1]


@dataclass(frozen=True)
class _KeptPhase:
    phase: np.ndarray
    sigma: np.ndarray
    pitch: float
    orientation: Orientation
    relative: bool

    def surface(self, calibration: RigModel) -> xr.Dataset:
        phase = self.phase
        if self.relative:
            phase = near_plane(phase, calibration, self.pitch, self.orientation)
        return calibration.reconstruct(phase, self.pitch, self.sigma, self.orientation)


@dataclass(frozen=True)
class StepSurface:
    """The surface of a step, made and prepared before its displacement is there; from `ShapeTracker.surface`."""

    kept: _KeptPhase
    calibration: RigModel
    shape: xr.Dataset
    prepared: PreparedShape


class ShapeTracker:
    """Computes the surface of each step and its 3D displacement against the reference step (eq. 10 and 12).

    Kept in memory: phase and sigma of the latest ``kept_steps`` steps (any of them can become the reference) and of
    the reference step.

    Parameters
    ----------
    parameters
        May be replaced between steps by assigning to ``parameters``.
    """

    def __init__(self, parameters: CouplingParameters) -> None:
        self.parameters = parameters
        self._calibration: RigModel | None = None
        self._references = _References()
        self._phases: _LatestSteps[_KeptPhase] = _LatestSteps()
        self._prepared: tuple[_KeptPhase, RigModel, PreparedShape] | None = None

    def set_calibration(self, calibration: RigModel) -> None:
        """Give the rig's model; steps that follow, and their reference, are reconstructed with it."""
        self._calibration = calibration

    def set_reference(self, experiment: str, step: int) -> None:
        """Make a step the reference of the following ones; it may be one that is still to come."""
        self._references.set(experiment, step)

    def surface(
        self,
        phase: np.ndarray,
        sigma: np.ndarray,
        *,
        pitch: float,
        orientation: Orientation = Orientation.VERTICAL,
        relative: bool = False,
    ) -> StepSurface | None:
        """Make the surface of a step whose displacement is still being measured, for `step`.

        Parameters
        ----------
        phase, sigma, pitch, orientation, relative
            As for `step`.

        Returns
        -------
        StepSurface or None
            None while there is no calibration.
        """
        if self._calibration is None:
            return None
        return self._surface(_KeptPhase(phase, sigma, pitch, orientation, relative), self._calibration)

    def _surface(self, kept: _KeptPhase, calibration: RigModel) -> StepSurface:
        shape = kept.surface(calibration)
        prepared = PreparedShape(shape, z_filter=self.parameters.z_filter_px, calibration=calibration)
        return StepSurface(kept, calibration, shape, prepared)

    def step(
        self,
        experiment: str,
        step: int,
        stamp: int,
        phase: np.ndarray,
        sigma: np.ndarray,
        displacement: np.ndarray,
        displacement_sigma: np.ndarray,
        *,
        pitch: float,
        orientation: Orientation = Orientation.VERTICAL,
        relative: bool = False,
        spacing: int = 1,
        origin: tuple[int, int] = (0, 0),
        window: int | None = None,
        method: str = "dense",
        surface: StepSurface | None = None,
    ) -> CouplingResult:
        """Couple the phase and the in-plane displacement of one step.

        Parameters
        ----------
        phase, sigma
            As published by the phase node [rad], float32 (row, column).
        displacement, displacement_sigma
            As published by the dic node [px], float32 (row, column, 2).
        pitch, orientation
            Of the step's last frame: the finest pitch [projector pixel], and the direction of the fringes.
        relative
            The phase is true up to whole fringes; of the surfaces that it may be, the one nearest to the reference
            plane is taken.
        spacing, origin
            Distance of the displacement's points [px], and (row, column) of the first one.
        window, method
            With which the displacement was measured: they tell how far its errors agree, which the sigma of the strain
            needs. None when unknown, the strain then comes without it.
        surface
            What `surface` made of this phase; made here when it is None, or the calibration or the filter has changed
            since.

        Raises
        ------
        CalibrationMissingError
            No calibration has been given.
        ReferenceMissingError
            The reference step was not measured or is no longer kept.
        FrameMismatchError
            The phase has another size than the reference's.
        TooFewValidError
            Less of the cloud is measured than ``parameters.minimum_valid_fraction``.
        """
        parameters, calibration = self.parameters, self._calibration
        if calibration is None:
            raise CalibrationMissingError(
                f"experiment '{experiment}', step {step}: no calibration yet; publish one on 'calibration'",
                experiment=experiment,
                step=step,
            )
        key = (experiment, step)
        reference_key = (experiment, self._references.of(experiment, step))
        current = _KeptPhase(phase, sigma, pitch, orientation, relative) if surface is None else surface.kept
        first = current if key == reference_key else self._phases.get(reference_key)
        if first is None:
            raise _no_reference(key, reference_key)
        if first.phase.shape != phase.shape:
            raise FrameMismatchError(
                f"experiment '{experiment}', step {step}: the phase map is {phase.shape[1]}x{phase.shape[0]} px, "
                f"its reference step {reference_key[1]} has {first.phase.shape[1]}x{first.phase.shape[0]} px",
                experiment=experiment,
                step=step,
            )
        if (
            surface is None
            or surface.calibration is not calibration
            or surface.prepared.z_filter != parameters.z_filter_px
        ):
            surface = self._surface(current, calibration)
        reference = surface.prepared if first is current else self._prepared_reference(first, calibration)
        cloud = couple(
            reference,
            surface.prepared,
            displacement_dataset(displacement, displacement_sigma, spacing, origin, window, method),
            calibration=calibration,
            z_filter=parameters.z_filter_px,
            orientation=orientation,
        )
        names = ["x", "y", "z", "u", "v", "w", "sigma_u", "sigma_v", "sigma_w"]
        fields = {name: cloud[name] for name in names}
        if parameters.local_frame_window_px:
            local = to_local_frame(cloud, window=parameters.local_frame_window_px)
            fields |= {name: local[name] for name in ("u_t", "v_t", "w_n")}
        if parameters.strain_window_px:
            strain = surface_strain(cloud, window=parameters.strain_window_px)
            names = ["e_11", "e_22", "e_12", "sigma_e_11", "sigma_e_22", "sigma_e_12"]
            fields |= {name: strain[name] for name in names if name in strain}
        arrays = _float32(fields)
        fraction, length = measured_part_and_rms(arrays["u"], arrays["v"], arrays["w"])
        _check_fraction("a 3D displacement", fraction, parameters.minimum_valid_fraction, experiment, step)

        self._references.succeeded(experiment, step)
        self._phases.keep(key, current, parameters.kept_steps, reference_key)
        self._prepared = (first, calibration, reference)
        return CouplingResult(
            experiment=experiment,
            step=step,
            stamp=stamp,
            reference_step=reference_key[1],
            shape=_float32({name: surface.shape[name] for name in ("x", "y", "z", "sigma_z")}),
            displacement=arrays,
            valid_fraction=fraction,
            rms=length,
            watched=self._watched(arrays, spacing, origin, reference_key[1]),
        )

    def _watched(
        self, displacement: dict[str, np.ndarray], spacing: int, origin: tuple[int, int], reference_step: int
    ) -> WatchedMotion | None:
        region = self.parameters.watch_region_px
        if not region[2]:
            return None
        return watched_motion(displacement, region, spacing=spacing, origin=origin, reference_step=reference_step)

    def _prepared_reference(self, first: _KeptPhase, calibration: RigModel) -> PreparedShape:
        """The reference's shape, made and prepared once for the steps that share it."""
        z_filter = self.parameters.z_filter_px
        if self._prepared is not None:
            phase, rig, shape = self._prepared
            if phase is first and rig is calibration and shape.z_filter == z_filter:
                return shape
        return PreparedShape(first.surface(calibration), z_filter=z_filter, calibration=calibration)


def displacement_dataset(
    displacement: np.ndarray,
    sigma: np.ndarray,
    spacing: int,
    origin: tuple[int, int],
    window: int | None = None,
    method: str = "dense",
) -> xr.Dataset:
    """Label the arrays of a `DicResult` with the pixel positions of their points, and the window if it is known."""
    rows, columns = displacement.shape[:2]
    values = {
        "displacement_x": displacement[..., 0],
        "displacement_y": displacement[..., 1],
        "sigma_x": sigma[..., 0],
        "sigma_y": sigma[..., 1],
        "valid": np.isfinite(displacement[..., 0]) & np.isfinite(displacement[..., 1]),
    }
    return xr.Dataset(
        {name: (("row", "column"), value) for name, value in values.items()},
        coords={"row": origin[0] + spacing * np.arange(rows), "column": origin[1] + spacing * np.arange(columns)},
        attrs={} if window is None else {"window_px": window, "method": method},
    )


def _float32(fields: Mapping[str, xr.DataArray]) -> dict[str, np.ndarray]:
    return {name: np.ascontiguousarray(array.values, dtype=np.float32) for name, array in fields.items()}


def _agreement(measured: xr.Dataset, shape: tuple[int, ...]) -> float:
    """Measured points over those that should still be in view, had all moved like the median."""
    valid = measured.valid.values
    count = int(np.count_nonzero(valid))
    staying = 1
    for axis, name, length in (("row", "displacement_y", shape[0]), ("column", "displacement_x", shape[1])):
        known = measured[name].values[valid][:: max(1, count // MEDIAN_POINTS)]
        there = measured[axis].values + (float(np.median(known)) if count else 0.0)
        staying *= int(np.count_nonzero((there >= 0) & (there <= length - 1)))
    return count / max(1, staying)


def _check_fraction(what: str, fraction: float, minimum: float, experiment: str, step: int) -> None:
    if fraction < minimum or fraction == 0:
        raise TooFewValidError(
            f"experiment '{experiment}', step {step}: only {fraction:.1%} of the image has {what}, "
            f"minimum_valid_fraction asks for {minimum:.1%}",
            experiment=experiment,
            step=step,
        )


def _no_reference(key: tuple[str, int], reference_key: tuple[str, int]) -> ReferenceMissingError:
    experiment, step = key
    return ReferenceMissingError(
        f"experiment '{experiment}', step {step}: its reference, step {reference_key[1]}, was not measured or is no "
        "longer kept; set another reference or raise kept_steps",
        experiment=experiment,
        step=step,
    )
