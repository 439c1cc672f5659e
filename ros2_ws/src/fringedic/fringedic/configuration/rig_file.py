"""Rig file: one YAML file in mm, degree and pixel that describes a whole rig."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, model_validator

from fringedic.configuration.acceptance_section import AcceptanceSection
from fringedic.configuration.calibration_section import CalibrationSection, calibration_metadata
from fringedic.configuration.plan_section import PlanSection
from fringedic.configuration.programme import Programme
from fringedic.configuration.sections import (
    VIRTUAL_RIG,
    ExtensometerSection,
    NodesSection,
    RecordingSection,
    ReferencePlaneSection,
)
from fringedic.configuration.sensors_section import sections_of_sensor
from fringedic.configuration.test_form import DEFAULT_FORM, MOST_FIELDS, FormField, check_form
from fringedic.configuration.yaml_section import Section, load_sections, read_sections, validate
from fringedic.errors import ConfigurationError, FringedicError
from fringedic.frames.sensor import SENSOR, SensorName
from fringedic.metadata import CalibrationMetadata, HardwareMetadata, Metadata, NoiseFloorMetadata, SpecimenMetadata
from fringedic.patterns.pattern import ProjectedPattern
from fringedic.rig.compatibility import RigSetup, check_calibration
from fringedic.rig.model import RigModel
from fringedic.settings.base import MILLI, FilePath
from fringedic.settings.camera import Camera
from fringedic.settings.devices import ImageDeviceSettings
from fringedic.settings.experiment import SequenceSettings
from fringedic.settings.load_frame import LoadFrame, MachineSettings
from fringedic.settings.projector import Projector
from fringedic.settings.signals import Signals
from fringedic.signals import FORCE, POSITION
from fringedic.virtual_rig import VirtualRigConfiguration
from fringedic.wording.arguments import check_arguments
from fringedic.wording.arguments import path as file_path


def _kind_of_calibration(value: Any) -> str:
    if isinstance(value, (Mapping, CalibrationSection)):
        return "a section"
    return "a name" if value == VIRTUAL_RIG else "a file"


Calibration = Annotated[
    Annotated[Literal["virtual_rig"], Tag("a name")]
    | Annotated[FilePath, Tag("a file")]
    | Annotated[CalibrationSection, Tag("a section")],
    Discriminator(_kind_of_calibration),
]


NAMESPACE = r"^([A-Za-z]\w*(/[A-Za-z]\w*)*)?$"
"""Pattern of a ROS namespace without the slash before it."""

# Keys of earlier versions, and what to write instead
REPLACED_KEYS = {
    "nodes.coupling.watch_region_px": "is replaced by nodes.coupling.drift_marker_px with the same order: first "
    "column, first row, width, height",
    "extensometer.pad_px": "is replaced by extensometer.subset_px",
}


class RigFile(Section):
    """The content of a rig file."""

    namespace: str = Field("rig", pattern=NAMESPACE, description="ROS namespace of the rig.")
    sensor: SensorName = Field(
        SENSOR,
        description="Name of the camera with its projector, for a rig with several of them. Topics are in a namespace "
        "of this name, and calibrations, datasets and file names contain it; by default there is no such namespace.",
    )
    camera: Camera = Field(description="The camera.")
    projector: Projector | None = Field(None, description="The projector; without one only white frames.")
    sequence: SequenceSettings = Field(SequenceSettings(), description="The fringe patterns of one step.")
    calibration: Calibration | None = Field(
        None,
        description="Parameters of the calibration, the path of a calibration file (relative to this file), or "
        "virtual_rig for the exact parameters of the virtual rig.",
    )
    reference_plane: ReferencePlaneSection = Field(
        ReferencePlaneSection(), description="The plane that calibrates the rig."
    )
    load_frame: LoadFrame | None = Field(None, description="The testing machine.")
    signals: Signals = Field({}, description="Further signals by their names: temperatures, a second load cell, ...")
    extensometer: ExtensometerSection | None = Field(None, description="The virtual extensometer between the steps.")
    nodes: NodesSection = Field(NodesSection(), description="Parameters of the processing nodes.")
    noise_floor_file: FilePath | None = Field(
        None, description="Noise floor from `fringedic noise`, relative to this file; it is part of every recording."
    )
    region_file: FilePath | None = Field(
        None,
        description="Polygons from `fringedic region`, relative to this file: where the frames are checked and the "
        "displacement is measured.",
    )
    virtual_rig: dict[str, Any] | None = Field(
        None, description="The virtual rig, as of `fringedic.virtual_rig.VirtualRigConfiguration`."
    )
    acceptance: AcceptanceSection | None = Field(
        None, description="Artefacts and maximum permissible errors, for `fringedic check --vdi`."
    )
    plan: PlanSection | None = Field(None, description="Components of a rig to be built, for `fringedic plan`.")
    frame_prefix: str | None = Field(
        None, pattern=NAMESPACE, description="Prefix of the frame ids of the rig; by default that of its topics."
    )
    recording: RecordingSection = Field(RecordingSection(), description="What is recorded, and where.")
    specimen: SpecimenMetadata = Field(SpecimenMetadata(), description="Metadata of the specimen.")
    hardware: HardwareMetadata = Field(HardwareMetadata(), description="Metadata of the hardware.")
    test_form: list[FormField] = Field(
        list(DEFAULT_FORM),
        max_length=MOST_FIELDS,
        description="What the operator's page asks before a test; its answers replace entries of `specimen`.",
    )
    programme: Programme | None = Field(None, description="The load steps; a programme file replaces them.")

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
    def _signals_have_names_of_their_own(self) -> RigFile:
        taken = {FORCE.name, POSITION.name} & self.signals.keys()
        if taken and self.load_frame is not None:
            raise ValueError(
                f"signals: {min(taken)} is the name of a signal of the load frame; give this one another name, such as "
                f"{min(taken)}_2"
            )
        return self

    @model_validator(mode="after")
    def _size_of_the_images_is_known(self) -> RigFile:
        if self.camera.needs_size and self.camera.size is None:
            raise ValueError(f"camera: source: {self.camera.source} needs width and height, the size of its images")
        return self

    @model_validator(mode="after")
    def _relative_phases_are_wanted(self) -> RigFile:
        if self.sequence.fringe_order == "one_image" and self.nodes.phase.relative_phase != "accept":
            raise ValueError(
                "sequence.fringe_order: one_image measures phases up to a multiple of a fringe, and shapes that may be "
                "wrong by as many; set nodes.phase.relative_phase: accept to accept this"
            )
        return self

    @model_validator(mode="after")
    def _fields_of_a_test_differ(self) -> RigFile:
        check_form(self.test_form)
        return self

    @model_validator(mode="after")
    def _composed_nodes_are_started(self) -> RigFile:
        if self.nodes.composed and not self.recording.process:
            raise ValueError(
                "nodes.composed: true shares a process among nodes that recording.process: false does not start; "
                "leave one of them out"
            )
        return self

    def with_calibration(self, file: str | os.PathLike[str]) -> RigFile:
        """Return the rig with another calibration file, checked as when it is read; its path is absolute."""
        sections = {name: getattr(self, name) for name in type(self).model_fields}
        return type(self).model_validate({**sections, "calibration": str(file)})

    @property
    def topic_namespace(self) -> str:
        """Namespace of the topics: that of the rig, followed by the name of its sensor if it was given one."""
        return "/".join(filter(None, (self.namespace, "" if self.sensor == SENSOR else self.sensor)))

    def virtual_configuration(self) -> VirtualRigConfiguration:
        """Return the virtual rig of this file, which must have one."""
        return VirtualRigConfiguration.from_dict(self.virtual_rig or {})

    def camera_size(self) -> tuple[int, int] | None:
        """Return (width, height) of the images [px], None when it is known from the image files only."""
        return self._size(self.camera, "camera")

    def camera_first(self) -> tuple[int, int]:
        """Return the (column, row) of the sensor with which the images begin [px], -1 when it is not known."""
        return self.camera.first

    def projector_size(self) -> tuple[int, int] | None:
        """Return (width, height) of the projector's image [px], None without a projector."""
        return None if self.projector is None else self._size(self.projector, "projector")

    def grid_pitch(self) -> float | None:
        """Return the pitch of the printed grid [m], None when it is not known."""
        if self.reference_plane.grid_pitch_mm is not None:
            return self.reference_plane.grid_pitch_mm * MILLI
        if self.virtual_rig is not None:
            return self.virtual_configuration().stage.grid_pitch_mm * MILLI
        return None

    def pitches(self) -> list[float]:
        """Return the fringe pitches, coarse to fine [projector pixel]; empty without a projector."""
        size = self.projector_size()
        return [] if size is None else self.sequence.pitches(size[0])

    def patterns(self) -> list[ProjectedPattern]:
        """Return the patterns of the frames of one step, in their order; empty without a projector."""
        size = self.projector_size()
        return [] if size is None else list(self.sequence.patterns(*size))

    def moving_patterns(self) -> list[ProjectedPattern]:
        """Return the patterns of the frames of a step in motion, in their order; empty without a projector.

        Raises
        ------
        PatternError
            The sequence is none that a moving surface can be measured with.
        """
        size = self.projector_size()
        return [] if size is None else list(self.sequence.moving_patterns(*size))

    @property
    def has_load_frame_node(self) -> bool:
        """Whether a load frame node of this rig moves the machine."""
        return isinstance(self.load_frame, MachineSettings)

    def setup(self) -> RigSetup:
        """Return the parts of the rig that its calibration has to fit."""
        absolute = self.nodes.phase.relative_phase == "refuse"
        return RigSetup(
            self.camera_size(),
            self.projector_size(),
            self.patterns() if absolute else (),
            self.camera_first(),
            self.sensor,
        )

    @property
    def calibration_file(self) -> Path | None:
        """File of the calibration; None when this file names none."""
        names_a_file = isinstance(self.calibration, str) and self.calibration != VIRTUAL_RIG
        return Path(str(self.calibration)) if names_a_file else None

    @cached_property
    def rig_model(self) -> RigModel | None:
        """Calibration that this file contains or names, whose file is read once; None without one."""
        if self.calibration is None:
            return None
        if isinstance(self.calibration, CalibrationSection):
            return self.calibration.rig_model(self.sensor)
        if (file := self.calibration_file) is None:
            from fringedic.configuration.virtual_calibration import calibration_of  # loads the virtual rig

            return replace(calibration_of(self.virtual_configuration()), sensor=self.sensor)
        if not file.is_file():
            raise ConfigurationError(f"calibration: there is no file {file}")
        return RigModel.from_yaml(file)

    def metadata(self) -> Metadata:
        """Return the metadata of specimen, hardware, calibration and noise floor."""
        file = self.calibration_file
        known = CalibrationMetadata() if file is None else calibration_metadata(file)
        noise = NoiseFloorMetadata()
        if self.noise_floor_file is not None:
            noise = NoiseFloorMetadata.load(Path(self.noise_floor_file))
        return Metadata(specimen=self.specimen, hardware=self.hardware, calibration=known, noise=noise)

    def _size(self, section: ImageDeviceSettings, name: str) -> tuple[int, int] | None:
        if section.source == "virtual":
            part = getattr(self.virtual_configuration(), name)
            size = (part.columns, part.rows)
            given = (section.width or size[0], section.height or size[1])
            if given != size:
                raise ConfigurationError(
                    f"{name} is {given[0]}x{given[1]} px, the virtual rig's {name} has {size[0]}x{size[1]} px; "
                    "remove width and height to use those"
                )
            return size
        return section.size


