"""Rig files: what a person writes, in mm, degree, pixel and millisecond, checked before anything starts.

The library and every message speak SI; the translation happens here and nowhere else.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.polynomial import chebyshev
from pydantic import Discriminator, Field, Tag, model_validator

from fringedic.calibration.history import recorded_checks
from fringedic.calibration.result import RigCalibration
from fringedic.camera import DistortionMap
from fringedic.chain import CouplingParameters, DicParameters, PhaseParameters
from fringedic.errors import CalibrationFileError, FringedicError, InvalidCalibrationError, RigFileError
from fringedic.facts import CalibrationFacts, CheckFacts, Facts, HardwareFacts, NoiseFacts, SpecimenFacts
from fringedic.patterns import FringeOrder, step_sequence
from fringedic.programme import Programme
from fringedic.rig import RigModel
from fringedic.sequence import Projection
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration
from fringedic.virtual_rig.configuration import LensConfiguration, ReferencePlaneSpecimen
from fringedic.virtual_rig.optics import camera_optics, projector_optics
from fringedic.yaml_section import Section, load_sections

MILLI = 1e-3
LATEST_CHECKS = 5  # of the calibration that a recording tells
_LEAST_TURN, _GOOD_TURN = 2.0, 12.0  # [degree] of the plane when the grid on it is seen once more
FINEST_DEFAULT_PITCH_PX = 8.0
LENS_ORDER = 20  # of the polynomials that stand for the lens of a virtual rig; 2e-6 px are left of an odd one
LENS_POINTS = 60
VIRTUAL_RIG = "virtual_rig"


class CameraSection(Section):
    """The camera of the rig."""

    source: Literal["virtual", "files", "video", "aravis", "v4l2", "topic"] = Field(
        description="virtual: the virtual rig; files: images from a folder; video: a video file; aravis: a GigE or "
        "USB3 Vision camera; v4l2: a USB camera (UVC); topic: any camera with a ROS 2 driver of its own."
    )
    width: int | None = Field(None, ge=16, le=32768, description="Image width [px]; known from a virtual rig.")
    height: int | None = Field(None, ge=16, le=32768, description="Image height [px]; known from a virtual rig.")
    exposure_ms: float = Field(10.0, gt=0, le=60e3, description="Exposure time [ms].")
    settle_ms: float = Field(
        0.0, ge=0, le=60e3, description="Time between the pattern on the screen and the exposure [ms]."
    )
    files: str | None = Field(
        None,
        description="Images for the source 'files', a folder or a pattern such as a/*.tif; file of the source 'video'.",
    )
    topic: str | None = Field(None, description="Images of the source 'topic', such as /cam/image_raw.")
    stamp_of: Literal["start", "middle", "end"] = Field(
        "end", description="Moment of the exposure that stamps of the sources 'topic' and 'v4l2' are of; end is safe."
    )

    camera: str = Field(
        "", description="Identifier or network address of a real camera, empty: the only one; of 'v4l2' its path."
    )
    pixel_format: Literal["Mono8", "Mono10", "Mono12", "Mono16"] = Field("Mono8", description="Of a real camera.")
    first_column: int = Field(0, ge=0, le=32768, description="Of the part of a real camera's sensor [px].")
    first_row: int = Field(0, ge=0, le=32768, description="Of the part of a real camera's sensor [px].")
    gain_db: float = Field(0.0, ge=-100, le=100, description="Gain of a real camera [dB].")
    trigger: Literal["internal", "software", "external_edge", "external_level"] = Field(
        "software", description="What begins an exposure of a real camera."
    )
    trigger_line: str = Field("Line1", description="Input of a real camera's external triggers.")
    packet_size_byte: int = Field(0, ge=0, le=65535, description="Network packets of a real camera; 0: the largest.")

    @model_validator(mode="after")
    def _files_belong_to_their_source(self) -> CameraSection:
        if (self.source in ("files", "video")) != (self.files is not None):
            raise ValueError("source: files needs the key files, and so does video; no other source has it")
        if (self.source == "topic") != (self.topic is not None):
            raise ValueError("source: topic needs the key topic, and only this source has it")
        if self.source == "v4l2" and not self.camera:
            raise ValueError("source: v4l2 needs the key camera, a path such as /dev/video0")
        if self.source in ("aravis", "v4l2", "topic") and (self.width is None or self.height is None):
            raise ValueError(f"source: {self.source} needs width and height, the size of its images")
        return self

    @property
    def exposure_time(self) -> float:
        """Exposure time [s]."""
        return self.exposure_ms * MILLI

    @property
    def settle_time(self) -> float:
        """Time between pattern and exposure [s]."""
        return self.settle_ms * MILLI


class ProjectorSection(Section):
    """The projector of the rig."""

    source: Literal["virtual", "display"] = Field(
        "virtual",
        description="virtual: shows its image to the virtual rig only; display: a projector on this computer.",
    )
    display: int = Field(0, ge=0, le=15, description="Which of this computer's displays the projector is, from 0 on.")
    width: int | None = Field(None, ge=16, le=32768, description="Image width [px]; known from a virtual rig.")
    height: int | None = Field(None, ge=16, le=32768, description="Image height [px]; known from a virtual rig.")
    response_curve: str | None = Field(
        None, description="YAML file of the response curve that the patterns make up for, relative to this file."
    )

    @model_validator(mode="after")
    def _display_has_a_size(self) -> ProjectorSection:
        if self.source == "display" and (self.width is None or self.height is None):
            raise ValueError("source: display needs width and height, the projector's own resolution")
        return self


class SequenceSection(Section):
    """The fringe patterns of one step."""

    pitches_px: list[Annotated[float, Field(ge=2)]] | None = Field(
        None,
        min_length=1,
        max_length=8,
        description="Fringe pitches, coarse to fine [projector pixel]; the coarsest covers the width in view. "
        "By default the projector's width, a fifth, a twentieth and an eightieth of it, none below 8 px.",
    )
    shifts: int = Field(4, ge=3, le=64, description="Phase shifts per pitch.")
    orientation: Literal["vertical", "horizontal"] = Field("vertical", description="Direction of the fringes.")
    fringe_order: FringeOrder = Field(
        "pitches",
        description="What tells the fringe orders: each coarser pitch the next, or a Gray code of the finest pitch; "
        "one_image: nothing, a single image of the finest pitch is shown, for fast events.",
    )
    grey_frame: bool = Field(
        False, description="With one_image: grey light before it, which takes the texture of the surface out."
    )
    exposures_ms: list[Annotated[float, Field(gt=0, le=60e3)]] | None = Field(
        None,
        min_length=2,
        max_length=8,
        description="Exposure times at which every pattern is taken, for surfaces with glare and dark parts [ms]; by "
        "default the camera's own alone.",
    )

    @model_validator(mode="after")
    def _coarse_to_fine(self) -> SequenceSection:
        pitches = self.pitches_px or []
        if any(fine >= coarse for coarse, fine in pairwise(pitches)):
            raise ValueError("pitches_px must become smaller from one to the next")
        return self

    @model_validator(mode="after")
    def _exposures_differ(self) -> SequenceSection:
        if len(set(self.exposures_ms or [])) < len(self.exposures_ms or []):
            raise ValueError("exposures_ms must differ from each other")
        return self

    @property
    def exposure_times(self) -> list[float]:
        """Exposure times of every pattern [s]; empty: the camera's own."""
        return [time * MILLI for time in self.exposures_ms or ()]


