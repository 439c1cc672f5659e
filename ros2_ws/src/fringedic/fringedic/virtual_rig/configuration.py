"""Configuration of a virtual rig: the ``virtual_rig`` section of a rig file in mm, µm and degree, and the presets."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fringedic.errors import VirtualRigError
from fringedic.virtual_rig.arrangements import changes_of

# Images of a size have this many times fewer pixels along each side than those of the paper, on the same field.
SIZES: dict[str, int] = {"full": 1, "small": 4, "tiny": 8}


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class LensConfiguration(_Section):
    """Distortion of the camera's lens: Brown's model, and a smooth bump that Brown's model does not describe."""

    k1: float = Field(default=0.0, ge=-10, le=10, description="Radial, as in OpenCV: (x, y) *= 1 + k1 r^2 + k2 r^4.")
    k2: float = Field(default=0.0, ge=-100, le=100, description="Radial, of the fourth power.")
    p1: float = Field(default=0.0, ge=-1, le=1, description="Tangential, as in OpenCV.")
    p2: float = Field(default=0.0, ge=-1, le=1, description="Tangential, as in OpenCV.")
    k3: float = Field(default=0.0, ge=-10_000, le=10_000, description="Radial, of the sixth power.")
    bump_percent: tuple[float, float] = Field(
        default=(0.0, 0.0), description="Shift along x and y (down) at the bump's centre, of the image's width."
    )
    bump_centre_percent: tuple[float, float] = Field(
        default=(0.0, 0.0), description="Place of the bump from the image's centre, of the image's width."
    )
    bump_radius_percent: float = Field(
        default=16.0, gt=0, description="Standard deviation of the bump, of the image's width."
    )


class CameraConfiguration(_Section):
    """Pin-hole camera at (0, 0, distance), looking down at the reference plane."""

    columns: int = Field(default=1280, ge=16, le=8192, description="Image width [px].")
    rows: int = Field(default=960, ge=16, le=8192, description="Image height [px].")
    distance_mm: float = Field(default=400.0, gt=0, description="Distance h0 of the pin-hole from the reference plane.")
    pixel_size_um: float = Field(
        default=50.0, gt=0, description="Length per row on the reference plane, principal point."
    )
    pixel_aspect: float = Field(default=1.0, gt=0, description="Row spacing over column spacing (tau).")
    principal_column: float | None = Field(default=None, description="Principal point [px]; None is the image centre.")
    principal_row: float | None = Field(default=None, description="Principal point [px]; None is the image centre.")
    tilt_x_degree: float = Field(
        default=0.0, gt=-45, lt=45, description="Rotation of the camera about the rig's x axis."
    )
    tilt_y_degree: float = Field(
        default=0.0, gt=-45, lt=45, description="Rotation of the camera about the rig's y axis."
    )
    lens: LensConfiguration = LensConfiguration()


