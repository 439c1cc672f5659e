"""Grey levels of image files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image as Picture

from fringedic.errors import ImageError
from fringedic.frames.files import image_files, read_grey

TURNED, BITS, PHOTOMETRIC, WHITE_IS_0 = 274, 258, 262, 0  # tags of TIFF 6.0


def levels(dtype: type[np.unsignedinteger], *shape: int) -> np.ndarray:
    values = np.random.default_rng(2).integers(0, np.iinfo(dtype).max, shape, endpoint=True)
    return values.astype(dtype)


@pytest.mark.parametrize("suffix", ["png", "tif", "pgm"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_grey_files_are_taken_as_they_are(tmp_path: Path, suffix: str, dtype: type[np.unsignedinteger]) -> None:
    image = levels(dtype, 5, 7)
    path = tmp_path / f"a.{suffix}"
    assert cv2.imwrite(str(path), image)
    read = read_grey(path)
    assert read.dtype == dtype
    np.testing.assert_array_equal(read, image)


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "P"])
@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_colours_and_palettes_become_luminance(tmp_path: Path, suffix: str, mode: str) -> None:
    """Both are compared with Pillow, whose rounding of the luminance is the same."""
    picture = Picture.fromarray(levels(np.uint8, 30, 40, 3), "RGB").convert(mode)
    path = tmp_path / f"a.{suffix}"
    picture.save(path)
    with Picture.open(path) as saved:
        expected = np.asarray(saved.convert("RGB").convert("L"))
    np.testing.assert_array_equal(read_grey(path), expected)


def test_grey_palette_keeps_its_levels(tmp_path: Path) -> None:
    image = levels(np.uint8, 30, 40)
    picture = Picture.fromarray(image).convert("L")
    picture.putpalette([level for grey in range(256) for level in (grey, grey, grey)])
    picture.save(tmp_path / "a.tif")
    np.testing.assert_array_equal(read_grey(tmp_path / "a.tif"), image)


@pytest.mark.parametrize(
    ("tags", "words"),
    [
        ({TURNED: 3}, "turns or mirrors"),
        ({TURNED: 6}, "turns or mirrors"),
        ({BITS: 12}, "packs 12 bits"),
        ({PHOTOMETRIC: WHITE_IS_0}, "stores white as 0"),
    ],
)
def test_tiff_files_whose_pixels_would_be_changed_are_refused(tmp_path: Path, tags: dict[int, int], words: str) -> None:
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, levels(np.uint16, 12, 16), photometric="minisblack", extratags=[(TURNED, "H", 1, 1, True)])
    with tifffile.TiffFile(path, mode="r+b") as file:
        for number, value in tags.items():
            file.pages.first.tags[number].overwrite(value)
    with pytest.raises(ImageError, match=words):
        read_grey(path)


def test_bad_files_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"this is no picture")
    (tmp_path / "b.png").write_bytes(b"")
    (tmp_path / "c.png").mkdir()
    cv2.imwrite(str(tmp_path / "d.tif"), np.zeros((4, 4), np.float32))
    for name, words in (
        ("a.png", "not an image"),
        ("b.png", "not an image"),
        ("c.png", "cannot be read"),
        ("d.tif", "float32"),
    ):
        with pytest.raises(ImageError, match=f"{name}.*{words}"):
            read_grey(tmp_path / name)


@pytest.mark.parametrize(("suffix", "words"), [("png", "is cut off; copy it again"), ("tif", "not an image")])
def test_libraries_print_nothing_about_files_that_are_cut_off(
    tmp_path: Path, suffix: str, words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"a.{suffix}"
    cv2.imwrite(str(path), levels(np.uint8, 90, 120))
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(ImageError, match=words):
        read_grey(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "names",
    [
        ["load_-2.5", "load_-1", "load_0", "load_0.25", "load_0.5", "load_1.05", "load_1.5", "load_10"],
        ["a_0,5", "a_1", "a_1,25", "a_10"],
        ["2026-05-02 10", "2026-05-12 9", "2026-11-01 1"],
        ["cam1.8", "cam1.9", "cam1.10", "cam1.11"],
        ["step9_cam2", "step10_cam1", "step10_cam2"],
    ],
)
def test_names_are_ordered_as_people_number_them(tmp_path, names):
    for name in reversed(names):
        (tmp_path / f"{name}.tif").touch()
    (tmp_path / "._load_0.tif").touch()  # what macOS keeps beside a file
    assert [file.stem for file in image_files([tmp_path])] == names
