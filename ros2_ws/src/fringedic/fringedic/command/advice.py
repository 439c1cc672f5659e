"""Displacement and strain of image files, and advice on settings, without a rig and without ROS."""

from __future__ import annotations

from pathlib import Path

from fringedic import Advice, advise_settings
from fringedic.frames.files import read_alike


def advise_on_images(
    images: tuple[Path, Path, Path],
    *,
    wanted_noise: float | None,
    wanted_period: float | None,
    pixel_size: float | None,
    strain_window: int,
) -> Advice:
    """Recommend settings from the files of a reference and two static images, see `fringedic.advise_settings`.

    Raises
    ------
    ImageError
        An image cannot be read, or has another size or pixel type than the first one.
    FringedicError
        The requested noise or resolution is not a positive number, or the images do not show the same surface.
    """
    reference, first, second = read_alike(images)
    return advise_settings(
        reference,
        first,
        second,
        wanted_noise=wanted_noise,
        wanted_period=wanted_period,
        pixel_size=pixel_size,
        strain_window=strain_window,
    )