class CalibratedCamera(Section):
    """Pin-hole of the camera."""

    width_px: int = Field(ge=16, description="Image width.")
    height_px: int = Field(ge=16, description="Image height.")
    distance_mm: float = Field(gt=0, description="Distance h0 from the reference plane.")
    pixel_size_mm: float = Field(gt=0, description="Length per row on the reference plane at the principal point.")
    pixel_aspect: float = Field(1.0, gt=0, description="Row spacing over column spacing (tau).")
    principal_column_px: float | None = Field(None, description="By default the centre of the image.")
    principal_row_px: float | None = Field(None, description="By default the centre of the image.")
    tilt_x_degree: float = Field(0.0, gt=-45, lt=45, description="Rotation of the camera about x.")
    tilt_y_degree: float = Field(0.0, gt=-45, lt=45, description="Rotation of the camera about y.")


class CalibratedProjector(Section):
    """Pin-hole of the projector."""

    width_px: int = Field(ge=16, description="Image width.")
    height_px: int = Field(ge=16, description="Image height.")
    position_mm: list[float] = Field(min_length=3, max_length=3, description="(d, y, hp) of its pin-hole.")
    yaw_pitch_roll_degree: list[float] = Field(
        [0.0, 0.0, 0.0], min_length=3, max_length=3, description="Against the attitude that looks at the origin."
    )
    focal_length_px: float = Field(gt=0, description="Focal length.")
    principal_column_px: float | None = Field(None, description="By default the centre of the image.")
    principal_row_px: float | None = Field(None, description="By default the centre of the image.")
    k1: float = Field(0.0, ge=-1, le=1, description="Radial distortion.")


