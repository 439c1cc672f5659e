"""A rig that may not exist yet: its optics, light, noise, patterns and parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from fringedic.configuration.plan_section import PlanSection
from fringedic.configuration.rig_file import RigFile
from fringedic.configuration.virtual_calibration import calibration_of
from fringedic.errors import CalibrationError, ConfigurationError, PatternError, RigSetupError
from fringedic.frames.noise import ROUNDING_NOISE, CameraNoise
from fringedic.patterns.pattern import Orientation, ProjectedPattern
from fringedic.patterns.render import BRIGHTEST, DARKEST
from fringedic.patterns.response import FULL_SCALE
from fringedic.phase.layout import Layout, layout_of
from fringedic.rig.compatibility import RigSetup, check_calibration
from fringedic.rig.model import RigModel
from fringedic.settings.experiment import SequenceSettings
from fringedic.steps.parameters import CouplingParameters, DicParameters
from fringedic.virtual_rig import VirtualRigConfiguration


@dataclass(frozen=True, eq=False)
class PlannedRig:
    """A rig that may not exist yet: optics, sensor, surface, patterns and parameters.

    Attributes
    ----------
    model
        Optics without lens distortion.
    configuration
        Sensor, projector and texture.
    patterns
        Of one step, whole cycles of shifts, with or without a Gray code.
    dic, coupling
        Parameters of displacement, coupling and strain.
    components
        Section ``plan``; None for a virtual rig, whose depths of field are unlimited.
    exposure_time, settle_time
        Of a frame, and between its pattern and its exposure [s]; the exposure is NaN where it is not known.
    sequence
        Its settings, which contain the motion that steps in motion follow.
    """

    model: RigModel
    configuration: VirtualRigConfiguration
    patterns: tuple[ProjectedPattern, ...]
    dic: DicParameters
    coupling: CouplingParameters
    components: PlanSection | None = None
    exposure_time: float = math.nan
    settle_time: float = 0.0
    sequence: SequenceSettings = field(default_factory=SequenceSettings)

    @classmethod
    def of(cls, rig: RigFile, name: str = "rig file") -> PlannedRig:
        """Return the rig that a rig file plans; `name` is that of the file in errors.

        Raises
        ------
        ConfigurationError
            Sensor, lenses, distances or sizes are not known.
        RigSetupError
            The patterns are not whole cycles of shifts at one exposure time.
        """
        configuration = planned_configuration(rig, name)
        if rig.sequence.exposures_ms or rig.sequence.fringe_order == "one_image":
            raise RigSetupError(
                f"{name}: a plan predicts phase shifting at one exposure time; remove sequence.exposures_ms and set "
                "sequence.fringe_order to pitches or gray_code"
            )
        # The distortion moves pixels and hardly changes their noise.
        camera = configuration.camera
        model = calibration_of(
            configuration.model_copy(update={"camera": camera.model_copy(update={"lens": type(camera.lens)()})})
        )
        try:
            check_calibration(model, RigSetup(None, None, rig.patterns()))
        except (CalibrationError, PatternError) as error:
            raise RigSetupError(f"{name}: {error}") from error
        return cls(
            model,
            configuration,
            tuple(rig.patterns()),
            rig.nodes.dic,
            rig.nodes.coupling,
            rig.plan,
            rig.camera.exposure_time,
            rig.camera.settle_time,
            rig.sequence,
        )

    @property
    def layout(self) -> Layout:
        """Pitches and frames of the sequence."""
        return layout_of(self.patterns)

    @property
    def orientation(self) -> Orientation:
        """Direction of the fringes."""
        return self.patterns[-1].orientation

    @property
    def full_scale(self) -> float:
        """Largest grey level."""
        return 2.0**self.configuration.sensor.bits - 1

    @property
    def angle(self) -> float:
        """Angle between the camera's axis and the projector [rad]."""
        x, y, z = self.model.projector_position
        return math.atan2(math.hypot(x, y), z)

    @property
    def steepest_slope(self) -> float:
        """Steepest slope of the surface [rad], 0 when unknown."""
        return 0.0 if self.components is None else math.radians(self.components.slope_degree)

    @property
    def noise(self) -> CameraNoise:
        """Noise of a grey level, rounding included."""
        sensor = self.configuration.sensor
        return CameraNoise(math.hypot(sensor.read_noise_grey_level, ROUNDING_NOISE), sensor.shot_noise_grey_level)

    def points(self, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        """Return the points (3, ...) [m] of the reference plane that pixels see."""
        rays = np.stack([column, row, np.ones(column.shape)], axis=-1) @ self.model.ray_matrix.T
        along = -self.model.camera_distance / rays[..., 2]
        points: np.ndarray = np.moveaxis(rays * along[..., None], -1, 0)
        points[2] = 0.0
        return points

    def irradiance(self, points: np.ndarray) -> np.ndarray:
        """Return the light on points (3, ...) of the reference plane, 1 at the origin: Lambert's cosine over r^2."""
        position = np.array(self.model.projector_position)
        distance = np.linalg.norm(np.moveaxis(points, 0, -1) - position, axis=-1)
        return np.asarray((np.linalg.norm(position) / distance) ** 3)

    def projector_blur(self, points: np.ndarray) -> np.ndarray:
        """Return the standard deviation of the projector's blur on points (3, ...) [projector px].

        The lens is focused at the origin. At the depth s an opening of diameter D gives a disc of
        D abs(s - s0) F / (s s0); the standard deviation of a disc along an axis is a quarter of its diameter.
        """
        blur = self.configuration.projector.defocus_px
        aperture = 0.0 if self.components is None else 1e-3 * self.components.projector_aperture_mm
        position = np.array(self.model.projector_position)
        focus = float(np.linalg.norm(position))
        depth = (position - np.moveaxis(points, 0, -1)) @ self.model.projector_axes[:, 2]
        disc = aperture * np.abs(depth - focus) / (depth * focus) * self.model.projector_focal_length
        return np.asarray(np.hypot(blur, disc / 4))

    def modulation(self, pitch: float, blur: np.ndarray) -> tuple[float, np.ndarray]:
        """Return mean and amplitude of the projected fringes, parts of the projector's full light.

        The amplitude is reduced by the square of a pixel and the Gaussian blur [projector px].
        """
        phase = 2 * np.pi * np.arange(256) / 256
        levels = (BRIGHTEST + DARKEST) / 2 + (BRIGHTEST - DARKEST) / 2 * np.cos(phase)
        light = (levels / FULL_SCALE) ** self.configuration.projector.gamma
        amplitude = 2 * float(np.mean(light * np.cos(phase)))
        passed = np.sinc(1 / pitch) * np.exp(-2 * (np.pi * blur / pitch) ** 2)
        return float(light.mean()), np.asarray(amplitude * passed)


def pixel_ripple(pitch: float, blur: float) -> float:
    """Return the RMS phase error that the pixels of a sharp projector cause [rad].

    Fringes of the frequency 1/p, shown by pixels, have images of the frequencies 1 - 1/p and 1 + 1/p [1/px], whose
    phases move with the shifts as those of the fringes do. All pass through the square of a pixel and the Gaussian
    blur. Both images have the same phase relative to the fringes, so that their effects add.

    Parameters
    ----------
    pitch
        Of the fringes [projector px].
    blur
        Standard deviation of the blur [projector px].

    Examples
    --------
    >>> round(pixel_ripple(10.0, 0.3), 4), round(pixel_ripple(10.0, 0.6), 4)
    (0.0266, 0.0003)
    """
    waves = np.array([1 / pitch, 1 - 1 / pitch, 1 + 1 / pitch])
    fringe, below, above = np.sinc(waves) * np.exp(-2 * (math.pi * blur * waves) ** 2)
    return float(abs(below) + abs(above)) / float(fringe) / math.sqrt(2)


def planned_configuration(rig: RigFile, name: str) -> VirtualRigConfiguration:
    """Return the rig that a rig file plans as a virtual rig: that of its section plan, or of virtual_rig without one.

    Parameters
    ----------
    rig
        The content of the rig file.
    name
        Of the file, for the error.

    Raises
    ------
    ConfigurationError
        The file has neither section, or does not state the sizes of camera and projector.
    """
    if rig.plan is None and rig.virtual_rig is None:
        raise ConfigurationError(
            f"{name}: has no section plan, so sensor, lenses and distances are not known; "
            f"`fringedic plan planned` shows an example"
        )
    if rig.projector is None:
        raise ConfigurationError(f"{name}: has no projector to plan; add the section projector with width and height")
    if rig.plan is None:
        return rig.virtual_configuration()
    sizes = rig.camera_size(), rig.projector_size()
    if sizes[0] is None or sizes[1] is None:
        raise ConfigurationError(f"{name}: a plan needs width and height of camera and projector")
    bits = rig.camera.bits or 8
    return VirtualRigConfiguration.from_dict(rig.plan.virtual_entries(sizes[0], sizes[1], bits))