@check_arguments(ConfigurationError, path=file_path)
def load_rig_file(path: str | os.PathLike[str], *, sensor: str | None = None) -> RigFile:
    """Read and check a rig file, or the part of it that describes one of several sensors.

    Parameters
    ----------
    path
        A YAML file.
    sensor
        Name of the sensor, if the file has several.

    Raises
    ------
    ConfigurationError
        The file cannot be read, or a key is unknown, missing, replaced or out of its range; the message names file and
        key. Or the file has several sensors and none is chosen.

    Examples
    --------
    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp(), "rig.yaml")
    >>> _ = file.write_text("{camera: {source: virtual}, virtual_rig: {preset: plate, size: tiny}}")
    >>> load_rig_file(file).camera_size()
    (160, 120)
    """
    file = Path(path)
    return rig_of_content(read_sections(file, RigFile), file, sensor, str(file))


def rig_of_content(content: Mapping[str, Any], file: Path, sensor: str | None, where: str) -> RigFile:
    """Return the rig, or that of one of several sensors, in the content of a file; see `load_rig_file`.

    Raises
    ------
    ConfigurationError
        As of `load_rig_file`; the message about a section, or what it names, begins with `where`.
    """
    sections = sections_of_sensor(content, str(file), sensor)
    rig = validate(RigFile, sections, where, REPLACED_KEYS, folder=file.parent)
    try:
        rig.camera_size()
        rig.projector_size()
        if rig.virtual_rig is not None:
            rig.virtual_configuration()
        rig.rig_model  # noqa: B018 (its file is read at the door)
    except FringedicError as error:
        raise ConfigurationError(f"{where}: {error}") from error
    return rig