class CovarianceSection(Section):
    """Covariance of the fitted parameters in SI units, row-major."""

    parameters: list[str] = Field([], description="Their names.")
    values: list[float] = Field([], description="One per pair of parameters.")


class CalibrationSection(Section):
    """Pin-hole model of camera and projector, laid out as in the file that a calibration writes."""

    identifier: str = Field("rig file", description="Names this calibration in results.")
    model: Literal["paper", "general"] = Field("general", description="paper: no angles and no distortion.")
    source: str = Field("", description="Where it came from; by default the rig file.")
    camera: CalibratedCamera
    projector: CalibratedProjector
    covariance_si: CovarianceSection = CovarianceSection()

    def rig_model(self, rig_file: str) -> RigModel:
        """Return the model in SI units."""
        camera, projector = self.camera, self.projector
        return RigModel(
            identifier=self.identifier,
            model=self.model,
            source=self.source or rig_file,
            camera_width=camera.width_px,
            camera_height=camera.height_px,
            camera_distance=camera.distance_mm * MILLI,
            pixel_size=camera.pixel_size_mm * MILLI,
            pixel_aspect=camera.pixel_aspect,
            principal_column=_centre(camera.principal_column_px, camera.width_px),
            principal_row=_centre(camera.principal_row_px, camera.height_px),
            camera_tilt_x=math.radians(camera.tilt_x_degree),
            camera_tilt_y=math.radians(camera.tilt_y_degree),
            projector_width=projector.width_px,
            projector_height=projector.height_px,
            projector_position=_triple(value * MILLI for value in projector.position_mm),
            projector_rotation=_triple(math.radians(value) for value in projector.yaw_pitch_roll_degree),
            projector_focal_length=projector.focal_length_px,
            projector_principal_column=_centre(projector.principal_column_px, projector.width_px),
            projector_principal_row=_centre(projector.principal_row_px, projector.height_px),
            projector_k1=projector.k1,
            parameter_names=tuple(self.covariance_si.parameters),
            covariance=tuple(self.covariance_si.values),
        )


