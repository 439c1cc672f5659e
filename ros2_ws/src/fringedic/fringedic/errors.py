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


class AdviceError(FringedicError, ValueError):
    """Settings are asked for by a wish that has no meaning."""


class CalibrationAnglesError(FringedicError, ValueError):
    """The angles or heights of calibration planes have the wrong unit or sign."""


class CalibrationFileError(FringedicError, OSError):
    """The files of a calibration cannot be read."""


class CalibrationMissingError(StepError, LookupError):
    """A step needs the rig's calibration and none has been given."""


class CalibrationMismatchError(FringedicError, ValueError):
    """A shape was made with another calibration than the one it is used with."""


class CalibrationPhaseError(FringedicError, ValueError):
    """The phase maps of calibration planes cannot be those of a plane in front of this rig."""


class CalibrationPlanesError(FringedicError, ValueError):
    """There are too few calibration planes, or they do not differ."""


class CalibrationStateError(FringedicError, RuntimeError):
    """A part of a calibration is asked for before what it needs has been measured."""


class CameraError(FringedicError, RuntimeError):
    """The camera cannot deliver a frame."""


class CameraTimeoutError(CameraError, TimeoutError):
    """The camera did not deliver a frame in time."""


class ClockJumpError(CameraError):
    """The clock of a camera or of this computer was set between two frames."""


class CloudMessageError(FringedicError, ValueError):
    """A point cloud message contradicts itself or is of a kind that is not supported."""


class ColourImageError(FringedicError, ValueError):
    """An image has colour channels where grey levels are needed."""


class CorrelationMethodError(FringedicError, ValueError):
    """A method of measuring displacement is asked for that does not exist."""


class CrossheadRangeError(FringedicError, ValueError):
    """A crosshead position or speed is outside what the machine or the specimen allows."""


class DatasetError(FringedicError, ValueError):
    """A file is not a dataset of this library, or two datasets cannot be compared."""


class DiskFullError(FringedicError, OSError):
    """The disk is full; what was written so far stays readable."""


class EmptyMaskError(FringedicError, ValueError):
    """A mask excludes every pixel."""


class ExportError(FringedicError, ValueError):
    """A format cannot hold what is to be exported, or something is in its place already."""


class FactsError(FringedicError, ValueError):
    """What was entered about specimen and hardware is unknown or has no meaning."""


class FrameDoubledError(StepError, ValueError):
    """Two frames of a step claim the same index."""


class FrameLateError(StepError, ValueError):
    """A frame arrived after its step had ended."""


class FrameMismatchError(StepError, ValueError):
    """A frame differs from what its step needs: size, pixel type, count or pattern."""


class FrameMissingError(StepError, LookupError):
    """Frames of a step never arrived."""


class GridError(FringedicError, ValueError):
    """The image of a printed grid cannot tell the distortion of a camera."""


class GridAliasedError(GridError):
    """The grid is in step with the pixels."""


class GridAngleError(GridError):
    """The pictures of the grid on the turned plane are not those of a plane at the angles that were said."""


class GridContrastError(GridError):
    """The grid is too dark, too bright or too blurred."""


class GridCoveredError(GridError):
    """Too much of the image shows no grid."""


class GridDirectionError(GridError):
    """The grid has lines along one direction only."""


class GridNotFoundError(GridError):
    """There is no grid in the image."""


class GridPitchError(GridError):
    """The grid's period is too long, too short or not the one that was said."""


class ImageMessageError(FringedicError, ValueError):
    """An image message contradicts itself or has an encoding that is not supported."""


class ImageSizeError(FringedicError, ValueError):
    """An image is empty, too small or has the wrong number of dimensions."""


class ImageTypeError(FringedicError, TypeError):
    """The pixels of an image are not real numbers."""


class IncrementError(FringedicError, ValueError):
    """Increments of a displacement do not fit together."""


class InvalidCalibrationError(FringedicError, ValueError):
    """A rig parameter has no meaning, or a parameter is missing."""


class InvalidDistortionError(FringedicError, ValueError):
    """The distortion of a camera is described by numbers that have no meaning."""


class InvalidExposuresError(FringedicError, ValueError):
    """Exposure times that cannot be merged."""


class InvalidPatternError(FringedicError, ValueError):
    """A pattern is asked for that a projector cannot show or that no phase can be measured from."""


