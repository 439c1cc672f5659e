"""Subcommands for image files without a rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from fringedic_bringup.command.app import Overwrite, app, console, output_file, say
from fringedic_bringup.display.progress import LiveProgress


@app.command(epilog="Example: fringedic measure reference.tif loaded-1.tif loaded-2.tif --window 24 --output measured")
def measure(
    images: Annotated[list[Path], typer.Argument(help="The reference image, then the deformed images in order.")],
    window: Annotated[int, typer.Option(min=8, max=256, help="Width of the correlation window [px].")] = 32,
    spacing: Annotated[int, typer.Option(min=1, max=256, help="Distance of the measured points [px].")] = 1,
    mask: Annotated[
        Path | None, typer.Option(help="Region to measure: a mask image or polygons, as fringedic region writes them.")
    ] = None,
    output: Annotated[Path, typer.Option(help="Folder for dataset and pictures.")] = Path("measured"),
    overwrite: Overwrite = False,
) -> None:
    """Measure the in-plane displacement between images and write it as NetCDF and PNG."""
    from fringedic_bringup.procedures.images import DATASET, measure_images

    output_file(output / DATASET, overwrite)
    with LiveProgress(console) as progress:
        dataset, pictures = measure_images(images, output, progress, window=window, spacing=spacing, mask=mask)
    say(f"dataset: {dataset}", f"pictures: {len(pictures)} in {output}")


@app.command(epilog="Example: fringedic advise reference.tif static-1.tif static-2.tif --wanted-noise-px 0.005")
def advise(
    reference: Annotated[Path, typer.Argument(help="Image of the mounted specimen before the test.")],
    static_1: Annotated[Path, typer.Argument(help="A second image at rest.")],
    static_2: Annotated[Path, typer.Argument(help="A third image at rest.")],
    wanted_noise_px: Annotated[float | None, typer.Option(help="Wanted noise of the displacement in pixels.")] = None,
    wanted_period_px: Annotated[
        float | None, typer.Option(help="Shortest displacement wave in pixels that keeps 90 % of its amplitude.")
    ] = None,
    pixel_size_mm: Annotated[
        float | None, typer.Option(help="Size of a pixel on the specimen in mm, to print lengths in mm.")
    ] = None,
    strain_window_points: Annotated[int, typer.Option(help="Width of the strain window in points, odd.")] = 5,
) -> None:
    """Recommend window and spacing from three images at rest; print noise floors and possible improvements."""
    from fringedic.report.settings import settings_report
    from fringedic_bringup.procedures.images import advise_on_images

    advice = advise_on_images(
        (reference, static_1, static_2),
        wanted_noise=wanted_noise_px,
        wanted_period=wanted_period_px,
        pixel_size=None if pixel_size_mm is None else 1e-3 * pixel_size_mm,
        strain_window=strain_window_points,
    )
    typer.echo(settings_report(advice))
