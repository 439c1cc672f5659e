"""How long a programme will take on a rig, and how much room its recording and results need: before it starts.

Both are upper bounds where a programme may end early, and estimates elsewhere; what they are made of stands beside each
constant below. What nobody knows before is left out: how busy the computer is with other things (which has made it four
times as long), steps that are measured again after a node was lost, and when a condition of an `until` is met.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

from fringedic.errors import DiskFullError
from fringedic.programme import Programme, ProgrammeStep
from fringedic.rig_file import RigFile

# Times [s] on two cores; those of frames and maps from the benchmark of the running system
START_TIME = 10.0  # of the nodes
FRAME_TIME = 0.022  # to ask for a pattern and a frame, beside exposure and settle time
MOVE_TIME = 0.5  # to ask for a move, for its ramps, and to see that it holds
STEP_TIME = 0.1  # begin and end of a step
PHASE_TIME = 0.5e-6  # per pixel of a step: phase and texture
POINT_TIME = 1.1e-6  # per measured point of a step: displacement, shape and strain
RENDERING_TIME = 2.6e-6, 0.05e-6  # of a virtual camera: per pixel of a position, and of each frame
WRITING_TIME = 2.0, 7e-6  # after the test, of each step in dataset, pictures and report; and per measured point

# Bytes, uncompressed: the noise of a camera hardly compresses
FREE_RUN_BYTES = 600  # beside each image of the free run: exposure, camera information, strain
PHASE_BYTES = 4 * 4 + 16  # per pixel: map, sigma, modulation, texture; shape
DIC_BYTES = 4 * 4  # per point: displacement and sigma, two components each
CLOUD_BYTES = 72  # per point: displacement with uncertainty, local components and strain
DATASET_BYTES = 130  # per point of the dataset
PICTURE_BYTES = 1_000_000  # per step, with its part of the report
TRUTH_BYTES = 32  # per pixel of a virtual rig's step
SAMPLE_BYTES = 320  # of force and position in three messages
RUN_BYTES = 10_000_000  # logs, calibration, report
ROOM_LEFT = 100e6  # the recorder ends a recording that leaves less


@dataclass(frozen=True)
class Forecast:
    """What a programme needs.

    Attributes
    ----------
    steps, measured
        Largest number of steps, and of those that are measured.
    frames
        Largest number of frames of steps.
    free_frames
        Frames of the free run for the extensometer, during moves, holds and measuring.
    duration
        From the start of the nodes to the end of the last step [s].
    writing
        What dataset, pictures and report take after it [s].
    size
        Of the recording and its results [byte].
    early
        Conditions may end it earlier.
    """

    steps: int
    measured: int
    frames: int
    free_frames: int
    duration: float
    writing: float
    size: float
    early: bool

    def in_words(self) -> str:
        """Return one sentence for people."""
        most = "at most " if self.early else ""
        free = f" and {self.free_frames} of the free run" if self.free_frames else ""
        return (
            f"{most}{self.steps} steps, {self.frames} frames{free}: about {_duration(self.duration)}, then "
            f"{_duration(self.writing)} for dataset and report, if nothing else is to do; {_size(self.size)} of disk"
        )

    def check_disk(self, folder: str | os.PathLike[str]) -> None:
        """Refuse a run that does not fit on the disk.

        Parameters
        ----------
        folder
            Where the run will be written; it need not exist.

        Raises
        ------
        DiskFullError
            The disk has less room than the run needs.
        """
        place = Path(folder).absolute()
        while not place.exists():
            place = place.parent
        free = shutil.disk_usage(place).free
        if free < self.size + ROOM_LEFT:
            raise DiskFullError(
                f"{self.in_words()}, but the disk of {place} has {_size(free)} left, of which {_size(ROOM_LEFT)} stay "
                "free; make room, choose another --output, or set recording.derived to false"
            )


def forecast(rig: RigFile, programme: Programme) -> Forecast:
    """Return what a programme needs on a rig; images whose size nobody knows before count as 5 megapixels."""
    width, height = rig.camera_size() or (2560, 1920)
    pixels = width * height
    points = pixels / rig.nodes.dic.spacing**2
    wide = rig.camera.source != "virtual" and rig.camera.pixel_format != "Mono8"
    bits = rig.virtual_configuration().sensor.bits if rig.camera.source == "virtual" else 16 if wide else 8
    frame_bytes = pixels * (2 if bits > 8 else 1)
    frame_time = FRAME_TIME + rig.camera.exposure_time + rig.camera.settle_time
    step_time = STEP_TIME
    if rig.camera.source == "virtual":
        step_time += RENDERING_TIME[0] * pixels
        frame_time += RENDERING_TIME[1] * pixels

    steps = programme.load_steps()
    frames_of = {"fringes": len(rig.projections()), "white": 1, "none": 0}
    moving = rig.load_frame is not None and rig.load_frame.source != "external"
    test, writing, measuring, size, frames = START_TIME, 0.0, 0.0, float(RUN_BYTES), 0
    position = 0.0
    for step in steps:
        if moving and step.position is not None:
            test += _move_time(step, position)
            position = step.position
        test += step.hold_s
        if step.mode == "none":
            continue
        count = frames_of[step.mode]
        frames += count
        fringes = step.mode == "fringes"
        test += step_time + count * frame_time
        maps = POINT_TIME * points + (PHASE_TIME * pixels if fringes else 0.0)
        measuring += maps
        writing += WRITING_TIME[0] + WRITING_TIME[1] * points
        size += count * frame_bytes + PICTURE_BYTES + DATASET_BYTES * points
        size += TRUTH_BYTES * pixels if rig.camera.source == "virtual" else 0.0
        if rig.recording.process and rig.recording.derived:
            size += DIC_BYTES * points + (PHASE_BYTES * pixels + CLOUD_BYTES * points if fringes else 0.0)
    if rig.recording.process:
        test += measuring
    else:
        writing += measuring
    free_frames = 0
    if rig.extensometer is not None:
        free_frames = round(rig.extensometer.rate_hz * max(test - START_TIME - frames * frame_time, 0.0))
        size += free_frames * (frame_bytes + FREE_RUN_BYTES)
    if rig.load_frame is not None:
        size += SAMPLE_BYTES * rig.load_frame.rate_hz * test
    measured = sum(step.mode != "none" for step in steps)
    return Forecast(len(steps), measured, frames, free_frames, test, writing, size, bool(programme.conditions()))


def _move_time(step: ProgrammeStep, start: float) -> float:
    assert step.position is not None, "only of a step that moves"
    return MOVE_TIME + abs(step.position - start) / step.speed


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"


def _size(size: float) -> str:
    return f"{size / 1e6:.0f} MB" if size < 1e9 else f"{size / 1e9:.1f} GB"
