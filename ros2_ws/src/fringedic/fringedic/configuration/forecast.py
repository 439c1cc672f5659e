"""Forecast of the time and the disk space that a programme needs on a rig.

The numbers are upper bounds where conditions may end a programme early, and estimates elsewhere; their parts are the
constants below. The forecast does not include other work of the computer (which has made a test four times as long),
steps that are measured again after a node was lost, and when a condition is met.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from fringedic.configuration.programme import MOST_STEPS, Programme, ProgrammeStep
from fringedic.configuration.rig_file import RigFile
from fringedic.errors import ConfigurationError, ErrorCode, RecordingError

# Times [s] on two cores; those of frames and maps from benchmarks/system.py
START_TIME = 10.0  # of the nodes
FRAME_TIME = 0.022  # of a request of pattern and frame, beside exposure and settle time
MOVE_TIME = 0.5  # of a request of a move, its ramps, and the detection of the hold
STEP_TIME = 0.1  # begin and end of a step
PHASE_TIME = 0.5e-6  # per pixel of a step: phase and texture
MOVING_PHASE_TIME = 1.5e-6  # the same in motion
POINT_TIME = 1.1e-6  # per measured point of a step: displacement, shape and strain
RENDERING_TIME = 2.6e-6, 0.05e-6  # of a virtual camera: per pixel of a position, and of each frame
WRITING_TIME = 2.0, 7e-6  # after the test, of each step in dataset, figures and report; and per measured point

# Bytes, uncompressed: the noise of a camera hardly compresses
FREE_RUN_BYTES = 600  # beside each image of the free run: exposure, camera information, strain
PHASE_BYTES = 4 * 4 + 16  # per pixel: map, sigma, modulation, texture; shape
DIC_BYTES = 4 * 4 + 3  # per point: displacement and sigma, two components each; preview, or less
CLOUD_BYTES = 92  # per point: displacement with uncertainty and noise, local components, strain and its errors
DATASET_BYTES = 150  # per point of the dataset
PICTURE_BYTES = 1_000_000  # per step, with its part of the report
TRUTH_BYTES = 32  # per pixel of a virtual rig's step
SAMPLE_BYTES = 320  # of force and position in three messages
RUN_BYTES = 10_000_000  # logs, calibration, report
ROOM_LEFT = 100e6  # free space at which the recorder ends a recording

_ROUNDING = 1e-6  # of the number of stacks during a move
UNKNOWN_SIZE = 2560, 1920  # (width, height) [px] assumed for images whose size is known from their files only


def frame_interval(rig: RigFile) -> float:
    """Return the expected time from frame to frame of a step in motion [s]; NaN where the exposure is not known."""
    time = FRAME_TIME + rig.camera.exposure_time + rig.camera.settle_time
    if rig.camera.source == "virtual":  # every frame shows another position
        width, height = rig.camera_size() or UNKNOWN_SIZE
        time += sum(RENDERING_TIME) * width * height
    return time


@dataclass(frozen=True)
class Forecast:
    """Time and disk space of a programme; `fringedic.configuration.sentences.forecast_sentence` composes a sentence.

    Attributes
    ----------
    steps, measured
        Largest number of steps, and of those that are measured.
    frames
        Largest number of frames of steps.
    free_frames
        Frames of the free run for the extensometer, during moves, holds and measurements.
    duration
        From the start of the nodes to the end of the last step [s].
    writing
        Time for dataset, figures and report after the last step [s].
    size
        Size of the recording and its results [byte].
    early
        Conditions may end the programme earlier.
    """

    steps: int
    measured: int
    frames: int
    free_frames: int
    duration: float
    writing: float
    size: float
    early: bool

    def check_disk(self, folder: str | os.PathLike[str]) -> None:
        """Refuse a run that does not fit on the disk.

        Parameters
        ----------
        folder
            Where the run will be written; it need not exist.

        Raises
        ------
        RecordingError
            The disk has less free space than the run needs.
        """
        place = Path(folder).absolute()
        while not place.exists():
            place = place.parent
        free = shutil.disk_usage(place).free
        if free < self.size + ROOM_LEFT:
            raise RecordingError(
                f"the {self.steps} steps need {_gigabytes(self.size)} of disk space, but the disk of {place} has "
                f"{_gigabytes(free)} left, of which {_gigabytes(ROOM_LEFT)} stay free: make room, choose another "
                "--output, or set recording.derived to false",
                code=ErrorCode.DISK_FULL,
            )


def forecast(rig: RigFile, programme: Programme, done: int = 0) -> Forecast:
    """Return the time and the disk space that a programme needs on a rig.

    Images whose size is not known before the test count as 5 megapixels.

    Parameters
    ----------
    rig
        The rig.
    programme
        The load steps.
    done
        How many of them an earlier command did. Those after them are forecast; at the end all parts of the recording
        are joined, and all steps are measured again from their frames.

    Raises
    ------
    ConfigurationError
        A move is so slow that it has more than `MOST_STEPS` stacks.

    Examples
    --------
    >>> rig = RigFile.model_validate({"camera": {"source": "files", "files": "*.png", "width": 640, "height": 480}})
    >>> needed = forecast(rig, Programme.model_validate({"ramp": {"to_mm": 1.0, "steps": 4, "mode": "white"}}))
    >>> needed.steps, needed.frames, needed.early
    (4, 4, False)
    """
    costs = _Costs.of(rig)
    steps = programme.load_steps()
    before, steps = steps[:done], steps[done:]
    recorded = costs.stacks(before, 0.0)
    measured = costs.stacks(steps, _last_position(before))
    resting = [step for step in measured if step.mode != "moving"]  # the others are measured during a move
    frames = sum(costs.frames(step) for step in measured)
    evaluation = sum(costs.evaluation_time(step) for step in resting)
    test = START_TIME + _moving_time(rig, before + steps) - _moving_time(rig, before)
    test += sum(step.hold_s for step in steps)
    test += len(resting) * costs.step_time + sum(costs.frames(step) for step in resting) * costs.frame_time
    writing = len(recorded + measured) * (WRITING_TIME[0] + WRITING_TIME[1] * costs.points)
    if rig.recording.process:
        test += evaluation
    if done or not rig.recording.process:
        writing += sum(costs.evaluation_time(step) for step in measured + recorded)
    free_frames = 0
    if rig.extensometer is not None:
        free_frames = round(rig.extensometer.rate_hz * max(test - START_TIME - frames * costs.frame_time, 0.0))
    size = RUN_BYTES + sum(costs.step_bytes(step) for step in measured)
    size += free_frames * (costs.frame_bytes + FREE_RUN_BYTES)
    if rig.load_frame is not None:
        size += SAMPLE_BYTES * rig.load_frame.rate_hz * test
    if done:
        size += forecast(rig, programme).size  # all parts are copied into one recording
    return Forecast(
        len(steps) + len(measured) - sum(step.mode != "none" for step in steps),
        len(measured),
        frames,
        free_frames,
        test,
        writing,
        size,
        early=bool(programme.conditions()),
    )


@dataclass(frozen=True)
class _Costs:
    """Time and bytes of the parts of a step on one rig.

    Attributes
    ----------
    rig
        The rig file.
    fringe_frames
        Of a step with fringes.
    pixels, points
        Of an image, and of a displacement.
    frame_bytes, frame_time
        Of one frame [byte, s].
    step_time
        Of a step without its frames and their evaluation [s].
    """

    rig: RigFile
    fringe_frames: int
    pixels: int
    points: float
    frame_bytes: int
    frame_time: float
    step_time: float

    @classmethod
    def of(cls, rig: RigFile) -> _Costs:
        width, height = rig.camera_size() or UNKNOWN_SIZE
        pixels = width * height
        frame_time = FRAME_TIME + rig.camera.exposure_time + rig.camera.settle_time
        step_time = STEP_TIME
        if rig.camera.source == "virtual":
            step_time += RENDERING_TIME[0] * pixels
            frame_time += RENDERING_TIME[1] * pixels
        return cls(
            rig=rig,
            fringe_frames=len(rig.patterns()),
            pixels=pixels,
            points=pixels / rig.nodes.dic.spacing**2,
            frame_bytes=pixels * (2 if _bits(rig) > 8 else 1),
            frame_time=frame_time,
            step_time=step_time,
        )

    def frames(self, step: ProgrammeStep) -> int:
        if step.mode == "moving":
            return len(self.rig.moving_patterns())
        return self.fringe_frames if step.mode == "fringes" else 1

    def evaluation_time(self, step: ProgrammeStep) -> float:
        phase = {"fringes": PHASE_TIME, "moving": MOVING_PHASE_TIME}.get(step.mode, 0.0)
        return POINT_TIME * self.points + phase * self.pixels

    def stacks(self, steps: list[ProgrammeStep], position: float) -> list[ProgrammeStep]:
        """Return the steps that are measured, one in motion as often as it is measured during its move.

        Parameters
        ----------
        steps
            Steps of a programme.
        position
            Of the crosshead before them [m].
        """
        measured: list[ProgrammeStep] = []
        for step in steps:
            way = 0.0 if step.position is None else abs(step.position - position)
            position = position if step.position is None else step.position
            if step.mode == "moving":
                of_one = STEP_TIME + self.frames(step) * frame_interval(self.rig) + self.evaluation_time(step)
                count = way / step.speed / max(of_one, step.every_s)
                if count >= MOST_STEPS:
                    raise ConfigurationError(
                        f"the move to {step.position_mm:g} mm at {step.speed_mm_per_s:g} mm/s has more than "
                        f"{MOST_STEPS} stacks; increase speed_mm_per_s or every_s"
                    )
                measured += [step] * (1 + int(count + _ROUNDING))
            elif step.mode != "none":
                measured.append(step)
        return measured

    def step_bytes(self, step: ProgrammeStep) -> float:
        size = self.frames(step) * self.frame_bytes + PICTURE_BYTES + DATASET_BYTES * self.points
        if self.rig.camera.source == "virtual":
            size += TRUTH_BYTES * self.pixels
        if self.rig.recording.process and self.rig.recording.derived:
            size += DIC_BYTES * self.points
            if step.mode in ("fringes", "moving"):
                size += PHASE_BYTES * self.pixels + CLOUD_BYTES * self.points
        return size


def _bits(rig: RigFile) -> int:
    if rig.camera.source == "virtual":
        return rig.virtual_configuration().sensor.bits
    return rig.camera.bits or 8


def _last_position(steps: list[ProgrammeStep]) -> float:
    return next((step.position for step in reversed(steps) if step.position is not None), 0.0)


def _moving_time(rig: RigFile, steps: list[ProgrammeStep]) -> float:
    """Return the time of all moves [s] that the rig makes by itself."""
    if not rig.has_load_frame_node:
        return 0.0
    time, position = 0.0, 0.0
    for step in steps:
        if step.position is not None:
            time += MOVE_TIME + abs(step.position - position) / step.speed
            position = step.position
    return time


def _gigabytes(size: float) -> str:
    return f"{size / 1e9:.1f} GB"