class ProjectorConfiguration(_Section):
    """Pin-hole projector at (x, y, z) that looks at the origin of the rig frame, except for its three angles."""

    columns: int = Field(default=800, ge=16, le=8192, description="Image width [px].")
    rows: int = Field(default=600, ge=16, le=8192, description="Image height [px].")
    x_mm: float = Field(default=180.0, description="Position d along x; positive is right of the camera.")
    y_mm: float = Field(default=0.0, description="Position along y.")
    z_mm: float = Field(default=380.0, gt=0, description="Distance hp of the pin-hole from the reference plane.")
    yaw_degree: float = Field(default=0.0, gt=-45, lt=45, description="Turn about the projector's own up axis.")
    pitch_degree: float = Field(default=0.0, gt=-45, lt=45, description="Tilt about the projector's own right axis.")
    roll_degree: float = Field(default=0.0, ge=-180, le=180, description="Roll about the projector's own axis.")
    focal_length_px: float = Field(default=3400.0, gt=0, description="Focal length.")
    principal_column: float | None = Field(default=None, description="Principal point [px]; None is the image centre.")
    principal_row: float | None = Field(default=None, description="Principal point [px]; None is the image centre.")
    k1: float = Field(default=0.0, ge=-1, le=1, description="Radial distortion, as of the camera's lens.")
    k2: float = Field(default=0.0, ge=-100, le=100, description="Radial, of the fourth power.")
    p1: float = Field(default=0.0, ge=-1, le=1, description="Tangential, as in OpenCV.")
    p2: float = Field(default=0.0, ge=-1, le=1, description="Tangential, as in OpenCV.")
    k3: float = Field(default=0.0, ge=-10_000, le=10_000, description="Radial, of the sixth power.")
    gamma: float = Field(
        default=1.0, gt=0, le=5, description="Light = (grey level / 255)^gamma; 1 is a corrected projector."
    )
    defocus_px: float = Field(
        default=0.6,
        ge=0.05,
        le=10,
        description="Standard deviation of the lens's point spread, added to the pixel's square.",
    )
    delay_ms: float = Field(
        default=0.0, ge=0, le=1000, description="Time from handing over a pattern to its first light."
    )
    jitter_ms: float = Field(
        default=0.0, ge=0, le=1000, description="Every pattern's delay is up to this longer or shorter, evenly."
    )
    rise_ms: float = Field(
        default=0.0, ge=0, le=1000, description="Time constant with which the light follows the pattern."
    )
    refresh_hz: float = Field(default=0.0, ge=0, le=10_000, description="Rate of the light's pulses; 0: steady light.")
    refresh_duty: float = Field(
        default=1.0, gt=0, le=1, description="Part of each refresh with light, as much brighter as it is shorter."
    )

    @property
    def is_immediate(self) -> bool:
        """Whether the light is steady and follows a pattern immediately."""
        steady = self.refresh_hz == 0.0 or self.refresh_duty == 1.0
        return steady and self.delay_ms == self.jitter_ms == self.rise_ms == 0.0


class SensorConfiguration(_Section):
    """Exposure, noise and digits of the camera; grey levels are those of the chosen number of bits."""

    bits: Literal[8, 10, 12, 16] = Field(default=8, description="Digits per pixel; more than 8 give 16-bit images.")
    white_level: float = Field(
        default=0.82, gt=0, le=2, description="Full white on unpainted surface at the origin, part of the full scale."
    )
    exposure_ms: float | None = Field(
        default=None,
        gt=0,
        description="Exposure time of that white level; none: images are equally bright at every exposure time.",
    )
    ambient_light: float = Field(default=0.02, ge=0, le=1, description="Room light relative to the projector's white.")
    background: float = Field(
        default=0.01, ge=0, le=1, description="Brightness beside the specimen, part of the full scale."
    )
    read_noise_grey_level: float = Field(default=1.0, ge=0, description="Standard deviation of the noise in the dark.")
    shot_noise_grey_level: float = Field(default=0.02, ge=0, description="Variance of the noise per grey level.")
    lens_blur_px: float = Field(
        default=0.0,
        ge=0,
        le=10,
        description="Standard deviation of the blur that the lens gives the lit surface, beyond the texture's own.",
    )
    response: float = Field(
        default=1.0, gt=0, le=5, description="Grey level = full scale * (light / full scale)^response; 1 is linear."
    )


class TextureConfiguration(_Section):
    """Random pattern on the surface, including the blur of the camera's lens."""

    kind: Literal["speckle", "furrows", "grain"] = Field(
        default="speckle", description="Sprayed dots, skin or leather."
    )
    feature_um: float = Field(default=200.0, gt=0, description="Full width at half height of the typical dark feature.")
    coverage: float = Field(default=0.5, gt=0, lt=1, description="Part of the surface darker than half (speckle only).")
    floor: float = Field(default=0.12, ge=0, lt=1, description="Darkest reflectance relative to the unpainted surface.")


