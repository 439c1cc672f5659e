"""Subcommands for image files without a rig."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fringedic.command.app import (
    IMAGES,
    Overwrite,
    app,
    begin,
    console,
    kept_if_filled,
    named_gauges,
    named_regions,
    output_file,
    say,
)
from fringedic.command.progress import LiveProgress
from fringedic.errors import ConfigurationError, ImageError, StepFailedError

if TYPE_CHECKING:
    from fringedic.images import MeasuredImage

DATASET = "displacement.nc"
PHASE = "phase.nc"
PHASE_PICTURE = "phase.png"
REPORT = "report.html"
RECORDED_IMAGES = "images"


@app.command(
    rich_help_panel=IMAGES,
    epilog="Example: fringedic measure reference.tif loaded-1.tif loaded-2.tif --pixel-size-mm 0.05",
)
def measure(  # noqa: PLR0913 (options of a command)
    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGES", help="The reference image, then the deformed images in order; or their folder."
        ),
    ],
    bag: Annotated[
        str | None,
        typer.Option(
            metavar="TOPIC",
            help="IMAGES is a recording: measure the images on this topic, the first one is the reference.",
        ),
    ] = None,
    window: Annotated[int, typer.Option(min=8, max=256, help="Width of the subset in px.")] = 32,
    spacing: Annotated[int, typer.Option(min=1, max=256, help="Distance of the measured points in px.")] = 4,
    strain_window: Annotated[
        int,
        typer.Option(
            min=3,
            max=1001,
            help="Width of the window of the strain in px; it and the subset form the virtual strain gauge.",
        ),
    ] = 41,
    strain_measure: Annotated[
        str, typer.Option(help="Measure of the strain: green-lagrange, logarithmic or engineering.")
    ] = "green-lagrange",
    pixel_size_mm: Annotated[float | None, typer.Option(help="Size of a pixel on the specimen in mm.")] = None,
    scale_length_mm: Annotated[
        float | None, typer.Option(help="A known length in mm, whose two ends are clicked in a window.")
    ] = None,
    mask: Annotated[
        Path | None, typer.Option(help="Region to measure: a mask image or polygons, as fringedic region writes them.")
    ] = None,
    extensometer: Annotated[
        list[str] | None, typer.Option(metavar="NAME=COLUMN,ROW,COLUMN,ROW", help="Virtual extensometer of the report.")
    ] = None,
    region: Annotated[
        list[str] | None, typer.Option(metavar="NAME=POLYGONS.yaml", help="Region whose mean values the report lists.")
    ] = None,
    output: Annotated[Path, typer.Option(help="Folder for dataset and report.")] = Path("measured"),
    overwrite: Overwrite = False,
) -> None:
    """Measure displacement and strain of images of a flat specimen; write dataset and report."""
    begin(images[0])
    target, page = (output_file(output / name, overwrite) for name in (DATASET, REPORT))
    gauges, regions = named_gauges(extensometer), named_regions(region)
    if pixel_size_mm is not None and not 0 < pixel_size_mm < 1000:
        raise ConfigurationError(f"--pixel-size-mm {pixel_size_mm:g}: give the size of a pixel in mm, such as 0.05")
    if scale_length_mm is not None and not scale_length_mm > 0:
        raise ConfigurationError(f"--scale-length-mm {scale_length_mm:g}: give a known length in mm, such as 20")
    if pixel_size_mm is not None and scale_length_mm is not None:
        raise ConfigurationError("--pixel-size-mm and --scale-length-mm both give the scale: give one of them")
    from fringedic.surface.strain_measures import TENSORS

    if strain_measure not in TENSORS:
        raise ConfigurationError(f"--strain-measure {strain_measure}: give one of {', '.join(TENSORS)}")
    from fringedic.command.region_window import draw_scale
    from fringedic.datasets import open_experiment
    from fringedic.frames.files import image_files, read_grey
    from fringedic.frames.region import mask_of
    from fringedic.images import measure_images
    from fringedic.images.sentences import failure_sentences, order_sentences, series_sentences
    from fringedic.report import write_report

    if bag is not None:
        images = _recorded_images(images, bag, output)
    files = image_files(images)
    say(*order_sentences(files))
    for name, each in regions.items():
        try:
            each.mask_for(read_grey(files[0]).shape)  # refused before the measurement
        except ImageError as error:
            raise ImageError(f"--region {name}: {error}") from error
    pixel_size = None if pixel_size_mm is None else 1e-3 * pixel_size_mm
    if scale_length_mm is not None:
        pixel_size = draw_scale(read_grey(files[0]), 1e-3 * scale_length_mm)
    with LiveProgress(console) as progress, kept_if_filled(output):

        def tell(image: MeasuredImage, count: int) -> None:
            progress.step(image.step, count - 1, image.name)

        series = measure_images(
            files,
            target,
            window=window,
            spacing=spacing,
            strain_window=strain_window,
            strain_measure=strain_measure,
            pixel_size=pixel_size,
            mask=None if mask is None else mask_of(mask, read_grey(files[0]).shape),
            overwrite=overwrite,
            progress=tell,
        )
        progress.stage("writing the report")
        with open_experiment(series.dataset) as dataset:
            words = list(series_sentences(series, dataset))
        report = write_report(target, page, gauges=gauges, regions=regions, overwrite=overwrite)
    say(*failure_sentences(series), *words)
    say(f"dataset: {target}", f"report: {report}", f"pictures of all images: fringedic export {target} --to png")
    if series.interrupted:
        say(f"interrupted: {len(series.images)} of {len(files)} images are saved; --overwrite measures all of them")
        raise typer.Exit(130)
    if series.failed:
        raise StepFailedError(f"{len(series.failed)} of {len(files)} images were not measured, see above")


def _recorded_images(places: list[Path], topic: str, output: Path) -> list[Path]:
    """Write the images on a topic of a recording as files into the output folder."""
    from fringedic.images.recorded import save_images

    if len(places) > 1:
        raise ConfigurationError(f"--bag {topic}: give one recording, not {len(places)} files")
    files = save_images(places[0], topic, output / RECORDED_IMAGES)
    say(f"images: {len(files)} of {topic} in {output / RECORDED_IMAGES}")
    return files


@app.command(rich_help_panel=IMAGES, epilog="Example: fringedic phase images --description fringes.yaml")
def phase(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of the fringe images.")],
    description: Annotated[
        Path | None, typer.Option(help="What the images show; phase.yaml in the folder if left out.")
    ] = None,
    output: Annotated[Path, typer.Option(help="Folder for dataset and picture.")] = Path("measured"),
    overwrite: Overwrite = False,
) -> None:
    """Measure the phase from fringe images of any program; write dataset and picture."""
    begin(folder)
    target, picture = (output_file(output / name, overwrite) for name in (PHASE, PHASE_PICTURE))
    from fringedic.configuration.fringe_images import FringeImageDescription
    from fringedic.datasets.stores import save_netcdf
    from fringedic.figures.phase_images import save_phase_picture
    from fringedic.images import measure_phase_images
    from fringedic.images.sentences import phase_sentences

    with kept_if_filled(output):
        measured = measure_phase_images(folder, FringeImageDescription.load(description or folder / "phase.yaml"))
        save_netcdf(measured, target)
        save_phase_picture(measured, picture)
    say(*phase_sentences(measured), f"dataset: {target}", f"picture: {picture}")


@app.command(
    rich_help_panel=IMAGES,
    epilog="Example: fringedic advise reference.tif static-1.tif static-2.tif --wanted-noise-px 0.005",
)
def advise(
    reference: Annotated[
        Path, typer.Argument(metavar="REFERENCE", help="Image of the mounted specimen before the test.")
    ],
    static_1: Annotated[Path, typer.Argument(metavar="STATIC_1", help="A second image at rest.")],
    static_2: Annotated[Path, typer.Argument(metavar="STATIC_2", help="A third image at rest.")],
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
    begin(reference)
    from fringedic.command.advice import advise_on_images
    from fringedic.rig_setup.settings_sentences import settings_report

    advice = advise_on_images(
        (reference, static_1, static_2),
        wanted_noise=wanted_noise_px,
        wanted_period=wanted_period_px,
        pixel_size=None if pixel_size_mm is None else 1e-3 * pixel_size_mm,
        strain_window=strain_window_points,
    )
    console.print(settings_report(advice), markup=False, highlight=False, soft_wrap=True)
