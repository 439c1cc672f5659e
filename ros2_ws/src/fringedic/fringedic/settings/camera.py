"""Settings of cameras: one model for each source, and those of the camera node."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, SerializeAsAny, model_validator

from fringedic.rig.geometry import UNKNOWN_FIRST
from fringedic.settings.base import MILLI, FilePath, VirtualDeviceNodeSettings
from fringedic.settings.devices import Devices, ImageDeviceSettings

PixelFormat = Literal["Mono8", "Mono10", "Mono12", "Mono16"]
_OF_THE_TIMEOUT = 0.8  # of a driver, whose error messages are more precise


class StampOf(StrEnum):
    """Moment of the exposure to which a time stamp belongs."""

    START = "start"
    MIDDLE = "middle"
    END = "end"  # also for stamps of the arrival, which follows it

    def start_ns(self, stamp_ns: int, exposure_time: float) -> int:
        """Return the start of the exposure of `exposure_time` [s] with this stamp [ns]."""
        return stamp_ns - round(1e9 * exposure_time * _PASSED[self])

    def middle_ns(self, stamp_ns: int, exposure_time: float) -> int:
        """Return the middle of the exposure of `exposure_time` [s] with this stamp [ns]."""
        return stamp_ns + round(1e9 * exposure_time * (0.5 - _PASSED[self]))


_PASSED = {StampOf.START: 0.0, StampOf.MIDDLE: 0.5, StampOf.END: 1.0}  # elapsed part of the exposure time at the stamp


class Trigger(StrEnum):
    """Event that starts an exposure."""

    INTERNAL = "internal"  # the clock of the camera, all the time
    SOFTWARE = "software"  # each request
    EXTERNAL_EDGE = "external_edge"  # an electrical edge, for the set exposure time
    EXTERNAL_LEVEL = "external_level"  # an electrical level, for as long as it lasts


class CameraSettings(ImageDeviceSettings):
    """Settings of every camera.

    Attributes
    ----------
    needs_size
        A rig file has to state width and height of the images.
    """

    elsewhere: ClassVar[str] = "the driver of this camera does not have such settings"
    needs_size: ClassVar[bool] = True

    source: str = Field(
        description="Source of the images. virtual: the virtual rig; files: a folder; video: a video file; aravis: a "
        "GigE or USB3 Vision camera; v4l2: a USB camera (UVC); topic: any camera with a ROS 2 driver of its own; or "
        "the name of an installed driver."
    )
    exposure_ms: float = Field(10.0, gt=0, le=60e3, description="Exposure time [ms].")
    settle_ms: float = Field(
        0.0, ge=0, le=60e3, description="Time between the pattern on the screen and the start of the exposure [ms]."
    )
    timeout_s: float = Field(
        10.0, gt=0, le=600, description="Longest wait for scene and frame, each [s]; for subscribers at most 5 s."
    )
    pixel_format: Literal["", PixelFormat] = Field(
        "", description="Bit depth of the pixels, for the grey level of saturation; empty: that of the images' type."
    )

    @property
    def exposure_time(self) -> float:
        """Exposure time [s]."""
        return self.exposure_ms * MILLI

    @property
    def settle_time(self) -> float:
        """Time between pattern and exposure [s]."""
        return self.settle_ms * MILLI

    @property
    def driver_timeout(self) -> float:
        """Longest wait of the driver for a frame beyond its exposure time [s]."""
        return _OF_THE_TIMEOUT * self.timeout_s

    @property
    def first(self) -> tuple[int, int]:
        """Column and row of the sensor with which the images begin [px]; -1 when they are not known."""
        return UNKNOWN_FIRST

    @property
    def device(self) -> str:
        """What two sensors cannot have in common, such as the identifier of the camera; empty when it is not known."""
        return ""

    @property
    def bits(self) -> int | None:
        """Bits of a grey level; None: those of the images' type."""
        return int(self.pixel_format.removeprefix("Mono")) if self.pixel_format else None


class VirtualCamera(CameraSettings):
    """The camera of the virtual rig."""

    driver: ClassVar[str] = "camera_node.drivers.virtual:open_virtual_camera"
    elsewhere: ClassVar[str] = "the section virtual_rig describes this camera"
    needs_size: ClassVar[bool] = False

    source: Literal["virtual"] = "virtual"
    timeout_s: float = Field(
        120.0,
        gt=0,
        le=600,
        description="Longest wait for scene and frame, each [s]; the first image at a new position takes seconds, on a "
        "busy computer more. For subscribers at most 5 s.",
    )


class StoredImages(CameraSettings):
    """Images that are used as they are stored."""

    elsewhere: ClassVar[str] = "the images are used as they are stored"
    needs_size: ClassVar[bool] = False

    files: FilePath = Field("", description="Folder of the images, or a pattern such as `folder/*.tif`.")
    repeat: bool = Field(False, description="Start again after the last image.")

    @model_validator(mode="after")
    def _files_are_named(self) -> Self:
        if not self.files:
            raise ValueError(f"source: {self.source} needs the key files, the images that it reads")
        return self

    @property
    def device(self) -> str:
        """The images: each is used once."""
        return self.files