class RigidSpecimen(_Section):
    """A rigid shape that translates and rotates with the crosshead: plane, sphere (cap), stepped block or balls."""

    kind: Literal["rigid"] = "rigid"
    shape: Literal["plane", "sphere", "stepped", "balls"] = "plane"
    half_width_mm: float = Field(default=60.0, gt=0, description="The specimen reaches from -this to +this along X.")
    half_height_mm: float = Field(default=50.0, gt=0, description="The specimen reaches from -this to +this along Y.")
    height_mm: float = Field(
        default=0.0, description="Height of the plane at the origin, of the apex, of the lowest floor."
    )
    angle_degree: float = Field(default=0.0, gt=-80, lt=80, description="Plane: raises the +x side towards the camera.")
    angle_y_degree: float = Field(
        default=0.0, gt=-80, lt=80, description="Plane: raises the +y side towards the camera."
    )
    radius_mm: float = Field(default=120.0, gt=0, description="Sphere and balls: radius.")
    spacing_mm: float = Field(
        default=0.0, ge=0, description="Balls: distance of the two centres along X; 0 for a single ball."
    )
    cap_degree: float = Field(
        default=60.0, gt=0, lt=85, description="Balls: steepest slope of the caps where they meet their base."
    )
    step_mm: float = Field(
        default=4.0, description="Stepped: height of the block; its upper part is half as high again."
    )
    transition_mm: float = Field(default=0.25, gt=0, description="Stepped: length scale of the walls (tanh).")
    block_half_width_mm: float = Field(default=12.0, gt=0, description="Stepped: half width of the block along X.")
    step_y_mm: float = Field(default=4.0, description="Stepped: Y above which the surface is half a block higher.")
    translation: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="Translation per crosshead travel."
    )
    rotation_degree_per_mm: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="Rotation vector about the origin per crosshead travel."
    )


class PlateSpecimen(_Section):
    """A flat plate under tension along y, slightly bowed and slanted in its grips."""

    kind: Literal["plate"] = "plate"
    half_width_mm: float = Field(default=30.0, gt=0)
    half_height_mm: float = Field(default=50.0, gt=0)
    gauge_length_mm: float = Field(
        default=100.0, gt=0, description="Distance of the grips; the lower one stands still."
    )
    poisson: float = Field(default=0.33, ge=0, le=0.5)
    bow_mm: float = Field(default=0.4, description="Height of the bow at the centre before loading.")
    straightening_mm: float = Field(default=0.4, gt=0, description="Crosshead travel that halves the bow.")
    angle_degree: float = Field(default=0.5, gt=-45, lt=45, description="Slant that raises the +x side.")
    angle_y_degree: float = Field(default=-0.3, gt=-45, lt=45, description="Slant that raises the +y side.")
    twist_per_mm: float = Field(default=0.008, description="Relative growth of the bow along x.")


class SkinSpecimen(_Section):
    """Skin of a forearm, pulled along +y by a pad; the strain band lies between the pads."""

    kind: Literal["skin"] = "skin"
    half_width_mm: float = Field(default=9.0, gt=0)
    half_height_mm: float = Field(default=8.0, gt=0)
    radius_x_mm: float = Field(default=45.0, gt=0, description="Radius of curvature along x.")
    radius_y_mm: float = Field(default=220.0, gt=0, description="Radius of curvature along y.")
    band_mm: float = Field(
        default=5.0, gt=0, description="Length scale of the strain band: strain is travel / (2 band)."
    )
    pad_reach_mm: float = Field(default=10.0, gt=0, description="Gaussian reach of the pad's pull along x.")
    poisson: float = Field(default=0.35, ge=0, le=1)
    device_angle_degree: float = Field(
        default=30.0, ge=-90, le=90, description="Device against the skin's stiff direction."
    )
    anisotropy: float = Field(default=0.25, ge=0, lt=1, description="Strength of the asymmetry that the angle brings.")
    dip: float = Field(default=0.12, description="Sinking of the band per crosshead travel.")
    relief_um: float = Field(default=15.0, ge=0, description="Depth of the main furrows.")


