"""In-plane displacement between image files, without a rig and without ROS."""

from __future__ import annotations

from pathlib import Path

import xarray as xr

from fringedic import Advice, Reference, advise_settings, measure_displacement
from fringedic.errors import FringedicError, ImageError
from fringedic.figures.maps import maps_figure
from fringedic.figures.panels import IN_PLANE
from fringedic.frames.files import read_grey
from fringedic_bringup.procedures.outcome import Progress
from fringedic_bringup.procedures.region import mask_of

DATASET = "displacement.nc"


def measure_images(
    images: list[Path], folder: Path, progress: Progress, *, window: int, spacing: int, mask: Path | None = None
) -> tuple[Path, list[Path]]:
    """Measure each image against the first one.

    Each search starts from the previous result, so that a large motion may build up over the images.

    Parameters
    ----------
    images
        The reference and at least one deformed image.
    folder
        Where ``displacement.nc`` over (step, row, column) and one picture per image are written.
    progress
        Receives the image that is measured.
    window, spacing
        See `fringedic.measure_displacement` [px].
    mask
        Image or polygons of the measured region, see `mask_of`; None: the whole image.

    Returns
    -------
    tuple
        File of the dataset, and the pictures.

    Raises
    ------
    ImageError
        There is only one image, or one cannot be read.
    FringedicError
        An image does not show the surface of the reference.
    """
    if len(images) < 2:
        raise ImageError("give a reference image and at least one deformed image")
    first = read_grey(images[0])
    region = None if mask is None else mask_of(mask, first.shape)
    reference = Reference(first, window=window, spacing=spacing, mask=region)
    folder.mkdir(parents=True, exist_ok=True)
    fields: list[xr.Dataset] = []
    pictures = []
    for number, path in enumerate(images[1:], start=1):
        progress.step(number, len(images) - 1, path.name)
        try:
            field = measure_displacement(reference, read_grey(path), initial=fields[-1] if fields else None)
        except FringedicError as error:
            raise type(error)(f"{path}: {error}", code=error.code) from error
        fields.append(field)
        maps = field.rename(sigma_x="displacement_sigma_x", sigma_y="displacement_sigma_y")
        figure = maps_figure(maps, IN_PLANE, title=f"{path.name} against {images[0].name}")
        pictures.append(folder / f"{path.stem}.png")
        figure.savefig(pictures[-1])
    target = folder / DATASET
    names = xr.DataArray([path.name for path in images[1:]], dims="step", name="image")
    # by way of memory: HDF5 ends the process when it cannot write to the disk
    target.write_bytes(xr.concat(fields, dim=names).to_netcdf(engine="h5netcdf"))
    return target, pictures


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
        An image cannot be read.
    FringedicError
        The requested noise or resolution is not a positive number, or the images do not show the same surface.
    """
    reference, first, second = (read_grey(path) for path in images)
    return advise_settings(
        reference,
        first,
        second,
        wanted_noise=wanted_noise,
        wanted_period=wanted_period,
        pixel_size=pixel_size,
        strain_window=strain_window,
    )
