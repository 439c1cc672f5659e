"""Images from files instead of a camera: each exposure takes the next one."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
from rclpy.node import Node

from camera_node.drivers.driver import Frame, LocalDriver, Scene
from fringedic.errors import CameraError, ImageError
from fringedic.frames.files import image_files, read_grey
from fringedic.settings.camera import FilesCamera

_KEPT_IMAGES = 16  # of a source that repeats, so that a short series costs no reading


class FilesDriver(LocalDriver):
    """Camera that reads image files in the order of the numbers in their names.

    Parameters
    ----------
    settings
        The files, and whether they are repeated.

    Raises
    ------
    CameraError
        There is no such image.
    """

    def __init__(self, settings: FilesCamera, _node: Node | None = None) -> None:
        self._files, self._repeat = settings.files, settings.repeat
        try:
            self._paths = image_files([Path(self._files)])
        except ImageError as error:
            raise CameraError(f"{error}; set files to a folder of images") from error
        self._read: Callable[[Path], np.ndarray] = lru_cache(_KEPT_IMAGES)(_read) if self._repeat else _read
        self._next = 0

    def expose(self, scene: Scene) -> Frame:
        """Read the next image; an image that cannot be read is passed over by the next call.

        Raises
        ------
        CameraError
            The image cannot be read, or all have been taken.
        """
        if self._next == len(self._paths) and self._repeat:
            self._next = 0
        if self._next == len(self._paths):
            raise CameraError(
                f"all {len(self._paths)} images of '{self._files}' have been taken; set repeat to begin again"
            )
        path = self._paths[self._next]
        self._next += 1
        return Frame(self._read(path), time.time_ns(), scene.exposure_time)

    def close(self) -> None:
        """Nothing is kept open."""


def _read(path: Path) -> np.ndarray:
    """Return the grey levels of an image file."""
    try:
        return read_grey(path)
    except ImageError as error:
        raise CameraError(str(error)) from error
