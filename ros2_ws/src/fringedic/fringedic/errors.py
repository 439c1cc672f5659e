"""Every error that fringedic raises by name. Messages name the thing that is wrong and say what to do."""

from __future__ import annotations


class FringedicError(Exception):
    """Base of all errors of this library."""


class StepError(FringedicError):
    """An error that belongs to one step of an experiment.

    Attributes
    ----------
    experiment, step
        Which step failed.
    index
        The frame concerned, None when it is none in particular.
    """

    def __init__(self, message: str, *, experiment: str = "", step: int = 0, index: int | None = None) -> None:
        super().__init__(message)
        self.experiment = experiment
        self.step = step
        self.index = index


class CalibrationMissingError(StepError, LookupError):
    """A step needs the rig's calibration and none has been given."""


class DatasetError(FringedicError, ValueError):
    """A file is not a dataset of this library, or two datasets cannot be compared."""


class DiskFullError(FringedicError, OSError):
    """The disk is full; what was written so far stays readable."""


class FrameDoubledError(StepError, ValueError):
    """Two frames of a step claim the same index."""


class FrameLateError(StepError, ValueError):
    """A frame arrived after its step had ended."""


class FrameMismatchError(StepError, ValueError):
    """A frame differs from what its step needs: size, pixel type, count or pattern."""


class FrameMissingError(StepError, LookupError):
    """Frames of a step never arrived."""


class InvalidCalibrationError(FringedicError, ValueError):
    """A rig parameter has no meaning, or a parameter is missing."""


class InvalidPatternError(FringedicError, ValueError):
    """A pattern is asked for that a projector cannot show or that no phase can be measured from."""


class InvalidSequenceError(FringedicError, ValueError):
    """Fringe frames do not form whole periods of ever finer pitches."""


class MissingTopicError(FringedicError, LookupError):
    """A recording lacks topics that are needed."""


class RecordingError(FringedicError, OSError):
    """A recording cannot be written or read."""


class ReferenceMissingError(StepError, LookupError):
    """A step has no reference step to be measured against."""


class RigFileError(FringedicError, ValueError):
    """A rig file or programme says something that is not allowed."""


class ShapeMismatchError(FringedicError, ValueError):
    """Two arrays that belong together differ in size."""


class TooFewValidError(StepError, ValueError):
    """Less of the image is measured than the parameters allow."""


class UnknownSchemaError(FringedicError, LookupError):
    """The definition of a message type is not installed."""
