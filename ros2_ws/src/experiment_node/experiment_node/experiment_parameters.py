"""Parameters of the experiment node: what a step shows, what it waits for, and for how long."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from fringedic.patterns import FringeOrder, step_sequence
from fringedic.sequence import PHASE_KINDS, Projection


class ExperimentParameters(BaseModel):
    """Parameters of the experiment node."""

    model_config = ConfigDict(frozen=True)

    experiment: str = Field("", description="Name of the first experiment; empty names it after the time of its start.")
    first_step: int = Field(
        0, ge=0, le=2**31 - 1, description="Number of the first step: an experiment of this name went so far before."
    )
    reference_step: int = Field(
        -1, ge=-1, le=2**31 - 1, description="Step of before that is still the reference; -1: the first that succeeds."
    )
    calibration_file: str = Field("", description="YAML file of the rig's pin-hole model, published on calibration.")
    calibration_folder: str = Field(
        "calibration", description="Folder in which each calibration gets a folder of its own."
    )
    projector: bool = Field(True, description="A projector shows the patterns; without one, only WHITE steps.")
    projector_width_px: int = Field(800, ge=1, le=16384, description="Columns of the projector [px].")
    projector_height_px: int = Field(600, ge=1, le=16384, description="Rows of the projector [px].")
    pitches_px: list[float] = Field(
        [800.0, 160.0, 40.0, 10.0], description="Fringe pitches, coarse to fine [projector pixel]."
    )
    shifts: list[int] = Field([4, 4, 4, 8], description="Phase-shifted frames of each pitch, at least 3.")
    fringe_order: FringeOrder = Field(
        "pitches",
        description="What tells the fringe orders. pitches: each coarser one the next; gray_code: a code of the finest "
        "pitch, which is the only one then; one_image: nothing, a single image of the finest pitch is shown.",
    )
    grey_frame: bool = Field(False, description="With one_image: grey light before it, for the texture.")
    exposure_times_s: list[float] = Field(
        [], max_length=8, description="At which every pattern of a step is taken [s]; empty: as the camera is set up."
    )
    orientation: Literal["vertical", "horizontal"] = Field(
        "vertical", description="vertical: fringes along y, projector left or right; horizontal: projector above."
    )
    white_between_steps: bool = Field(
        False, description="The projector is white after the frames of a step, for a camera that runs freely."
    )
    nodes: list[Literal["phase", "dic", "coupling"]] = Field(
        ["phase", "dic", "coupling"], description="Processing nodes whose result every step waits for."
    )
    record_only: bool = Field(False, description="No result is waited for: frames are recorded, and measured later.")
    recording_required: bool = Field(False, description="No step without a recorder that is recording.")
    hold_required: bool = Field(True, description="No step while a load frame that is there does not hold.")
    load_drift_n: float = Field(
        0.0, ge=0, le=1e6, description="Largest change of the force over the exposures of a step [N]; 0: any."
    )
    position_drift_um: float = Field(
        0.0, ge=0, le=1e6, description="Largest change of the crosshead's position over the exposures [µm]; 0: any."
    )
    settle_time_s: float = Field(0.0, ge=0, le=3600, description="From the start of a step to its first pattern [s].")
    start_timeout_s: float = Field(
        20.0, gt=0, le=600, description="For nodes, subscribers and recorder to be there at the first step [s]."
    )
    projector_timeout_s: float = Field(5.0, gt=0, le=600, description="For a pattern to be on the screen [s].")
    camera_timeout_s: float = Field(10.0, gt=0, le=600, description="For a frame to be taken [s].")
    placing_timeout_s: float = Field(
        600.0, gt=0, le=86400, description="For stage or operator to put the reference plane in its place [s]."
    )
    processing_timeout_s: float = Field(120.0, gt=0, le=86400, description="From the last exposure to the results [s].")
    facts: str = Field("", description="Specimen and hardware as YAML, for the record only.")

    @model_validator(mode="after")
    def _showable(self) -> Self:
        self.projections()
        return self

    @model_validator(mode="after")
    def _exposures_differ(self) -> Self:
        times = self.exposure_times_s
        if len(set(times)) < len(times) or not all(0 < time <= 60 for time in times):
            raise ValueError("exposure_times_s must be above 0, 60 s at most, and differ from each other")
        return self

    @model_validator(mode="after")
    def _reference_was_before(self) -> Self:
        if self.reference_step >= self.first_step:
            raise ValueError(f"reference_step {self.reference_step} is not before first_step {self.first_step}")
        return self

    def projections(self) -> tuple[Projection, ...]:
        """Return what the frames of a FRINGES step show, each pattern once for each exposure time.

        Raises
        ------
        InvalidPatternError
            The pitches, shifts and size do not make a sequence.
        """
        sequence = step_sequence(
            self.projector_width_px,
            self.projector_height_px,
            self.pitches_px,
            self.shifts,
            self.orientation,
            self.fringe_order,
            grey_frame=self.grey_frame,
        )
        return tuple(projection for projection in sequence.projections for _ in self.exposure_times_s or [0.0])

    def exposure_time(self, index: int, projection: Projection) -> float:
        """Return how long a frame of a step is exposed [s], 0 as the camera is set up.

        Parameters
        ----------
        index
            Of the frame within its step.
        projection
            What it shows; patterns of a FRINGES step alone are taken at several exposure times.
        """
        times = self.exposure_times_s if projection.kind in PHASE_KINDS else ()
        return times[index % len(times)] if times else 0.0
