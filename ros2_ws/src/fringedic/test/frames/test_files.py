"""Grey levels of image files."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image as Picture

from fringedic.errors import ImageError
from fringedic.frames.files import image_files, read_alike, read_grey

TURNED, PHOTOMETRIC, WHITE_IS_0 = 274, 262, 0  # tags of TIFF 6.0
ROWS, COLUMNS = 12, 16


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


@pytest.mark.parametrize("bits", [4, 10, 12])
def test_packed_tiff_files_are_refused(tmp_path: Path, bits: int) -> None:
    """The pixels of a row follow each other without gaps, as cameras pack them."""
    values = np.random.default_rng(1).integers(0, 2**bits, (ROWS, COLUMNS))
    packed = np.packbits(values[..., None] >> np.arange(bits)[::-1] & 1).tobytes()
    tags = {256: COLUMNS, 257: ROWS, 258: bits, 259: 1, 262: 1, 273: 8, 277: 1, 278: ROWS, 279: len(packed)}
    directory = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", tag, 4, 1, n) for tag, n in tags.items())
    path = tmp_path / "a.tif"
    path.write_bytes(struct.pack("<2sHI", b"II", 42, 8 + len(packed)) + packed + directory + bytes(4))
    with pytest.raises(ImageError, match=rf"a\.tif packs {bits} bits per pixel; save it with 16 bits"):
        read_grey(path)


@pytest.mark.parametrize("dtype", [np.int8, np.int16, np.int32, np.uint32, np.float32, np.float64])
def test_other_types_are_read_if_16_bits_hold_their_values(tmp_path: Path, dtype: type[np.number]) -> None:
    values = np.random.default_rng(1).integers(0, min(65535, np.iinfo(np.int8).max), (ROWS, COLUMNS))
    if np.dtype(dtype).itemsize > 2:
        values[0, :2] = 0, 65535
    tifffile.imwrite(tmp_path / "a.tif", values.astype(dtype))
    read = read_grey(tmp_path / "a.tif")
    assert read.dtype == np.uint16
    np.testing.assert_array_equal(read, values)


@pytest.mark.parametrize(
    ("dtype", "values", "words"),
    [
        (np.int16, [-3, 7], "int16 values from -3 to 7: "),
        (np.int32, [0, 70000], "int32 values from 0 to 70000: "),
        (np.uint32, [0, 65536], "uint32 values from 0 to 65536: "),
        (np.float32, [0.25, 0.5], r"float32 values from 0\.25 to 0\.5: "),
        (np.float64, [1, np.nan], "float64 values from 1 to 1 and NaN or infinite ones: "),
        (np.float32, [np.nan, np.inf], "float32 values and NaN or infinite ones: "),
    ],
)
def test_values_that_16_bits_cannot_hold_are_refused_with_their_range(
    tmp_path: Path, dtype: type[np.number], values: list[float], words: str
) -> None:
    tifffile.imwrite(tmp_path / "a.tif", np.tile(np.array(values, dtype), (ROWS, 8)))
    cure = "convert all images of a series by one scale and offset to whole numbers from 0 to 65535"
    with pytest.raises(ImageError, match=rf"a\.tif has {words}{cure}"):
        read_grey(tmp_path / "a.tif")


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_colours_of_16_bits_become_luminance(tmp_path: Path, suffix: str) -> None:
    colours = levels(np.uint16, ROWS, COLUMNS, 3)
    cv2.imwrite(str(tmp_path / f"a.{suffix}"), colours[..., ::-1])
    expected = colours @ np.array([0.299, 0.587, 0.114])
    np.testing.assert_allclose(read_grey(tmp_path / f"a.{suffix}"), expected, rtol=0, atol=1)


@pytest.mark.parametrize("suffix", ["png", "tif", "bmp"])
def test_one_bit_becomes_black_and_white(tmp_path: Path, suffix: str) -> None:
    is_white = levels(np.uint8, ROWS, COLUMNS) > 127
    Picture.fromarray(is_white).save(tmp_path / f"a.{suffix}")
    np.testing.assert_array_equal(read_grey(tmp_path / f"a.{suffix}"), 255 * is_white)


@pytest.mark.parametrize(
    ("shape", "dtype", "options", "words"),
    [
        ((3, ROWS, COLUMNS), np.uint16, {"photometric": "rgb", "planarconfig": "separate"}, "3 channels of 16 bits"),
        (
            (ROWS, COLUMNS, 2),
            np.uint16,
            {"photometric": "minisblack", "planarconfig": "contig"},
            "2 channels of 16 bits",
        ),
        ((ROWS, COLUMNS, 4), np.uint16, {"photometric": "separated"}, "16-bit colours that are not RGB"),
        ((ROWS, COLUMNS, 4), np.uint8, {"photometric": "rgb", "extrasamples": ["unassalpha"]}, "transparent pixels"),
        ((3, ROWS, COLUMNS), np.uint8, {"photometric": "minisblack"}, "3 pages"),
    ],
)
def test_layouts_that_opencv_misreads_are_refused(
    tmp_path: Path, shape: tuple[int, ...], dtype: type[np.unsignedinteger], options: dict[str, Any], words: str
) -> None:
    tifffile.imwrite(tmp_path / "a.tif", levels(dtype, *shape), **options)
    with pytest.raises(ImageError, match=rf"a\.tif has {words}"):
        read_grey(tmp_path / "a.tif")


def test_files_that_are_not_alike_are_named(tmp_path: Path) -> None:
    for name, image in (("a", levels(np.uint8, 4, 6)), ("b", levels(np.uint8, 5, 7)), ("c", levels(np.uint16, 4, 6))):
        cv2.imwrite(str(tmp_path / f"{name}.png"), image)
    first, other_size, other_type = (tmp_path / f"{name}.png" for name in "abc")
    assert [image.shape for image in read_alike([first, first])] == [(4, 6)] * 2
    with pytest.raises(ImageError, match=r"b\.png has 7x5 px, .*a\.png has 6x4 px: give images of one size"):
        read_alike([first, other_size])
    with pytest.raises(ImageError, match=r"c\.png has pixels of type uint16, .*a\.png of uint8"):
        read_alike([first, other_type])


def test_bad_files_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"this is no picture")
    (tmp_path / "b.png").write_bytes(b"")
    (tmp_path / "c.png").mkdir()
    for name, words in (
        ("a.png", "not an image.*: copy it again, or save it as PNG or TIFF with 8 or 16 bits"),
        ("b.png", "not an image"),
        ("c.png", "cannot be read"),
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


def test_folders_and_patterns_leave_out_other_and_hidden_files(tmp_path: Path) -> None:
    for name in ("load_0.5.tif", "load_0.25.tif", "load_0.tif", "notes.txt"):
        (tmp_path / name).touch()
    (tmp_path / "._load_0.tif").touch()  # what macOS keeps beside a file
    for place in (tmp_path, tmp_path / "*.tif"):
        assert [file.name for file in image_files([place])] == ["load_0.tif", "load_0.25.tif", "load_0.5.tif"]
