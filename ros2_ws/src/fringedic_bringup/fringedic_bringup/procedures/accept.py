"""Artefacts of an acceptance test, measured by the nodes of a rig."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from fringedic.calibration.acceptance import Place
from fringedic.calibration.acceptance_sentences import place_in_words
from fringedic.calibration.recorded_phases import recorded_phases
from fringedic.command.acceptance import Shape
from fringedic.command.outcome import Progress
from fringedic.configuration.rig_file import RigFile
from fringedic.errors import StepFailedError
from fringedic.rig.model import RigModel
from fringedic_bringup.procedures.calibrate import calibration_client, placing_by
from fringedic_ros.stamps import to_nanoseconds


def shapes_by_nodes(
    rig: RigFile,
    folder: Path,
    progress: Progress,
    *,
    model: RigModel,
    places: list[Place],
    ask: Callable[[str], bool],
    domain: int | None = None,
) -> Iterator[Shape]:
    """Yield the surfaces that the nodes of a rig measure of artefacts that an operator places.

    The arguments are those of `fringedic.command.acceptance.accept`.
    """
    rig = rig.model_copy(update={"recording": rig.recording.model_copy(update={"derived": True})})
    stamps = []
    with calibration_client(rig, folder, progress, place=placing_by(ask), domain=domain) as client:
        for number, place in enumerate(places, start=1):
            words = place_in_words(place)
            progress.part(number, len(places), words)
            if not ask(f"Place {number} of {len(places)}: {words}"):
                raise StepFailedError(f"the operator stopped at place {number} of {len(places)}; nothing was judged")
            stamps.append(to_nanoseconds(client.measure().stamp))
        client.wait_until_recorded()
    finest = rig.patterns()[-1]
    for phase in recorded_phases(folder / "bag", stamps):
        yield model.reconstruct(phase.phase, finest.pitch, phase.sigma, finest.orientation)
