"""Reads and writes grey levels in image files."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np

from fringedic.errors import ImageError
from fringedic.frames.grey import luminance
from fringedic.frames.name_order import order_by_name
from fringedic.wording.causes import cause_of

_PNG, _PNG_END = b"\x89PNG", b"IEND"
_WHITE_IS_0, _BLACK_IS_0, _RGB, _INTERLEAVED, _ALPHA = 0, 1, 2, 1, (1, 2)  # values of tags of TIFF 6.0
_OPAQUE, _LARGEST = 255, 65535  # of 8 bits; grey level of 16 bits
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
        uint8 or uint16, shape (row, column). Pixels of other types whose values are all whole numbers from 0 to 65535
        are uint16.

    Raises
    ------
    ImageError
        The file is missing, is no image, is larger than 268 million pixels, has several pages, or values that 16 bits
        cannot hold; or it is a TIFF file whose pixels would be turned, mirrored or scaled when they are read.

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
    is_transparent = content[:2] in (b"II", b"MM") and _check_tiff(path, content)
    try:
        with _quiet_opencv():
            image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content else None
            pages = cv2.imcount(str(path))
    except cv2.error as error:
        raise ImageError(f"{path} is no image, or larger than 268 million pixels: {error.err}") from error
    if image is None:
        raise ImageError(
            f"{path} is not an image that can be read: copy it again, or save it as PNG or TIFF with 8 or 16 bits"
        )
    if pages > 1:
        raise ImageError(f"{path} has {pages} pages, which may be several images: write each to a file of its own")
    if is_transparent and image.ndim == 3 and (image[:, :, -1] < _OPAQUE).any():
        raise ImageError(f"{path} has transparent pixels; save it without transparency")
    if image.dtype not in (np.uint8, np.uint16):
        image = _whole_levels(path, image)
    return image if image.ndim == 2 else luminance(image)


def read_alike(paths: Sequence[Path]) -> list[np.ndarray]:
    """Return the grey levels of image files of one size and pixel type, each as `read_grey`.

    Raises
    ------
    ImageError
        A file cannot be read, or has another size or pixel type than the first one.
    """
    images = [read_grey(path) for path in paths]
    for path, image in zip(paths, images, strict=True):
        require_size(path, image, paths[0], images[0].shape)
        if image.dtype != images[0].dtype:
            raise ImageError(
                f"{path} has pixels of type {image.dtype}, {paths[0]} of {images[0].dtype}: save all images alike"
            )
    return images


def require_size(path: Path, image: np.ndarray, reference: Path, shape: tuple[int, ...]) -> None:
    """Check that an image has the shape (row, column) of a reference image; both files are for the error.

    Raises
    ------
    ImageError
        It has another size.
    """
    if image.shape != shape:
        raise ImageError(
            f"{path} has {image.shape[1]}x{image.shape[0]} px, {reference} has {shape[1]}x{shape[0]} px: give images "
            "of one size"
        )


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


def _whole_levels(path: Path, image: np.ndarray) -> np.ndarray:
    """Return values of another type as uint16, which changes none of them, or refuse them."""
    if ((image >= 0) & (image <= _LARGEST) & (image == np.floor(image))).all():  # NaN is none of these
        return image.astype(np.uint16)
    finite = image[np.isfinite(image)]
    span = f" from {finite.min():g} to {finite.max():g}" if finite.size else ""
    unknown = " and NaN or infinite ones" if finite.size < image.size else ""
    raise ImageError(
        f"{path} has {image.dtype} values{span}{unknown}: convert all images of a series by one scale and offset to "
        f"whole numbers from 0 to {_LARGEST} and save them with 16 bits without a sign"
    )


def _check_tiff(path: Path, content: bytes) -> bool:
    """Refuse a TIFF file whose pixels OpenCV changes; return whether it changes transparent pixels, of 8 bits."""
    from tifffile import TiffFile  # not at the top: cameras and most images do without it

    try:
        with TiffFile(BytesIO(content)) as file:
            page = file.pages.first
            is_turned, bits, samples = page.tags.valueof(274, 1) != 1, page.bitspersample, page.samplesperpixel
            photometric, planar, extra = page.photometric, page.planarconfig, page.extrasamples
    except Exception:  # of many classes for damaged files, which OpenCV judges
        return False
    if is_turned:
        raise ImageError(f"{path} has a tag that turns or mirrors its pixels; save it as it is shown, without the tag")
    if bits % 8 and bits != 1:
        raise ImageError(f"{path} packs {bits} bits per pixel; save it with 16 bits")
    if bits > 8:  # fewer bits are converted as they should be
        if photometric == _WHITE_IS_0:
            raise ImageError(f"{path} stores white as 0; save it with black as 0")
        if photometric not in (_BLACK_IS_0, _RGB):
            raise ImageError(f"{path} has {bits}-bit colours that are not RGB; save it as grey levels")
        if samples > 1 and (planar != _INTERLEAVED or samples not in (3, 4)):
            raise ImageError(f"{path} has {samples} channels of {bits} bits; save it as grey levels")
    return bits == 8 and any(each in _ALPHA for each in extra)


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
    """Return image files as given, and those of folders and patterns in the order of `order_by_name`: 2 before 10.

    Parameters
    ----------
    places
        Files, folders, or patterns such as ``load_*.tif``. Hidden files in folders, such as ``._load_1.tif``, are left
        out.

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
        images = order_by_name(
            file for file in among if file.suffix.lower() in IMAGE_SUFFIXES and not file.name.startswith(".")
        )
        if not images:
            raise ImageError(f"{place}: contains no images; known are {', '.join(IMAGE_SUFFIXES)}")
        found += images
    return found