class LeatherSpecimen(_Section):
    """Folded leather held by a screw: the fold flattens and the piece rotates about the screw."""

    kind: Literal["leather"] = "leather"
    half_width_mm: float = Field(default=30.0, gt=0)
    half_height_mm: float = Field(default=40.0, gt=0)
    fold_mm: float = Field(default=6.0, description="Height of the fold before loading, far from the screw.")
    fold_width_mm: float = Field(default=7.5, gt=0, description="Length scale a of the fold A sech^2(s/a).")
    fold_direction_degree: float = Field(default=65.0, description="Direction along the fold against +x.")
    fold_x_mm: float = Field(default=2.0, description="A point on the crest.")
    fold_y_mm: float = Field(default=0.0, description="A point on the crest.")
    screw_x_mm: float = Field(default=-12.0)
    screw_y_mm: float = Field(default=-18.0)
    growth_mm: float = Field(
        default=14.0, gt=0, description="Length scale over which the fold grows away from the screw."
    )
    flattening_mm: float = Field(
        default=6.0, gt=0, description="Crosshead travel that flattens the fold by a factor e."
    )
    rotation_degree_per_mm: float = Field(default=0.2, description="In-plane rotation about the screw, per travel.")
    stretch_per_mm: float = Field(default=0.001, description="Strain along y per travel.")
    curvature_per_m: float = Field(default=0.8, description="Curvature of the whole piece before loading.")
    lift_per_m_per_mm: float = Field(default=-0.1, description="Change of that curvature per travel.")


class CylinderSpecimen(_Section):
    """A round bar or tube about y in tension and torsion; X is the arc length around it from its crest at +z."""

    kind: Literal["cylinder"] = "cylinder"
    radius_mm: float = Field(default=20.0, gt=0)
    half_height_mm: float = Field(default=30.0, gt=0)
    gauge_length_mm: float = Field(default=60.0, gt=0, description="Distance of the grips; the lower one stands still.")
    poisson: float = Field(default=0.33, ge=0, le=0.5)
    twist_degree_per_mm: float = Field(
        default=1.0, description="Rotation of the upper grip against the lower one, per travel."
    )
    bulge: float = Field(default=0.0, description="Growth of the radius in the middle per travel.")

    @property
    def half_width_mm(self) -> float:
        """Half of the circumference."""
        return math.pi * self.radius_mm


class SpheresSpecimen(_Section):
    """Balls of one size in space, a common object that all sensors around it can measure; the load does not move it."""

    kind: Literal["spheres"] = "spheres"
    radius_mm: float = Field(default=8.0, gt=0)
    centres_mm: tuple[tuple[float, float, float], ...] = Field(
        default=((-16.0, -9.0, 0.0), (15.0, -11.0, 3.0), (-2.0, 12.0, -4.0)),
        min_length=1,
        description="Centres in the frame of the specimen.",
    )

    @property
    def half_width_mm(self) -> float:
        """Half of the spheres' circumferences side by side, with gaps."""
        return 0.5 * self.width_mm * len(self.centres_mm)

    @property
    def width_mm(self) -> float:
        """Width of the material coordinates of one ball."""
        return 2.2 * math.pi * self.radius_mm

    @property
    def half_height_mm(self) -> float:
        """Half of a meridian."""
        return 0.5 * math.pi * self.radius_mm


class ReferencePlaneSpecimen(_Section):
    """The flat plate on the stage that calibrates a rig; the load does not move it."""

    kind: Literal["reference_plane"] = "reference_plane"
    surface: Literal["plain", "grid"] = Field(default="plain", description="Bare, or with the printed grid on it.")
    angle_degree: float = Field(
        default=0.0, gt=-80, lt=80, description="Rotation about the stage's axis; raises the +x side."
    )
    height_mm: float = Field(default=0.0, description="Translation towards the camera.")


