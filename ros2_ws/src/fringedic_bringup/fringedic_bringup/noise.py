"""The noise floor of a rig with its specimen mounted: steps at rest through the nodes, or images from files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fringedic.errors import FringedicError, NoiseFloorError
from fringedic.facts import NOISE_COLUMNS, NoiseFacts
from fringedic.noise_floor import FEWEST, NoiseMeasurement, noise_of_images, noise_of_recording
from fringedic.programme import Programme
from fringedic.rig_file import RigFile
from fringedic_bringup.report import Progress


def measure_noise(
    rig: RigFile,
    rig_path: Path,
    folder: Path,
    progress: Progress,
    *,
    steps: int,
    domain: int | None = None,
) -> NoiseMeasurement:
    """Measure steps at rest and take the noise floor from them; the machine is not moved.

    Parameters
    ----------
    rig, rig_path
        The rig file and where it was read.
    folder
        Gets the recording ``bag``, its dataset, ``noise_floor.yaml`` and ``noise_floor.png``.
    progress
        Told what goes on.
    steps
        How many, with the reference.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    NoiseFloorError
        Too few steps were asked for or measured.
    NodeDiedError, NotAnsweredError, StepFailedError
        The nodes did not start, or one of them ended.
    """
    # not at the top: images need no ROS
    from fringedic_bringup.driving import drive
    from fringedic_bringup.graph import rig_graph
    from fringedic_bringup.processes import RunningGraph

    if steps < FEWEST:
        raise NoiseFloorError(f"{steps} steps: a noise floor needs at least {FEWEST}")
    mode = "white" if rig.projector is None else "fringes"
    programme = Programme.model_validate({"experiment": "noise_floor", "steps": [{"mode": mode}] * steps})
    rig = rig.model_copy(update={"recording": rig.recording.model_copy(update={"derived": True})})
    graph = rig_graph(rig, rig_path, folder, experiment=programme.experiment)
    progress.stage(f"starting {len(graph.nodes)} nodes")
    with RunningGraph(graph, folder / "logs", domain=domain) as running:
        drive(running, programme, progress, domain=domain)
        progress.stage("closing the recording")
    progress.stage("measuring the noise")
    measured = noise_of_recording(folder / "bag")
    measured.save(folder)
    return measured


def measure_noise_of_images(images: Sequence[Path], folder: Path, *, window: int, spacing: int) -> NoiseMeasurement:
    """Take the noise floor of camera, displacement and strain from image files; parameters as of `noise_of_images`.

    Raises
    ------
    CameraError
        An image cannot be read.
    NoiseFloorError
        There are fewer than three.
    """
    from camera_node.drivers.files import read_grey

    try:
        measured = noise_of_images([read_grey(path) for path in images], window=window, spacing=spacing)
    except NoiseFloorError:
        raise
    except FringedicError as error:
        raise type(error)(f"{images[0]} and those after it: {error}") from error
    measured.save(folder)
    return measured


def noise_in_words(facts: NoiseFacts) -> str:
    """Return the noise floor as lines for people."""
    flicker = f"the light flickers by {facts.flicker_percent:g} %"
    lines = [
        f"noise floor of {facts.steps} steps at rest",
        f"  camera: {facts.read_noise_grey_level:g} grey levels without light, and a variance of "
        f"{facts.shot_noise_grey_level:g} per grey level of brightness; {flicker}",
        f"  {'':34s}" + "".join(f"{title:>13s}" for title in NOISE_COLUMNS),
    ]
    for quantity, cells in facts.table():
        lines.append(f"  {f'{quantity.title} [{quantity.unit}]':34s}" + "".join(f"{cell:>13s}" for cell in cells))
    widths = {"window": facts.window_px, "spacing": facts.spacing_px, "strain window": facts.strain_window_px}
    lines.append("  with " + ", ".join(f"{name} {width} px" for name, width in widths.items() if width))
    return "\n".join(lines)