class ReferencePlaneSection(Section):
    """The plane that calibrates the rig, and where it is put."""

    grid_pitch_mm: float | None = Field(
        None, gt=0, description="Distance of the printed grid's lines; known from a virtual rig."
    )
    grid_angles_degree: list[Annotated[float, Field(gt=-80, lt=80)]] | None = Field(
        None,
        description="Angles at which the grid is seen besides 0, on both sides: they tell a tilted camera from a lens "
        "off its axis. By default those of angles_degree that are nearest to -12 and 12; [] for none.",
    )
    grid_frames: int = Field(8, ge=1, le=1000, description="Frames of the grid, averaged against noise.")
    angles_degree: list[Annotated[float, Field(gt=-80, lt=80)]] = Field(
        [0.0, -18.0, -12.0, -6.0, 6.0, 12.0, 18.0],
        min_length=1,
        description="Angles of the plain plane; above 0 the +x side is nearer to the camera. The first is measured "
        "again at the end.",
    )
    heights_mm: list[float] | None = Field(None, description="Heights of the same planes; by default all 0.")
    held_out: list[Annotated[int, Field(ge=1)]] = Field(
        [5], description="Planes, counted from 1, that test the calibration and are not used by it."
    )
    sigma_angle_degree: float = Field(0.0, ge=0, le=10, description="Standard deviation of a single angle.")
    sigma_height_mm: float = Field(0.0, ge=0, le=10, description="Standard deviation of a single height.")

    @model_validator(mode="after")
    def _lists_belong_together(self) -> ReferencePlaneSection:
        count = len(self.angles_degree)
        if self.heights_mm is not None and len(self.heights_mm) != count:
            raise ValueError(f"{count} angles_degree and {len(self.heights_mm)} heights_mm: give one of each per plane")
        if any(number > count for number in self.held_out):
            raise ValueError(f"held_out names planes {self.held_out}, there are {count}")
        grid = self.grid_angles_degree
        if grid and not min(grid) <= -_LEAST_TURN < _LEAST_TURN <= max(grid):
            raise ValueError(f"grid_angles_degree {grid}: angles on both sides are needed, {_LEAST_TURN:g} or more")
        return self

    @property
    def grid_angles(self) -> list[float]:
        """Angles of the plane at which the grid is seen besides 0 [rad]."""
        chosen = self.grid_angles_degree
        if chosen is None:
            sides = [[angle for angle in self.angles_degree if side * angle >= _LEAST_TURN] for side in (-1, 1)]
            chosen = [min(side, key=lambda angle: abs(abs(angle) - _GOOD_TURN)) for side in sides] if all(sides) else []
        return [math.radians(angle) for angle in chosen]

    @property
    def angles(self) -> list[float]:
        """Angles of the planes [rad]."""
        return [math.radians(angle) for angle in self.angles_degree]

    @property
    def heights(self) -> list[float]:
        """Heights of the planes [m]."""
        return [height * MILLI for height in self.heights_mm or [0.0] * len(self.angles_degree)]

    @property
    def sigma_angle(self) -> float:
        """Standard deviation of a single angle [rad]."""
        return math.radians(self.sigma_angle_degree)

    @property
    def sigma_height(self) -> float:
        """Standard deviation of a single height [m]."""
        return self.sigma_height_mm * MILLI


class LoadFrameSection(Section):
    """The testing machine."""

    source: Literal["simulated", "machine", "controller", "external"] = Field(
        "simulated",
        description="simulated: the one of the virtual rig; machine: described by a file; controller: ros2_control "
        "publishes joint states and wrench; external: somebody publishes load_frame/state.",
    )
    file: str | None = Field(None, description="Machine file of the source 'machine', beside the rig file.")
    joint_states_topic: str = Field("/joint_states", description="Of the source 'controller'.")
    joint: str = Field("crosshead", description="Joint of the source 'controller'.")
    wrench_topic: str = Field("/wrench", description="Of the source 'controller'.")
    force_axis: Literal["x", "y", "z"] = Field("z", description="Axis of the force of the source 'controller'.")
    force_sign: Literal[-1, 1] = Field(1, description="-1 when the controller's tension is negative.")
    rate_hz: float = Field(100.0, gt=0, le=1000, description="Samples of force and position per second.")
    hold_required: bool = Field(True, description="No step while the machine does not hold.")
    load_drift_n: float = Field(
        0.0, ge=0, le=1e6, description="Largest change of the force over the exposures of a step; 0: any."
    )
    position_drift_um: float = Field(
        0.0, ge=0, le=1e6, description="Largest change of the crosshead's position over the exposures; 0: any."
    )

    @model_validator(mode="after")
    def _file_belongs_to_its_source(self) -> LoadFrameSection:
        if (self.source == "machine") != (self.file is not None):
            raise ValueError("source: machine needs the key file, and only this source has it")
        return self


