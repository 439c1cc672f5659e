"""Subcommands for setting up a rig before a test."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from fringedic.command.app import (
    SET_UP,
    Overwrite,
    Rig,
    RigSensor,
    app,
    begin,
    console,
    output_file,
    parameter_values,
    refuse_unused,
    say,
)
from fringedic.command.folders import unused_folder
from fringedic.command.plugins import rig_procedure
from fringedic.command.progress import LiveProgress
from fringedic.configuration.installed_rigs import rig_path_of
from fringedic.errors import ConfigurationError


class CameraKind(StrEnum):
    """The cameras that a new rig file can name."""

    VIRTUAL = "virtual"
    FILES = "files"
    VIDEO = "video"
    ARAVIS = "aravis"
    V4L2 = "v4l2"
    TOPIC = "topic"


@app.command(rich_help_panel=SET_UP, epilog="Example: fringedic init bench.yaml")
def init(  # noqa: PLR0913 (options of a command)
    camera: Annotated[
        CameraKind,
        typer.Option(
            prompt="1 of 7  Camera: aravis (GigE or USB3 Vision), v4l2 (USB), topic (ROS), files, video or virtual",
            show_choices=False,
            help="Kind.",
        ),
    ],
    image_size: Annotated[str, typer.Option(prompt="2 of 7  Image size in px, such as 1280x960", help="In px.")],
    rig: Annotated[Path, typer.Argument(metavar="RIG", help="Rig file to write.")] = Path("bench.yaml"),
    camera_address: Annotated[
        str,
        typer.Option(
            prompt="3 of 7  Its address, device, topic or files; Enter for the only one", help="Of the camera."
        ),
    ] = "",
    display: Annotated[
        int, typer.Option(prompt="4 of 7  Number of the projector among the displays, from 0", help="Of the projector.")
    ] = 1,
    projector_size: Annotated[
        str, typer.Option(prompt="5 of 7  Resolution of the projector in px", help="Of the projector in px.")
    ] = "1920x1080",
    grid_pitch_mm: Annotated[
        float,
        typer.Option(prompt="6 of 7  Distance of the printed grid's lines in mm", help="Of the grid's lines."),
    ] = 0.5,
    operator: Annotated[str, typer.Option(prompt="7 of 7  Your name, for the reports", help="For the reports.")] = "",
    overwrite: Overwrite = False,
) -> None:
    """Ask seven questions and write a rig file; options answer questions in advance."""
    from fringedic.configuration.new_rig import Answers, write_rig_file

    answers = Answers(camera.value, camera_address, image_size, display, projector_size, grid_pitch_mm, operator)
    write_rig_file(output_file(rig, overwrite), answers)
    say(f"rig file: {rig}; next: fringedic live {rig}, or first fringedic plan {rig} with the data of your components")


@app.command(
    rich_help_panel=SET_UP, epilog="Example: fringedic plan planned --set plan.angle_degree=35 --output plan.html"
)
def plan(
    rig: Rig,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="SECTION.KEY=VALUE", help="Replaces a value of the rig file; may be repeated."),
    ] = None,
    output: Annotated[Path, typer.Option(help="Page to write.")] = Path("plan.html"),
    overwrite: Overwrite = False,
) -> None:
    """Predict the uncertainties of a rig from the data of its components, before anything is bought."""
    page = output_file(output, overwrite)
    from fringedic.configuration.changes import load_changed_rig_file
    from fringedic.planning import PlannedRig, make_plan
    from fringedic.planning.sentences import plan_text
    from fringedic.report.plan import write_plan_page

    path = rig_path_of(rig)
    found = make_plan(PlannedRig.of(load_changed_rig_file(path, parameter_values(settings)), str(path)))
    say(plan_text(found))
    page.parent.mkdir(parents=True, exist_ok=True)
    say(f"page: {write_plan_page(found, page, rig=path.stem)}")


@app.command(rich_help_panel=SET_UP, epilog="Example: fringedic noise plate.yaml --output noise")
def noise(
    context: typer.Context,
    rig: Annotated[
        Path | None, typer.Argument(metavar="RIG", help="Rig file; the specimen is mounted and at rest.")
    ] = None,
    images: Annotated[
        list[Path] | None, typer.Option("--images", help="An image at rest, instead of a rig; give at least three.")
    ] = None,
    steps: Annotated[
        int, typer.Option(min=3, max=1000, help="With a rig: number of steps at rest, with the reference.")
    ] = 10,
    window: Annotated[
        int, typer.Option(min=8, max=256, help="With --images: width of the correlation window [px].")
    ] = 32,
    spacing: Annotated[
        int, typer.Option(min=1, max=256, help="With --images: distance of the measured points [px].")
    ] = 4,
    sensor: RigSensor = None,
    output: Annotated[Path, typer.Option(help="Folder for noise_floor.yaml, its picture and the recording.")] = Path(
        "noise"
    ),
) -> None:
    """Measure the noise floor of camera, displacement, height and strain with the specimen at rest."""
    if (rig is None) == (not images):
        raise ConfigurationError("give a rig file, or with --images at least three images at rest")
    if images:
        refuse_unused(context, {"steps"}, "with --images every image is a step; leave it out")
        refuse_unused(context, {"sensor"}, "with --images there is no rig; leave it out")
    else:
        refuse_unused(context, {"window", "spacing"}, "with a rig file they are nodes.dic in this file; set them there")
    begin(rig or (images or [])[0])
    from fringedic.rig_setup.settings_sentences import noise_floor_text

    folder = unused_folder(output)
    if images:
        from fringedic.command.noise_of_images import measure_noise_of_images

        measured = measure_noise_of_images(images, folder, window=window, spacing=spacing)
    else:
        from fringedic.configuration.rig_file import load_rig_file

        assert rig is not None, "checked above"
        measure_noise = rig_procedure("noise")
        path = rig_path_of(rig)
        with LiveProgress(console) as progress:
            measured = measure_noise(load_rig_file(path, sensor=sensor), path, folder, progress, steps=steps)
    console.print(noise_floor_text(measured.metadata), markup=False, highlight=False, soft_wrap=True)
    file = folder / "noise_floor.yaml"
    say(f"noise floor: {file}; to use it, write its path into the rig file as noise_floor_file")


@app.command(rich_help_panel=SET_UP, epilog="Example: fringedic region plate.yaml --output region.png")
def region(
    source: Annotated[
        Path,
        typer.Argument(metavar="IMAGE|RIG", help="Image file, or rig file to take one frame.", callback=begin),
    ],
    output: Annotated[Path, typer.Option(help="Mask image; the polygons are written beside it as .yaml.")] = Path(
        "region.png"
    ),
    sensor: RigSensor = None,
    overwrite: Overwrite = False,
) -> None:
    """Draw the region of interest in a window; write a mask for fringedic measure and polygons for the rig file."""
    from fringedic.command.region_window import draw_region
    from fringedic.frames.files import IMAGE_SUFFIXES, read_grey

    if output.suffix.lower() not in IMAGE_SUFFIXES:
        raise ConfigurationError(f"--output {output}: is no name of an image; take a name that ends in .png")
    for file in (output, output.with_suffix(".yaml")):
        if file.resolve() == source.resolve():
            raise ConfigurationError(f"--output {output}: would replace {source}; choose another --output")
        output_file(file, overwrite)
    is_rig = source.suffix in ("", ".yaml", ".yml")  # installed rig files are named without suffix
    if sensor is not None and not is_rig:
        raise ConfigurationError("--sensor: an image is of one sensor; leave it out")
    drawn = draw_region(
        rig_procedure("frame")(rig_path_of(source), sensor=sensor).image if is_rig else read_grey(source)
    )
    if drawn is None:
        say("no region was drawn")
        raise typer.Exit(1)
    picture, corners = drawn.save(output)
    share = 100 * drawn.share()
    say(
        f"mask: {picture}, {share:.0f} % of the image",
        f"polygons: {corners}; to use them, write their path into the rig file as region_file",
    )