class StageConfiguration(_Section):
    """The stage that rotates and lifts the reference plane, and the plane itself."""

    axis_x_mm: float = Field(default=0.0, description="Position of the axis of rotation in the plane of x and z.")
    axis_z_mm: float = Field(default=0.0, description="Position of the axis of rotation in the plane of x and z.")
    axis_yaw_degree: float = Field(
        default=0.0, gt=-45, lt=45, description="Turn of the axis from +y about +z, in the image counter-clockwise."
    )
    axis_pitch_degree: float = Field(
        default=0.0, gt=-45, lt=45, description="Rise of the axis's +y end towards the camera."
    )
    half_width_mm: float = Field(default=80.0, gt=0, description="The plate reaches from -this to +this along X.")
    half_height_mm: float = Field(default=60.0, gt=0, description="The plate reaches from -this to +this along Y.")
    albedo: float = Field(default=0.7, gt=0, le=1, description="Reflectance of the bare plate and the paper.")
    ink: float = Field(default=0.05, ge=0, le=1, description="Reflectance of the print.")
    grid_kind: Literal["lines", "cosine"] = Field(
        default="lines", description="Crossed lines of half the pitch, or the product of two cosines."
    )
    grid_pitch_mm: float = Field(default=0.5, gt=0, description="Period of the grid along both directions.")
    grid_turned_degree: float = Field(default=2.0, description="Turn of the grid, counter-clockwise in the image.")
    grid_blur_um: float = Field(default=30.0, gt=0, description="Blur of the lines: paper, print and lens.")


class PlacementConfiguration(_Section):
    """Pose of the sensor's rig frame in the frame of the specimen, where several sensors look at it."""

    translation_mm: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="Origin of the sensor's rig frame in the frame of the specimen."
    )
    rotation_degree: tuple[float, float, float] = Field(
        default=(0.0, 0.0, 0.0), description="Rotation vector from the sensor's rig frame to that of the specimen."
    )

    @property
    def is_identity(self) -> bool:
        """Whether both frames are one."""
        return not any((*self.translation_mm, *self.rotation_degree))


class LoadFrameConfiguration(_Section):
    """The testing machine that stretches the specimen."""

    maximum_position_mm: float = Field(
        default=1.0, gt=0, description="Crosshead travel from the unloaded specimen at 0."
    )
    maximum_speed_mm_per_s: float = Field(default=5.0, gt=0)
    acceleration_mm_per_s2: float = Field(default=10.0, gt=0, description="Ramp of the speed at start and stop.")
    stiffness_n_per_mm: float = Field(default=2000.0, gt=0, description="Force per travel of fast loading.")
    relaxation: float = Field(default=0.02, ge=0, lt=1, description="Part of the force lost in a long hold.")
    relaxation_time_s: float = Field(default=5.0, gt=0)
    play_mm: float = Field(default=0.0, ge=0, description="Dead travel of the grips before force builds up or falls.")
    force_noise_n: float = Field(default=0.5, ge=0, description="Standard deviation of the force reading.")


Specimen = Annotated[
    RigidSpecimen
    | PlateSpecimen
    | SkinSpecimen
    | LeatherSpecimen
    | CylinderSpecimen
    | SpheresSpecimen
    | ReferencePlaneSpecimen,
    Field(discriminator="kind"),
]


class VirtualRigConfiguration(_Section):
    """Complete configuration of a virtual rig, which reproduces all its images."""

    seed: int = Field(default=0, ge=0, lt=2**32, description="Seed of texture and noise.")
    camera: CameraConfiguration = CameraConfiguration()
    projector: ProjectorConfiguration = ProjectorConfiguration()
    sensor: SensorConfiguration = SensorConfiguration()
    texture: TextureConfiguration = TextureConfiguration()
    specimen: Specimen = PlateSpecimen()
    stage: StageConfiguration = StageConfiguration()
    placement: PlacementConfiguration = PlacementConfiguration()
    load_frame: LoadFrameConfiguration = LoadFrameConfiguration()

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """Return the configuration in nested dictionaries, such as the ``virtual_rig`` section of a rig file.

        Parameters
        ----------
        values
            The fields of this class. With ``preset`` (and optionally ``size``, ``ideal`` and ``alignment``) the other
            entries change single values of that preset. With ``arrangement`` and ``place`` (and optionally ``size``)
            they change those of one of several sensors, see `virtual_sensors`.

        Raises
        ------
        VirtualRigError
            An entry is unknown, missing or out of range; the message names it.

        Examples
        --------
        >>> entries = {"preset": "plate", "size": "small", "sensor": {"bits": 12}}
        >>> VirtualRigConfiguration.from_dict(entries).sensor.bits
        12
        """
        entries = copy.deepcopy(dict(values))
        if "preset" in entries:
            base = preset(
                entries.pop("preset"),
                size=entries.pop("size", "full"),
                ideal=entries.pop("ideal", False),
                alignment=entries.pop("alignment", None),
            )
            entries = _merge(base, entries)
        elif "arrangement" in entries:
            base = arranged(entries.pop("arrangement"), entries.pop("place", ""), size=entries.pop("size", "full"))
            entries = _merge(base, entries)
        try:
            return cls.model_validate(entries)
        except ValidationError as error:
            raise VirtualRigError(
                "virtual_rig: "
                + "; ".join(
                    f"{'.'.join(str(part) for part in problem['loc'])}: {problem['msg']} (got {problem['input']!r})"
                    for problem in error.errors()
                )
            ) from error