class ExtensometerSection(Section):
    """Two pads on the surface whose distance is followed in a free run of the camera between the steps."""

    first_px: list[Annotated[int, Field(ge=0, le=32768)]] = Field(
        min_length=2, max_length=2, description="Column and row of the first pad's centre in the reference [px]."
    )
    second_px: list[Annotated[int, Field(ge=0, le=32768)]] = Field(
        min_length=2, max_length=2, description="Column and row of the second pad's centre [px]."
    )
    pad_px: int = Field(48, ge=16, le=256, description="Width of a pad's window [px].")
    rate_hz: float = Field(30.0, gt=0, le=1000, description="Frames per second of the free run.")
    largest_sigma_ustrain: float = Field(
        1000.0, gt=0, le=1e6, description="A strain that is less certain than this counts as invalid [µstrain]."
    )


class NodesSection(Section):
    """Parameters of the processing nodes."""

    phase: PhaseParameters = PhaseParameters()
    dic: DicParameters = DicParameters()
    coupling: CouplingParameters = CouplingParameters()


class RecordingSection(Section):
    """What is recorded where."""

    folder: str = Field("recordings", description="Folder for recordings, relative to where the command is given.")
    process: bool = Field(
        True, description="Measure while the test runs; false: only record, everything is measured at the end."
    )
    derived: bool = Field(True, description="Also record phase maps, displacements and clouds.")
    compression: Literal["zstd", "none"] = Field(
        "none", description="zstd saves a fifth of the room and takes two to three times the processor time."
    )


Calibration = Annotated[
    Annotated[str, Tag("file")] | Annotated[CalibrationSection, Tag("values")],
    Discriminator(lambda value: "values" if isinstance(value, (Mapping, CalibrationSection)) else "file"),
]


