"""Images from files: their order, and files that cannot be read."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from camera_node.drivers import Scene
from camera_node.drivers.files import FilesDriver
from fringedic.errors import CameraError
from fringedic.settings.camera import FilesCamera

SCENE = Scene(0, (), 0.0)


def test_order_end_and_repeat(tmp_path: Path) -> None:
    for name, level in (("b", 2), ("a", 1), ("c", 3)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.full((4, 4), level, np.uint8))
    (tmp_path / "notes.txt").write_text("not an image")
    once = FilesDriver(FilesCamera(files=str(tmp_path)))
    assert [int(once.expose(SCENE).image[0, 0]) for _ in range(3)] == [1, 2, 3]
    with pytest.raises(CameraError, match="all 3 images"):
        once.expose(SCENE)
    again = FilesDriver(FilesCamera(files=str(tmp_path / "[bc].png"), repeat=True))
    assert [int(again.expose(SCENE).image[0, 0]) for _ in range(5)] == [2, 3, 2, 3, 2]


@pytest.mark.parametrize("files", ["nowhere", "nowhere/*.png"])
def test_no_images(files: str) -> None:
    with pytest.raises(CameraError, match="folder of images"):
        FilesDriver(FilesCamera(files=files))


def test_bad_files_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"this is no picture")
    (tmp_path / "b.png").write_bytes(b"")
    (tmp_path / "c.png").mkdir()
    cv2.imwrite(str(tmp_path / "d.tif"), np.full((4, 4), 0.5, np.float32))
    cv2.imwrite(str(tmp_path / "e.png"), np.full((4, 4), 9, np.uint8))
    driver = FilesDriver(FilesCamera(files=str(tmp_path)))
    for name, words in (
        ("a.png", "not an image"),
        ("b.png", "not an image"),
        ("c.png", "cannot be read"),
        ("d.tif", "float32"),
    ):
        with pytest.raises(CameraError, match=f"{name}.*{words}"):
            driver.expose(SCENE)
    assert driver.expose(SCENE).image[0, 0] == 9