def _merge(base: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with single values changed; a section of another kind replaces the whole section."""
    merged = dict(base)
    for name, value in changes.items():
        section = merged.get(name)
        if isinstance(section, dict) and isinstance(value, Mapping):
            kind = section.get("kind")
            value = _merge(section, value) if value.get("kind", kind) == kind else dict(value)
        merged[name] = value
    return merged


# Alignments of a rig: entries of its sections. The usual one has small errors, as a real rig.
_ALIGNMENTS: dict[str, dict[str, dict[str, float]]] = {
    "aligned": {"camera": {}, "projector": {}, "stage": {}},
    "usual": {
        "camera": {"tilt_x_degree": 0.12, "tilt_y_degree": -0.08},
        "projector": {"roll_degree": 0.7, "pitch_degree": 0.2, "yaw_degree": -0.15},
        "stage": {},
    },
    # the projector looks 1.5 mm beside the origin, 420 mm away
    "misaligned": {
        "camera": {"tilt_x_degree": 0.2},
        "projector": {"yaw_degree": -0.1847, "roll_degree": 0.7},
        "stage": {"axis_x_mm": 1.0},
    },
    "distorted": {
        "camera": {"tilt_x_degree": 0.2},
        "projector": {"yaw_degree": -0.1847, "roll_degree": 0.7, "k1": 0.1},
        "stage": {"axis_x_mm": 1.0},
    },
}

# The macro rig sees 13.06 mm x 9.79 mm: the paper's 10 x 13 mm with the long side along the image rows.
_MACRO_CAMERA = {"distance_mm": 125.0, "pixel_size_um": 10.2}
_MACRO_PROJECTOR = {"x_mm": 55.0, "z_mm": 118.0, "focal_length_px": 6500.0}

_PRESETS: dict[str, dict[str, Any]] = {
    "plate": {
        "specimen": {"kind": "plate"},
        "load_frame": {"maximum_position_mm": 1.0, "stiffness_n_per_mm": 2000.0, "play_mm": 0.02},
    },
    "skin": {
        "camera": _MACRO_CAMERA,
        "projector": _MACRO_PROJECTOR,
        "texture": {"kind": "furrows", "feature_um": 45.0, "floor": 0.2},
        "specimen": {"kind": "skin"},
        "load_frame": {
            "maximum_position_mm": 1.0,
            "maximum_speed_mm_per_s": 1.0,
            "stiffness_n_per_mm": 0.8,
            "relaxation": 0.25,
            "relaxation_time_s": 3.0,
            "force_noise_n": 0.003,
        },
    },
    "leather": {
        "texture": {"kind": "grain", "feature_um": 190.0, "floor": 0.15},
        "specimen": {"kind": "leather"},
        "load_frame": {
            "maximum_position_mm": 6.0,
            "stiffness_n_per_mm": 15.0,
            "relaxation": 0.12,
            "play_mm": 0.1,
            "force_noise_n": 0.05,
        },
    },
    "cylinder": {
        "specimen": {"kind": "cylinder"},
        "load_frame": {"maximum_position_mm": 1.0, "stiffness_n_per_mm": 5000.0, "play_mm": 0.02},
    },
    "rigid": {
        "specimen": {"kind": "rigid", "translation": (1.0, 0.0, 0.0)},
        "load_frame": {"maximum_position_mm": 5.0},
    },
    "plane": {"specimen": {"kind": "rigid", "angle_degree": 10.0}},
    "sphere": {"specimen": {"kind": "rigid", "shape": "sphere", "height_mm": 4.0}},
    "stepped": {"specimen": {"kind": "rigid", "shape": "stepped", "height_mm": -2.0}},
    "reference_plane": {"specimen": {"kind": "reference_plane"}},
}


def preset(name: str, *, size: str = "full", ideal: bool = False, alignment: str | None = None) -> dict[str, Any]:
    """Return the entries of a preset for `VirtualRigConfiguration.from_dict`.

    Parameters
    ----------
    name
        ``plate``, ``skin``, ``leather`` (the specimens of the paper), ``cylinder``, ``rigid`` (a plane that moves along
        x), ``plane`` (at 10 degrees), ``sphere``, ``stepped`` or ``reference_plane`` (the plate that calibrates a rig).
    size
        ``full``: camera 1280x960, projector 800x600; ``small``: a quarter; ``tiny``: an eighth along each side, on the
        same field, with a texture of the same size in pixels.
    ideal
        A perfectly aligned rig without noise.
    alignment
        Another alignment: ``aligned``; ``misaligned``: the projector looks 1.5 mm beside the origin and is rolled
        by 0.7 degree, the camera tilted by 0.2 degree, the stage's axis off by 1 mm; ``distorted``: the same with a
        distorting projector; ``usual``: small errors, the default.

    Raises
    ------
    VirtualRigError
        The name, the size or the alignment is unknown.

    Examples
    --------
    >>> preset("plate", size="tiny")["camera"]["columns"]
    160
    """
    _require_known("preset", name, list(_PRESETS))
    _require_known("size", size, list(SIZES))
    if alignment is not None:
        _require_known("alignment", alignment, list(_ALIGNMENTS))
    scale = SIZES[size]
    sections: dict[str, Any] = copy.deepcopy(_PRESETS[name])
    errors = _ALIGNMENTS["aligned" if ideal else "usual"] if alignment is None else _ALIGNMENTS[alignment]
    camera = {**sections.get("camera", {}), **errors["camera"]}
    projector = {**sections.get("projector", {}), **errors["projector"]}
    texture = sections.get("texture", {})
    if errors is _ALIGNMENTS["usual"]:
        projector["y_mm"] = 1.5 * projector.get("x_mm", 180.0) / 180.0
    full_camera, full_projector = CameraConfiguration(**camera), ProjectorConfiguration(**projector)
    camera["columns"] = full_camera.columns // scale
    camera["rows"] = full_camera.rows // scale
    camera["pixel_size_um"] = full_camera.pixel_size_um * scale
    projector["columns"] = full_projector.columns // scale
    projector["rows"] = full_projector.rows // scale
    projector["focal_length_px"] = full_projector.focal_length_px / scale
    texture["feature_um"] = TextureConfiguration(**texture).feature_um * scale
    sections |= {"camera": camera, "projector": projector, "texture": texture, "stage": dict(errors["stage"])}
    if ideal:
        sections["sensor"] = {"read_noise_grey_level": 0.0, "shot_noise_grey_level": 0.0}
    return sections


def arranged(name: Any, place: Any, *, size: str = "full") -> dict[str, Any]:
    """Return the entries of a sensor of an arrangement for `VirtualRigConfiguration.from_dict`.

    Parameters
    ----------
    name, place
        The arrangement, as of `virtual_sensors`, and the sensor in it.
    size
        As of `preset`.

    Raises
    ------
    VirtualRigError
        The arrangement, the sensor in it or the size is unknown.
    """
    changes = changes_of(name, place)
    return _merge(preset(name, size=size), changes)


def _require_known(entry: str, value: Any, known: list[str]) -> None:
    if value not in known:  # a list compares also what cannot be a key of a dictionary
        raise VirtualRigError(f"virtual_rig: {entry} {value!r} is unknown; choose from {', '.join(known)}")


def slope(degrees: float) -> float:
    """Return the slope of a surface at an angle [degree]."""
    return math.tan(math.radians(degrees))
