"""Reads and writes grey levels in image files."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np

from fringedic.errors import ImageError
from fringedic.frames.grey import luminance
from fringedic.wording.causes import cause_of

_WHOLE = re.compile(r"(\d+)")
_DECIMAL = re.compile(r"((?:(?<![a-z0-9])-)?\d+(?:[.,]\d+)?)")
_BEHIND_POINT = re.compile(r"\d[.,](\d+)")
_PNG, _PNG_END = b"\x89PNG", b"IEND"
logging.getLogger("tifffile").addHandler(logging.NullHandler())  # it prints what is wrong with a file
IMAGE_SUFFIXES = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".tif", ".tiff")


def read_grey(path: Path) -> np.ndarray:
    """Return the grey levels of an image file; colours and palettes become their luminance.

    Parameters
    ----------
    path
        File of a format that OpenCV reads, see ``IMAGE_SUFFIXES``.

    Returns
    -------
    ndarray
        uint8 or uint16, shape (row, column).

    Raises
    ------
    ImageError
        The file is missing, is no image, is larger than 268 million pixels, has several pages, or another pixel type;
        or it is a TIFF file whose pixels would be turned, mirrored or scaled when they are read.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "image.png"
    ...     _ = cv2.imwrite(str(file), np.full((2, 3), 4000, np.uint16))
    ...     read_grey(file)
    array([[4000, 4000, 4000],
           [4000, 4000, 4000]], dtype=uint16)
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ImageError(f"{path} cannot be read: {cause_of(error)}") from error
    if content.startswith(_PNG) and _PNG_END not in content[-16:]:  # libpng prints a line of its own about it
        raise ImageError(f"{path} is cut off; copy it again")
    if content[:2] in (b"II", b"MM"):
        _refuse_changed_tiff(path, content)
    try:
        with _quiet_opencv():
            image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content else None
            pages = cv2.imcount(str(path))
    except cv2.error as error:
        raise ImageError(f"{path} is no image, or larger than 268 million pixels: {error.err}") from error
    if image is None:
        raise ImageError(f"{path} is not an image that can be read")
    if pages > 1:
        raise ImageError(f"{path} has {pages} pages, which may be several images: write each to a file of its own")
    if image.dtype not in (np.uint8, np.uint16):
        raise ImageError(f"{path} has pixels of type {image.dtype}; 8 or 16 bits are needed")
    return image if image.ndim == 2 else luminance(image)


def write_grey(path: Path, image: np.ndarray) -> None:
    """Write grey levels (row, column), uint8 or uint16, into an image file.

    Raises
    ------
    ImageError
        The file cannot be written, or its suffix is none of ``IMAGE_SUFFIXES``.
    """
    try:
        written = cv2.imwrite(str(path), image)
    except cv2.error as error:
        raise ImageError(f"{path}: cannot be written as an image; take a name that ends in .png") from error
    if not written:
        raise ImageError(f"{path}: cannot be written; check the folder and the space on the disk")


def _refuse_changed_tiff(path: Path, content: bytes) -> None:
    """Refuse a TIFF file whose pixels OpenCV changes: it turns them by their tag and scales packed bits to 16."""
    from tifffile import TiffFile  # not at the top: cameras and most images do without it

    try:
        with TiffFile(BytesIO(content)) as file:
            page = file.pages.first
            turned, bits, white_is_0 = page.tags.valueof(274, 1) != 1, page.bitspersample, page.photometric == 0
    except Exception:  # of many classes for damaged files, which OpenCV judges
        return
    if turned:
        raise ImageError(f"{path} has a tag that turns or mirrors its pixels; save it as it is shown, without the tag")
    if bits % 8 and bits != 1:
        raise ImageError(f"{path} packs {bits} bits per pixel; save it with 16 bits")
    if white_is_0 and bits > 8:  # fewer bits are inverted as they should be
        raise ImageError(f"{path} stores white as 0; save it with black as 0")


@contextmanager
def _quiet_opencv() -> Iterator[None]:
    """Keep OpenCV from printing what is wrong with a file, which the error says in one sentence."""
    log = cv2.utils.logging
    before = log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        log.setLogLevel(before)


def image_files(places: Iterable[Path]) -> list[Path]:
    """Return image files as given, and those of folders in the order in which people number them: 2 before 10.

    Parameters
    ----------
    places
        Files, folders, or patterns such as ``load_*.tif``.

    Raises
    ------
    ImageError
        A file or folder is missing, a folder contains no images, or a pattern matches none.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name in ("load_10.png", "load_2.png", "notes.txt"):
    ...         _ = (Path(folder) / name).write_text("")
    ...     [file.name for file in image_files([Path(folder)])]
    ['load_2.png', 'load_10.png']
    """
    found: list[Path] = []
    for place in places:
        is_pattern = any(letter in place.name for letter in "*?[") and not place.exists()
        if place.is_file():
            found.append(place)
            continue
        if not place.is_dir() and not is_pattern:
            raise ImageError(f"{place}: no such image or folder of images")
        among = place.parent.glob(place.name) if is_pattern else place.iterdir()
        images = _in_order(
            file for file in among if file.suffix.lower() in IMAGE_SUFFIXES and not file.name.startswith(".")
        )
        if not images:
            raise ImageError(f"{place}: contains no images; known are {', '.join(IMAGE_SUFFIXES)}")
        found += images
    return found


def _in_order(files: Iterable[Path]) -> list[Path]:
    """Return files in the order of the numbers in their names: -1, 0, 0.25, 0.5, 2, 10.

    A point or comma is that of a decimal number, unless the numbers behind it count on, as 1.9 and 1.10 do. A hyphen
    between numbers, as in dates, is no sign.
    """
    images = list(files)
    behind = [part for image in images for part in _BEHIND_POINT.findall(image.stem)]
    counted = sorted(map(int, behind))
    counts_on = len(set(map(len, behind))) > 1 and counted == list(range(counted[0], counted[0] + len(counted)))
    number = _WHOLE if counts_on and not any(part.startswith("0") for part in behind) else _DECIMAL

    def by_number(image: Path) -> list[tuple[bool, float, str]]:
        parts = number.split(image.stem.lower())  # texts and numbers in turns
        key = [(i % 2 == 1, float(part.replace(",", ".")) if i % 2 else 0.0, part) for i, part in enumerate(parts)]
        return [*key, (False, 0.0, image.suffix.lower())]

    return sorted(images, key=by_number)