class RigFile(Section):
    """Everything that a rig is made of.

    ``calibration`` is the parameters themselves, the path of a calibration file (relative to the rig file), or the
    word ``virtual_rig`` for the exact parameters of the virtual rig. ``virtual_rig`` is passed on to
    `fringedic.virtual_rig.VirtualRigConfiguration`.
    """

    namespace: str = Field("rig", pattern=r"^([A-Za-z]\w*(/[A-Za-z]\w*)*)?$", description="ROS namespace of the rig.")
    camera: CameraSection
    projector: ProjectorSection | None = None
    sequence: SequenceSection = SequenceSection()
    calibration: Calibration | None = None
    reference_plane: ReferencePlaneSection = ReferencePlaneSection()
    load_frame: LoadFrameSection | None = None
    extensometer: ExtensometerSection | None = None
    nodes: NodesSection = NodesSection()
    noise_floor_file: str | None = Field(
        None, description="Noise floor that `fringedic noise` wrote, relative to this file; recordings carry it."
    )
    region_file: str | None = Field(
        None,
        description="Polygons that `fringedic region` wrote, relative to this file: what the displacement measures.",
    )
    virtual_rig: dict[str, Any] | None = None
    recording: RecordingSection = RecordingSection()
    specimen: SpecimenFacts = SpecimenFacts()
    hardware: HardwareFacts = HardwareFacts()
    programme: Programme | None = None

    @model_validator(mode="after")
    def _virtual_parts_have_their_rig(self) -> RigFile:
        users = [
            name
            for name, used in (
                ("camera.source: virtual", self.camera.source == "virtual"),
                ("projector.source: virtual", self.projector is not None and self.projector.source == "virtual"),
                ("calibration: virtual_rig", self.calibration == VIRTUAL_RIG),
                ("load_frame.source: simulated", self.load_frame is not None and self.load_frame.source == "simulated"),
            )
            if used
        ]
        if users and self.virtual_rig is None:
            raise ValueError(f"{users[0]} needs the section virtual_rig, for example virtual_rig: {{preset: plate}}")
        return self

    @model_validator(mode="after")
    def _relative_phases_are_wanted(self) -> RigFile:
        if self.sequence.fringe_order == "one_image" and self.nodes.phase.relative_phase != "accept":
            raise ValueError(
                "sequence.fringe_order: one_image measures phases up to whole fringes only, and shapes that may be off "
                "by as many; if that will do, set nodes.phase.relative_phase: accept"
            )
        return self

    def virtual_configuration(self) -> VirtualRigConfiguration:
        """Return the virtual rig of this file; only where there is one."""
        return VirtualRigConfiguration.from_dict(self.virtual_rig or {})

    def camera_size(self) -> tuple[int, int] | None:
        """(width, height) of the images [px], None when only the image files know."""
        return self._size(self.camera, "camera")

    def projector_size(self) -> tuple[int, int] | None:
        """(width, height) of the projector's image [px], None without a projector."""
        return None if self.projector is None else self._size(self.projector, "projector")

    def grid_pitch(self) -> float | None:
        """Distance of the printed grid's lines [m], None when nobody says."""
        if self.reference_plane.grid_pitch_mm is not None:
            return self.reference_plane.grid_pitch_mm * MILLI
        if self.virtual_rig is not None:
            return self.virtual_configuration().stage.grid_pitch_mm * MILLI
        return None

    def pitches(self) -> list[float]:
        """Fringe pitches, coarse to fine [projector pixel]; empty without a projector."""
        size = self.projector_size()
        if size is None:
            return []
        if self.sequence.pitches_px is not None:
            return list(self.sequence.pitches_px)
        return [size[0] / part for part in (1, 5, 20, 80) if part == 1 or size[0] / part >= FINEST_DEFAULT_PITCH_PX]

    def projections(self) -> list[Projection]:
        """What the frames of one step show, in their order."""
        size, sequence = self.projector_size(), self.sequence
        if size is None:
            return []
        pitches = self.pitches()
        shown = step_sequence(
            *size,
            pitches,
            [sequence.shifts] * len(pitches),
            sequence.orientation,
            sequence.fringe_order,
            grey_frame=sequence.grey_frame,
        )
        return [projection for projection in shown.projections for _ in sequence.exposures_ms or [0]]

    def facts(self, path: str | os.PathLike[str]) -> Facts:
        """Return what is known of specimen, hardware and calibration; `path` is where this file was read."""
        known = CalibrationFacts()
        if isinstance(self.calibration, str) and self.calibration != VIRTUAL_RIG:
            known = _calibration_facts(Path(path).parent / self.calibration)
        noise = NoiseFacts()
        if self.noise_floor_file is not None:
            noise = NoiseFacts.load(Path(path).parent / self.noise_floor_file)
        return Facts(specimen=self.specimen, hardware=self.hardware, calibration=known, noise=noise)

    def _size(self, section: CameraSection | ProjectorSection, name: str) -> tuple[int, int] | None:
        if section.source == "virtual":
            part = getattr(self.virtual_configuration(), name)
            size = (part.columns, part.rows)
            given = (section.width or size[0], section.height or size[1])
            if given != size:
                raise RigFileError(
                    f"{name} is {given[0]}x{given[1]} px, the virtual rig's {name} has {size[0]}x{size[1]} px; "
                    "leave width and height out to take those"
                )
            return size
        if section.width is None or section.height is None:
            return None
        return section.width, section.height


def load_rig_file(path: str | os.PathLike[str]) -> RigFile:
    """Read and check a rig file.

    Raises
    ------
    RigFileError
        The file cannot be read, or a key is unknown, missing or out of its range; the message names file and key.
    """
    rig = load_sections(Path(path), RigFile)
    try:
        rig.camera_size()
        rig.projector_size()
        if rig.virtual_rig is not None:
            rig.virtual_configuration()
        load_calibration(rig, path)
    except FringedicError as error:
        raise RigFileError(f"{path}: {error}") from error
    return rig


