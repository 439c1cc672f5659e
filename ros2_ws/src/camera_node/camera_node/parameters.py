"""Parameters of the camera node, and the driver that they select."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator
from rclpy.node import Node

from camera_node.drivers import (
    AravisDriver,
    AravisSettings,
    Driver,
    FilesDriver,
    StampOf,
    TopicDriver,
    TopicSettings,
    Trigger,
    V4l2Driver,
    V4l2Settings,
    VideoDriver,
    VirtualDriver,
)
from fringedic_ros.lifecycle import HardwareParameters
from fringedic_ros.virtual import VirtualRigText, virtual_configuration

_NAMED = {"files": "a folder of images", "video": "a video file"}
_OF_THE_TIMEOUT = 0.8  # of the driver, whose error messages are more precise


class CameraParameters(HardwareParameters):
    """Parameters of the camera node."""

    source: Literal["virtual", "files", "video", "aravis", "v4l2", "topic"] = Field(
        "virtual",
        description="Source of the frames; aravis: a GigE Vision or USB3 Vision camera; v4l2: a USB camera (UVC); "
        "topic: the driver node of another camera.",
    )
    exposure_time_s: float = Field(0.01, gt=0, le=60, description="Exposure time [s].")
    settle_time_s: float = Field(
        0.0, ge=0, le=60, description="Pause between the pattern on the screen and the start of the exposure [s]."
    )
    timeout_s: float = Field(
        10.0, gt=0, le=600, description="Longest wait for scene and frame, each [s]; for subscribers at most 5 s."
    )
    frame_rate_hz: float = Field(
        0.0,
        ge=0,
        le=1000,
        description="Free run: frames per second [Hz]; 0: frames only on request (`camera/capture`).",
    )
    virtual_rig: VirtualRigText = "{preset: plate}"
    truth_folder: str = Field(
        "", description="Folder for `truth.nc` of the virtual rig, one entry per completed step; empty: none."
    )
    files: str = Field(
        "",
        description="Source `files`: a folder of images or a pattern such as `folder/*.tif`. Source `video`: the file.",
    )
    repeat: bool = Field(False, description="Sources `files` and `video`: start again after the last image.")
    topic: str = Field("", description="Source `topic`: image topic of the camera driver, such as `/cam/image_raw`.")
    stamp_of: StampOf = Field(
        StampOf.END,
        description="Sources `topic` and `v4l2`: moment of the exposure to which the stamps belong; use end when it is "
        "unknown.",
    )
    camera: str = Field(
        "",
        description="Source `aravis`: identifier or network address of the camera; empty: the only one. Source `v4l2`: "
        "path of the device.",
    )
    pixel_format: Literal["Mono8", "Mono10", "Mono12", "Mono16"] = Field(
        "Mono8", description="Sources `aravis` and `v4l2`: bit depth of the pixels."
    )
    region_px: list[int] = Field(
        [],
        description="Source `aravis`: first column, first row, width, height [px]; empty: the whole sensor. Source "
        "`v4l2`: 0, 0, width, height of a format of the camera.",
    )
    gain_db: float = Field(
        0.0, ge=-100, le=100, description="Source `aravis`: gain, for cameras with adjustable gain [dB]."
    )
    trigger: Trigger = Field(Trigger.SOFTWARE, description="Source `aravis`: event that starts an exposure.")
    trigger_line: str = Field("Line1", description="Source `aravis`: input of the external triggers.")
    packet_size_byte: int = Field(
        0, ge=0, le=65535, description="Source `aravis`: size of network packets [byte]; 0: the largest possible."
    )

    @model_validator(mode="after")
    def _sources_are_named(self) -> Self:
        if self.source in _NAMED and not self.files:
            raise ValueError(f"source {self.source} needs the parameter files: {_NAMED[self.source]}")
        if self.source == "topic" and not self.topic:
            raise ValueError("source topic needs the parameter topic: the image topic of the camera driver")
        if self.source == "v4l2" and not self.camera:
            raise ValueError("source v4l2 needs the parameter camera: a path such as /dev/video0")
        if len(self.region_px) not in (0, 4):
            raise ValueError("region_px needs four numbers: first column, first row, width, height")
        if self.source == "v4l2" and self.region_px[:2] not in ([], [0, 0]):
            raise ValueError("region_px of the source v4l2 starts with 0, 0: such cameras have formats, no regions")
        return self

    @property
    def driver_timeout(self) -> float:
        """Longest wait of the driver for a frame beyond its exposure time [s]."""
        return _OF_THE_TIMEOUT * self.timeout_s

    def aravis(self) -> AravisSettings:
        """Return the settings of a GenICam camera."""
        region = None
        if self.region_px:
            column, row, width, height = self.region_px
            region = column, row, width, height
        return AravisSettings(
            camera=self.camera,
            exposure_time=self.exposure_time_s,
            gain=self.gain_db,
            pixel_format=self.pixel_format,
            region=region,
            trigger=self.trigger,
            trigger_line=self.trigger_line,
            packet_size=self.packet_size_byte,
            timeout=self.driver_timeout,
        )

    def v4l2(self) -> V4l2Settings:
        """Return the settings of a Video4Linux device."""
        return V4l2Settings(
            device=self.camera,
            exposure_time=self.exposure_time_s,
            size=(self.region_px[2], self.region_px[3]) if self.region_px else None,
            pixel_format=self.pixel_format,
            stamp_of=self.stamp_of,
            timeout=self.driver_timeout,
        )

    def open(self, node: Node) -> Driver:
        """Open the camera; `node` owns the subscription of the source `topic`.

        Raises
        ------
        FringedicError
            There is no such camera, or it does not offer a setting.
        """
        if self.source == "files":
            return FilesDriver(self.files, repeat=self.repeat)
        if self.source == "video":
            return VideoDriver(self.files, repeat=self.repeat)
        if self.source == "aravis":
            return AravisDriver(self.aravis())
        if self.source == "v4l2":
            return V4l2Driver(self.v4l2())
        if self.source == "topic":
            settings = TopicSettings(self.topic, self.exposure_time_s, self.stamp_of, self.driver_timeout)
            return TopicDriver(node, settings)
        return VirtualDriver(virtual_configuration(self.virtual_rig))
