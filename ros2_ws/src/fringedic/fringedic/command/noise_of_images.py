"""Noise floor with the specimen mounted, from image files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fringedic.errors import FringedicError, RigSetupError
from fringedic.figures.noise_floor import noise_figure
from fringedic.frames.files import read_alike
from fringedic.rig_setup.noise_floor import NoiseMeasurement, noise_of_images


def measure_noise_of_images(images: Sequence[Path], folder: Path, *, window: int, spacing: int) -> NoiseMeasurement:
    """Compute the noise floor of camera, displacement and strain from image files.

    Parameters
    ----------
    images
        At least three images of the specimen at rest.
    folder
        Where ``noise_floor.yaml`` and ``noise_floor.png`` are written.
    window, spacing
        See `fringedic.rig_setup.noise_of_images` [px].

    Raises
    ------
    ImageError
        An image cannot be read, or has another size or pixel type than the first one.
    RigSetupError
        There are fewer than three images.
    """
    levels = read_alike(images)
    try:
        measured = noise_of_images(levels, window=window, spacing=spacing)
    except RigSetupError:
        raise
    except FringedicError as error:
        raise type(error)(f"{images[0]} and the following images: {error}", code=error.code) from error
    measured.save(folder)
    noise_figure(measured).savefig(folder / "noise_floor.png")
    return measured