def load_programme(path: str | os.PathLike[str]) -> Programme:
    """Read and check a programme of load steps.

    Raises
    ------
    RigFileError
        The file cannot be read, or a key is unknown, missing or out of its range; the message names file and key.
    """
    return load_sections(Path(path), Programme)


def load_calibration(rig: RigFile, path: str | os.PathLike[str]) -> RigModel | None:
    """Return the calibration that a rig file holds or names, None when it has none.

    Parameters
    ----------
    path
        The rig file, beside which a calibration file is looked for.

    Raises
    ------
    RigFileError
        The calibration file cannot be read.
    """
    if rig.calibration is None:
        return None
    if isinstance(rig.calibration, CalibrationSection):
        return rig.calibration.rig_model(str(path))
    if rig.calibration == VIRTUAL_RIG:
        return calibration_of(rig.virtual_configuration())
    file = Path(path).parent / rig.calibration
    if not file.is_file():
        raise RigFileError(f"calibration: there is no file {file}")
    return RigModel.from_yaml(file)


def _calibration_facts(file: Path) -> CalibrationFacts:
    """Return what lies beside a calibration file about its making; nothing where it lies alone."""
    try:
        found = RigCalibration.load(file.parent)
    except (CalibrationFileError, InvalidCalibrationError):
        return CalibrationFacts()
    return CalibrationFacts(
        created=found.created.isoformat(timespec="seconds"),
        residual_um=found.residual * 1e6,
        predicted_um=found.predicted * 1e6,
        held_out_um=None if math.isnan(found.held_out) else found.held_out * 1e6,
        verdict=found.verdict,
        response_fringe=None if math.isnan(found.response) else found.response / (2 * math.pi),
        checks=_checks(file.parent)[-LATEST_CHECKS:],
    )


def _checks(folder: Path) -> list[CheckFacts]:
    try:
        return recorded_checks(folder)
    except CalibrationFileError:
        return []  # an experiment does not wait for a list that nobody can read


def calibration_of(virtual_rig: VirtualRigConfiguration) -> RigModel:
    """Return the exact parameters of a virtual rig as a calibration."""
    optics: dict[str, Any] = {**camera_optics(virtual_rig.camera), **projector_optics(virtual_rig.projector)}
    return RigModel(
        **optics, camera_distortion=_distortion_of(virtual_rig), identifier="virtual rig", source=VIRTUAL_RIG
    )


def _distortion_of(virtual_rig: VirtualRigConfiguration) -> DistortionMap | None:
    """Return what the lens of a virtual rig does, fitted so closely that nothing measurable is left; None without."""
    camera = virtual_rig.camera
    if camera.lens == LensConfiguration():
        return None
    # in front of the plane it needs no texture
    bare = VirtualRig(virtual_rig.model_copy(update={"specimen": ReferencePlaneSpecimen()}))
    rows, columns = (np.unique(np.linspace(0, n - 1, LENS_POINTS).astype(int)) for n in (camera.rows, camera.columns))
    fits = [
        np.linalg.pinv(chebyshev.chebvander(2 * places / (n - 1) - 1, LENS_ORDER))
        for places, n in ((rows, camera.rows), (columns, camera.columns))
    ]
    straight_column, straight_row = (each[np.ix_(rows, columns)] for each in bare.straight_pixels())
    shifts = straight_column - columns, straight_row - rows[:, np.newaxis]
    return DistortionMap(camera.columns, camera.rows, *(fits[0] @ shift @ fits[1].T for shift in shifts))


def _centre(principal: float | None, size: int) -> float:
    return (size - 1) / 2 if principal is None else principal


def _triple(values: Any) -> tuple[float, float, float]:
    first, second, third = values
    return first, second, third
