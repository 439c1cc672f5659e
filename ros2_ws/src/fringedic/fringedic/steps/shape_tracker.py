"""The coupling step: phase and in-plane displacement to shape and 3D displacement (eq. 10 and 12)."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from fringedic.errors import CalibrationError, ErrorCode, StepError
from fringedic.rig.compatibility import check_camera, check_heights
from fringedic.rig.model import RigModel
from fringedic.steps.drift_marker import MarkerMotion, measure_drift
from fringedic.steps.parameters import CouplingParameters
from fringedic.steps.references import LatestSteps, StepKey, check_fraction, no_reference, size_mismatch
from fringedic.steps.remarks import corrections_text
from fringedic.steps.statistics import measured_part_and_rms
from fringedic.steps.step_results import STRAIN_FIELDS, CouplingResult, DicResult, PhaseResult
from fringedic.surface import PreparedShape, couple, surface_strain, to_local_frame
from fringedic.surface.nearest_order import nearest_order_to_plane
from fringedic.surface.shading import LitTexture

_SHAPE = ("x", "y", "z", "sigma_z")
_VECTORS = ("x", "y", "z", "u", "v", "w", "sigma_u", "sigma_v", "sigma_w")
_NOISE = ("noise_z", "noise_z_deformed")
_LOCAL = ("u_t", "v_t", "w_n")
_NONE_YET = "no calibration yet: publish one on 'calibration', or process the recording with --calibration FILE"
DISPLACEMENT_FIELDS = (*_VECTORS, *_NOISE, *_LOCAL, *STRAIN_FIELDS)
"""Fields of the displacement of a step, when all are asked for."""


@dataclass(frozen=True)
class StepSurface:
    """The surface of a step, made before its displacement is known, by `ShapeTracker.surface`.

    Attributes
    ----------
    phase
        What it was made from.
    calibration
        The rig's model that it was made with.
    shape
        From `RigModel.reconstruct`.
    prepared
        The shape, smoothed and ready for `couple`.
    """

    phase: PhaseResult
    calibration: RigModel
    shape: xr.Dataset
    prepared: PreparedShape


@dataclass(frozen=True)
class _Appearance:
    """The texture of the reference step on its surface, prepared for the steps that share it.

    Attributes
    ----------
    surface
        That it lies on.
    settings
        Attributes of the displacement and window of the strain that it was prepared for.
    texture
        To take the change of its shading out of displacements.
    slope_noise
        See `LitTexture.slope_noise`.
    """

    surface: StepSurface
    settings: tuple[object, ...]
    texture: LitTexture
    slope_noise: float


class ShapeTracker:
    """Computes the surface of each step and its 3D displacement against the reference step (eq. 10 and 12).

    Where phases come with their textures, the displacement that a change of the shading imitates is taken out first,
    see `fringedic.surface.shading`. The reference step is that of the in-plane displacement. Phases and textures of the
    latest ``kept_steps`` steps (any of them can become the reference) and of the reference step stay in memory.

    Parameters
    ----------
    parameters
        May be replaced between steps by assigning to ``parameters``.
    """

    def __init__(self, parameters: CouplingParameters) -> None:
        self.parameters = parameters
        self._calibration: RigModel | None = None
        self._without_calibration = _NONE_YET
        self._phases: LatestSteps[PhaseResult] = LatestSteps()
        self._prepared: StepSurface | None = None
        self._appearance: _Appearance | None = None

    def set_calibration(self, calibration: RigModel) -> None:
        """Set the rig's model, with which the following steps and their reference are reconstructed."""
        if calibration.camera_distortion is not None:
            calibration.camera_distortion.field()  # it is kept there: the first step need not wait for it
        self._calibration = calibration

    def refuse_calibration(self, reason: str) -> None:
        """Fail the following steps with this reason, until another calibration is set."""
        self._calibration = None
        self._without_calibration = f"the latest calibration was refused: {reason}"

    def surface(self, phase: PhaseResult) -> StepSurface | None:
        """Make the surface of a step while its displacement is still being measured.

        Returns
        -------
        StepSurface or None
            None without a calibration of this camera; `step` then raises the error.
        """
        calibration = self._calibration
        if calibration is None or phase.phase.shape != (calibration.camera_height, calibration.camera_width):
            return None
        return self._make_surface(_for_reconstruction(phase), calibration)

    def step(
        self, phase: PhaseResult, displacement: DicResult, *, surface: StepSurface | None = None
    ) -> CouplingResult:
        """Couple the phase and the in-plane displacement of one step.

        Parameters
        ----------
        phase
            Of the step. Where its phase is relative, the fringe order nearest to the reference plane is taken.
        displacement
            Of the same step.
        surface
            From `surface` of the same phase; made again when the calibration or the filter has changed since.

        Raises
        ------
        StepError
            No calibration is set (`ErrorCode.NO_CALIBRATION`), or that of another rig (`OTHER_RIG`); the
            reference step was not measured, is no longer kept, or its phase was corrected otherwise (`NO_REFERENCE`);
            the phase has another size than the reference's (`FRAME_MISMATCH`); less of the cloud is measured than
            ``parameters.minimum_valid_fraction`` (`TOO_FEW_VALID`).
        """
        parameters = self.parameters
        key = (phase.experiment, phase.step)
        reference_key = (phase.experiment, displacement.reference_step)
        calibration = self._require_calibration(phase)
        phase = _for_reconstruction(phase) if surface is None else surface.phase
        first = phase if key == reference_key else self._require_reference(phase, key, reference_key)
        current = self._current(surface, phase, calibration)
        _require_heights(current)
        reference = current if first is phase else self._reference_surface(first, calibration)
        appearance = self._appearance_of(reference, displacement.field)
        field = displacement.field
        if appearance is not None and current is not reference:
            field = appearance.texture.without_shading(field, current.prepared)
        cloud = couple(
            reference.prepared,
            current.prepared,
            field,
            calibration=calibration,
            z_filter=parameters.z_filter_px,
            orientation=phase.orientation,
        )
        fields = self._evaluated(cloud, appearance)
        fraction, length = measured_part_and_rms(fields.u.values, fields.v.values, fields.w.values)
        check_fraction("a 3D displacement", fraction, parameters.minimum_valid_fraction, key)

        self._phases.keep(key, phase, parameters.kept_steps, reference_key)
        self._prepared, self._appearance = reference, appearance
        return CouplingResult(
            experiment=phase.experiment,
            step=phase.step,
            stamp=phase.stamp,
            reference_step=reference_key[1],
            shape=xr.Dataset(_contiguous(current.shape, _SHAPE), coords=current.shape.coords),
            displacement=fields,
            valid_fraction=fraction,
            rms=length,
            drift=self._drift(fields, reference_key[1]),
        )

    def _require_calibration(self, phase: PhaseResult) -> RigModel:
        if self._calibration is None:
            raise _step_error(phase, self._without_calibration, ErrorCode.NO_CALIBRATION)
        rows, columns = phase.phase.shape
        try:
            check_camera(self._calibration, (columns, rows))
        except CalibrationError as error:
            raise _step_error(phase, str(error), error.code) from error
        return self._calibration

    def _require_reference(self, phase: PhaseResult, key: StepKey, reference_key: StepKey) -> PhaseResult:
        first = self._phases.get(reference_key)
        if first is None:
            raise no_reference(key, reference_key)
        if first.corrections != phase.corrections:
            now, then = (corrections_text(each.corrections) for each in (phase, first))
            raise _step_error(
                phase,
                f"its phase is corrected for {now}, and that of its reference step {first.step} for {then}: set a new "
                "reference",
                ErrorCode.NO_REFERENCE,
            )
        if first.phase.shape != phase.phase.shape:
            raise size_mismatch("phase map", key, reference_key, (phase.phase.shape, first.phase.shape))
        return first

    def _make_surface(self, phase: PhaseResult, calibration: RigModel) -> StepSurface:
        values = phase.phase
        if phase.relative:
            values = nearest_order_to_plane(values, calibration, phase.pitch, phase.orientation)
        shape = calibration.reconstruct(values, phase.pitch, phase.sigma, phase.orientation)
        prepared = PreparedShape(shape, z_filter=self.parameters.z_filter_px, calibration=calibration)
        return StepSurface(phase, calibration, shape, prepared)

    def _is_current(self, surface: StepSurface, calibration: RigModel) -> bool:
        return surface.calibration is calibration and surface.prepared.z_filter == self.parameters.z_filter_px

    def _current(self, surface: StepSurface | None, phase: PhaseResult, calibration: RigModel) -> StepSurface:
        if surface is not None and self._is_current(surface, calibration):
            return surface
        return self._make_surface(phase, calibration)

    def _reference_surface(self, first: PhaseResult, calibration: RigModel) -> StepSurface:
        """Return the reference's surface, made once for the steps that share it."""
        known = self._prepared
        if known is not None and known.phase is first and self._is_current(known, calibration):
            return known
        return self._make_surface(first, calibration)

    def _appearance_of(self, reference: StepSurface, field: xr.Dataset) -> _Appearance | None:
        """Return the appearance of the reference, made once for the steps that share it; None without its texture."""
        if "texture" not in reference.phase.maps or "window_px" not in field.attrs:
            return None
        window = self.parameters.strain_window_px
        settings = (*(field.attrs[name] for name in ("method", "window_px", "spacing_px")), window)
        known = self._appearance
        if known is not None and known.surface is reference and known.settings == settings:
            return known
        light = reference.calibration.projector_position
        texture = LitTexture(reference.prepared, reference.phase.texture, light, field)
        return _Appearance(reference, settings, texture, texture.slope_noise(window) if window else 1.0)

    def _evaluated(self, cloud: xr.Dataset, appearance: _Appearance | None) -> xr.Dataset:
        """Return the fields to be published: displacement, local components and strain where they are asked for."""
        arrays = _contiguous(cloud, (*_VECTORS, *_NOISE))
        # a viewer colours the points with a position: there has to be a value
        dims, u = arrays["u"]
        for name in ("x", "y", "z"):
            arrays[name] = (dims, np.where(np.isfinite(u), arrays[name][1], np.float32(np.nan)))
        if self.parameters.local_frame_window_px:
            moved = cloud[list("xyzuvw")]  # without errors: standard deviations of the components are not published
            arrays |= _contiguous(to_local_frame(moved, window=self.parameters.local_frame_window_px), _LOCAL)
        if self.parameters.strain_window_px:
            slope_noise = appearance.slope_noise if appearance is not None else 1.0
            # of the published points, so that a strain computed from a dataset is the same
            published = cloud.assign({name: arrays[name] for name in ("x", "y", "z")})
            strain = surface_strain(published, window=self.parameters.strain_window_px, slope_noise=slope_noise)
            arrays |= _contiguous(strain, [name for name in STRAIN_FIELDS if name in strain])
        return xr.Dataset(arrays, coords=cloud.coords)

    def _drift(self, fields: xr.Dataset, reference_step: int) -> MarkerMotion | None:
        region = self.parameters.drift_marker_px
        return measure_drift(fields, region, reference_step) if region[2] else None


def _require_heights(surface: StepSurface) -> None:
    try:
        check_heights(surface.shape, surface.calibration)
    except CalibrationError as error:
        raise _step_error(surface.phase, str(error), error.code) from error


def _step_error(phase: PhaseResult, message: str, code: ErrorCode | None) -> StepError:
    return StepError(
        message,
        experiment=phase.experiment,
        step=phase.step,
        code=code,
    )


def _for_reconstruction(phase: PhaseResult) -> PhaseResult:
    """Return a phase without its modulation, which would stay in memory with every kept step."""
    return replace(phase, maps=phase.maps[[name for name in ("phase", "sigma", "texture") if name in phase.maps]])


def _contiguous(dataset: xr.Dataset, names: Iterable[str]) -> dict[str, tuple[tuple[Hashable, ...], np.ndarray]]:
    """Return dimensions and contiguous float32 values of some variables of a dataset."""
    variables = {name: dataset.variables[name] for name in names}
    return {name: (each.dims, np.ascontiguousarray(each.values, np.float32)) for name, each in variables.items()}
