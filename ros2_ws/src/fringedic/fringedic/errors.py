"""The errors that fringedic raises: one class per room, with a code where callers distinguish cases.

A message names the thing that is wrong and says what to do.
"""

from __future__ import annotations

from enum import StrEnum


class ErrorCode(StrEnum):
    """Cases of an error that callers distinguish."""

    # of a step
    FRAME_MISSING = "frames of the step never arrived"
    FRAME_DOUBLED = "two frames of the step have the same index"
    FRAME_LATE = "a frame arrived after its step had ended"
    FRAME_MISMATCH = "a frame differs from what its step needs: size, pixel type, count or pattern"
    WRONG_PATTERN = "the frames show other patterns than their records name"
    FRAMES_OUT_OF_ORDER = "the frames are not in the order that their records name"
    FLICKER = "the light changed between the frames of the step"
    SURFACE_MOVED = "the surface moved between the frames of the step"
    SATURATED = "almost no pixel is measured because the image is too bright"
    DARK = "almost no pixel is measured because the image is too dark"
    TOO_FEW_VALID = "less of the image is measured than the parameters require"
    NO_REFERENCE = "the step has no reference step to be measured against"
    NO_CALIBRATION = "the step needs the rig's calibration and none has been given"
    OTHER_RIG = "a calibration belongs to another rig, or a length in it has another unit"
    # of images
    INVALID_SEQUENCE = "fringe frames do not form whole periods of decreasing pitches"
    NO_FRINGES = "an image shows no fringes"
    NO_CORRELATION = "two images do not show the same surface"
    NO_TEXTURE = "an image has no texture: it is constant or not measured"
    GRID_ALIASED = "the period of the printed grid is a multiple of the pixel"
    # of recordings
    MISSING_TOPIC = "a recording lacks topics that are needed"
    DISK_FULL = "the disk is full; what was written before stays readable"


class FringedicError(Exception):
    """Base of all errors of this library.

    Attributes
    ----------
    code
        Which case this is, None where callers need not distinguish.
    """

    def __init__(self, message: str, *, code: ErrorCode | None = None) -> None:
        super().__init__(message)
        self.code = code


class StepError(FringedicError, ValueError):
    """A step of an experiment cannot be measured.

    Its text names the step and the reason; who shows both anyway takes the reason alone.

    Attributes
    ----------
    reason
        Why it failed, without the name of the step.
    experiment, step
        Which step failed; an empty experiment where frames were not taken in one.
    index
        Index of the frame concerned, None when it is none in particular.
    """

    def __init__(
        self,
        reason: str,
        *,
        code: ErrorCode | None = None,
        experiment: str = "",
        step: int = 0,
        index: int | None = None,
    ) -> None:
        super().__init__(reason, code=code)
        self.reason = reason
        self.experiment = experiment
        self.step = step
        self.index = index

    def __str__(self) -> str:
        return f"experiment '{self.experiment}', step {self.step}: {self.reason}" if self.experiment else self.reason


def reason_of(error: Exception) -> str:
    """Return why something failed, without the name of the step, which is shown beside it."""
    return error.reason if isinstance(error, StepError) else str(error)


class VirtualRigError(FringedicError, ValueError):
    """A virtual rig is described by entries that are unknown, missing or out of range."""


class PatternError(FringedicError, ValueError):
    """A projector cannot show the pattern, no phase can be measured from it, or a response curve is none."""


class ImageError(FringedicError, ValueError):
    """An image, a mask, a region or an image message has a wrong size, type or content, or two do not fit together."""


class RecordingError(FringedicError, OSError):
    """A recording cannot be written or read."""


class PhaseError(FringedicError, ValueError):
    """No phase can be computed from these frames."""


class GridError(FringedicError, ValueError):
    """The printed grid or its image does not give the distortion of a camera, or a distortion is invalid."""


class CalibrationError(FringedicError, ValueError):
    """Planes, angles or files do not give a calibration of the rig, or two calibrations do not fit together."""


class CorrelationError(FringedicError, ValueError):
    """A displacement cannot be measured between these images, or with these settings."""


class SurfaceError(FringedicError, ValueError):
    """A surface, its window or its frame does not allow the requested evaluation."""


class ConfigurationError(FringedicError, ValueError):
    """A file or a parameter written by a person contains something that is not allowed."""


class DatasetError(FringedicError, ValueError):
    """A file is not a dataset of this library, two datasets cannot be compared, or a probe measures nothing."""


class ModelError(FringedicError, ValueError):
    """A file is not a model that can be compared, its place is not determined, or it does not cover the measurement."""


class RigSetupError(FringedicError, ValueError):
    """A measurement before the test gives no result."""


class EvidenceError(FringedicError, RuntimeError):
    """The log of a run or the key of the laboratory cannot be used, or a time stamp confirms something else."""


class ExportError(FringedicError, ValueError):
    """A format cannot hold what is to be exported, or something is in its place already."""


class CampaignError(FringedicError, ValueError):
    """A campaign, its store or one of its recordings does not allow what is asked for."""


class CameraError(FringedicError, RuntimeError):
    """The camera cannot deliver a frame."""


class CameraTimeoutError(CameraError, TimeoutError):
    """The camera did not deliver a frame in time."""


class ClockJumpError(CameraError):
    """The clock of a device or of this computer was set between two frames or samples."""


class MachineError(FringedicError, RuntimeError):
    """The testing machine does not answer, answers with nonsense, or does not take a request."""


class MachineGoneError(MachineError, ConnectionError):
    """The connection to the testing machine is lost, or can no longer be trusted."""


class MachineNotReadyError(MachineError):
    """The testing machine reports a fault, no state or no position, so that no move was sent to it."""


class CrossheadRangeError(FringedicError, ValueError):
    """A crosshead position or speed is outside the range of the machine or of the specimen."""


class ScreenError(FringedicError, RuntimeError):
    """The projector's screen cannot show a pattern."""


class ProcessError(FringedicError, RuntimeError):
    """A node process or a device cannot start."""


class NodeDiedError(ProcessError):
    """A node process ended while it was needed; the message contains the end of its log."""


class StepFailedError(FringedicError, RuntimeError):
    """A load step or a movement of the machine ended with an error code.

    Attributes
    ----------
    error_code
        Of the result of the action ``measure_step`` or ``move_crosshead``; 0 where there was no result.
    """

    def __init__(self, message: str, *, error_code: int = 0) -> None:
        super().__init__(message)
        self.error_code = error_code


class RigBusyError(StepFailedError):
    """Another controller measures with the rig, or moves its machine; the message names it."""


class MoveStoppedError(StepFailedError):
    """A move of the machine was stopped, or not begun, by something else than its client; going on needs a person.

    Somebody requested a hold or stopped the machine at its controls, it reached a limit of its own, it reports a fault
    or no state, or it does not follow a request.
    """


class OperatorError(FringedicError, RuntimeError):
    """A request of the operator's page is refused; the message says what to do instead."""


class WaitTimeoutError(FringedicError, TimeoutError):
    """A node, an answer or a message did not come in time; the message names it."""