class InvalidResponseError(FringedicError, ValueError):
    """A response curve is not one, or the images do not tell it."""


class InvalidSequenceError(FringedicError, ValueError):
    """Fringe frames do not form whole periods of ever finer pitches."""


class InvalidWindowError(FringedicError, ValueError):
    """A window or filter is too narrow to hold a measurement, or no width at all."""


class MachineError(FringedicError, RuntimeError):
    """The testing machine does not answer, answers with nonsense, or does not take a request."""


class MachineGoneError(MachineError, ConnectionError):
    """The connection to the testing machine is lost, or no longer to be trusted."""


class MachineFileError(FringedicError, ValueError):
    """The description of a testing machine cannot be used."""


class MissingTopicError(FringedicError, LookupError):
    """A recording lacks topics that are needed."""


class NoCorrelationError(FringedicError, ValueError):
    """Two images do not show the same surface."""


class NoFreeDomainError(FringedicError, RuntimeError):
    """Every ROS domain set aside for replays is in use."""


class NoFringesError(FringedicError, ValueError):
    """An image shows no fringes."""


class NodeDiedError(FringedicError, RuntimeError):
    """A node process ended while it was needed; the message holds the end of its log."""


class NodeNotInstalledError(FringedicError, LookupError):
    """A node's executable is not in the workspace."""


class NotAnsweredError(FringedicError, TimeoutError):
    """Nodes did not appear or did not answer in time; the message names them."""


class PadError(FringedicError, ValueError):
    """A pad of a virtual extensometer lies where it cannot be followed."""


class ParameterError(FringedicError, ValueError):
    """A node parameter has a value that is not allowed."""


class ProbeError(FringedicError, ValueError):
    """A probe on a result measures nothing or is described wrongly."""


class RaysMissingError(FringedicError, LookupError):
    """A shape does not tell the lines of sight that it was measured along."""


class RecordingError(FringedicError, OSError):
    """A recording cannot be written or read."""


class ReferenceMissingError(StepError, LookupError):
    """A step has no reference step to be measured against."""


class RigFileError(FringedicError, ValueError):
    """A rig file or programme says something that is not allowed."""


class ScreenError(FringedicError, RuntimeError):
    """The projector's screen cannot show a pattern."""


class ShapeMismatchError(FringedicError, ValueError):
    """Two arrays that belong together differ in size."""


class SpecimenFrameError(FringedicError, ValueError):
    """Points do not define a frame of the specimen."""


class StartError(FringedicError, RuntimeError):
    """A node or device cannot start."""


class StepFailedError(FringedicError, RuntimeError):
    """A load step or a movement of the machine ended with an error code."""


class StrainMeasureError(FringedicError, ValueError):
    """A measure of strain is unknown."""


class TargetError(FringedicError, ValueError):
    """A printable grid is asked for that no printer can make."""


class TexturelessImageError(FringedicError, ValueError):
    """An image has no texture to measure by: it is constant or not measured."""


class TimingError(FringedicError, ValueError):
    """Delay and refresh of a projector do not follow from what the camera saw."""


class TooFewValidError(StepError, ValueError):
    """Less of the image is measured than the parameters allow."""


class UnknownSchemaError(FringedicError, LookupError):
    """The definition of a message type is not installed."""


class VirtualRigConfigurationError(FringedicError, ValueError):
    """A virtual rig is described by entries that are unknown, missing or out of range."""


class WaitTimeoutError(FringedicError, TimeoutError):
    """Something that was waited for did not come in time."""


class WindowError(FringedicError, ValueError):
    """A correlation window or spacing does not fit the image."""


class SaturatedStackError(TooFewValidError):
    """Hardly a pixel is measured because the image is too bright."""


class DarkStackError(TooFewValidError):
    """Hardly a pixel is measured because the image is too dark."""


class WrongPatternError(FrameMismatchError):
    """The frames show other patterns than their records say."""


class FramesOutOfOrderError(FrameMismatchError):
    """The frames are not in the order that their records say."""


class FlickerError(FrameMismatchError):
    """The light changed between the frames of a step."""


class MovedSurfaceError(FrameMismatchError):
    """The surface moved between the frames of a step."""


class RegionError(FringedicError, ValueError):
    """An image has no such region."""


class NoiseFloorError(FringedicError, ValueError):
    """Steps or images at rest do not tell a noise floor."""