class FilesCamera(StoredImages):
    """A folder of images."""

    driver: ClassVar[str] = "camera_node.drivers.files:FilesDriver"

    source: Literal["files"] = "files"


class VideoCamera(StoredImages):
    """A video file."""

    driver: ClassVar[str] = "camera_node.drivers.video:VideoDriver"

    source: Literal["video"] = "video"
    files: FilePath = Field("", description="The video file.")


class AravisCamera(CameraSettings):
    """A GigE Vision or USB3 Vision camera."""

    driver: ClassVar[str] = "camera_node.drivers.aravis:AravisDriver"
    elsewhere: ClassVar[str] = "the meaning of the stamps of such a camera is known"

    source: Literal["aravis"] = "aravis"
    camera: str = Field("", description="Identifier or network address; empty: the only camera.")
    pixel_format: PixelFormat = Field("Mono8", description="Pixel format.")
    first_column: int = Field(0, ge=0, le=32768, description="First column of the used part of the sensor [px].")
    first_row: int = Field(0, ge=0, le=32768, description="First row of the used part of the sensor [px].")
    gain_db: float = Field(0.0, ge=-100, le=100, description="Gain, for cameras with adjustable gain [dB].")
    trigger: Trigger = Field(Trigger.SOFTWARE, strict=False, description="Event that starts an exposure.")
    trigger_line: str = Field("Line1", description="Input of the external triggers.")
    packet_size_byte: int = Field(
        0, ge=0, le=65535, description="Size of network packets [byte]; 0: the largest possible."
    )

    @model_validator(mode="after")
    def _part_has_a_size(self) -> Self:
        if (self.first_column or self.first_row) and self.size is None:
            raise ValueError("first_column and first_row need width and height of the used part of the sensor")
        return self

    @property
    def device(self) -> str:
        """Identifier or address."""
        return self.camera or "the only one"

    @property
    def first(self) -> tuple[int, int]:
        """Column and row of the sensor with which the images begin [px]."""
        return self.first_column, self.first_row

    @property
    def region(self) -> tuple[int, int, int, int] | None:
        """Column, row, width and height of the used part of the sensor [px]; None: all of it."""
        return (self.first_column, self.first_row, self.width, self.height) if self.size else None


class V4l2Camera(CameraSettings):
    """A USB camera (UVC) or another device of Video4Linux."""

    driver: ClassVar[str] = "camera_node.drivers.v4l2:V4l2Driver"
    elsewhere: ClassVar[str] = "such a camera runs freely with its whole image, and v4l2-ctl sets its gain"

    source: Literal["v4l2"] = "v4l2"
    camera: str = Field(
        "", description="Path of the device; those in /dev/v4l/by-id do not change when it is plugged in again."
    )
    pixel_format: PixelFormat = Field("Mono8", description="Pixel format, Mono8 or Mono16.")
    stamp_of: StampOf = Field(
        StampOf.END, strict=False, description="Moment of the exposure to which the stamps belong; end is safe."
    )

    @model_validator(mode="after")
    def _device_is_named(self) -> Self:
        if not self.camera:
            raise ValueError("source: v4l2 needs the key camera, a path such as /dev/video0")
        return self

    @property
    def device(self) -> str:
        """Path of the device."""
        return self.camera


class TopicCamera(CameraSettings):
    """A camera with a ROS 2 driver of its own."""

    driver: ClassVar[str] = "camera_node.drivers.topic:TopicDriver"
    elsewhere: ClassVar[str] = "the driver of the camera has its own settings"

    source: Literal["topic"] = "topic"
    topic: str = Field("", description="Topic of the images, such as /cam/image_raw.")
    stamp_of: StampOf = Field(
        StampOf.END, strict=False, description="Moment of the exposure to which the stamps belong; end is safe."
    )

    @model_validator(mode="after")
    def _topic_is_named(self) -> Self:
        if not self.topic:
            raise ValueError("source: topic needs the key topic, the image topic of the camera's driver")
        return self

    @property
    def device(self) -> str:
        """Topic of the images."""
        return self.topic


CAMERAS = Devices(
    "fringedic.cameras",
    CameraSettings,
    (VirtualCamera, FilesCamera, VideoCamera, AravisCamera, V4l2Camera, TopicCamera),
)
Camera = Annotated[SerializeAsAny[CameraSettings], CAMERAS]
"""Settings of any camera; `source` selects their model."""


class CameraNodeSettings(VirtualDeviceNodeSettings):
    """Settings of the camera node."""

    device: Camera = Field(VirtualCamera(), description="The camera.")
    frame_rate_hz: float = Field(
        0.0,
        ge=0,
        le=1000,
        description="Free run: frames per second [Hz]; 0: frames only on request (`camera/capture`).",
    )
    truth_folder: str = Field(
        "", description="Folder for `truth.nc` of the virtual rig, one entry per completed step; empty: none."
    )