@check_arguments(ConfigurationError, path=file_path)
def load_programme(path: str | os.PathLike[str]) -> Programme:
    """Read and check a programme of load steps.

    Parameters
    ----------
    path
        A YAML file.

    Raises
    ------
    ConfigurationError
        The file cannot be read, or a key is unknown, missing or out of its range; the message names file and key.

    Examples
    --------
    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp(), "programme.yaml")
    >>> _ = file.write_text("ramp: {to_mm: 0.5, steps: 3}")
    >>> [step.position_mm for step in load_programme(file).load_steps()]
    [0.0, 0.25, 0.5]
    """
    return load_sections(Path(path), Programme)


def fitting_calibration(rig: RigFile, path: str | os.PathLike[str]) -> RigModel | None:
    """Return the calibration that a rig file contains or names, after a check that it is that of this rig.

    Parameters
    ----------
    rig, path
        The content of the rig file, and its path for messages.

    Raises
    ------
    ConfigurationError
        The calibration belongs to another rig, or has lengths that contradict each other; or the
        coarsest fringes of the sequence repeat in the camera's view.
    """
    calibration = rig.rig_model
    if calibration is not None:
        try:
            check_calibration(calibration, rig.setup())
        except FringedicError as error:
            raise ConfigurationError(f"{path}: {error}", code=error.code) from error
    return calibration
