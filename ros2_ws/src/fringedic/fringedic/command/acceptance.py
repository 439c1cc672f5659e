"""Acceptance test of a rig: artefacts at the places of the guideline, by an operator or before the virtual rig."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol, TypeAlias

import xarray as xr

from fringedic.calibration.acceptance import Acceptance, Artefacts, Place, measure_place
from fringedic.calibration.acceptance_sentences import place_in_words
from fringedic.command.outcome import Progress
from fringedic.configuration.calibration_in_use import calibration_to_check
from fringedic.configuration.rig_file import RigFile
from fringedic.errors import CalibrationError, ConfigurationError
from fringedic.report.acceptance import ACCEPTANCE_PAGE, write_acceptance_page
from fringedic.rig.model import RigModel

Shape: TypeAlias = xr.Dataset  # the surface of an artefact, as of `RigModel.reconstruct`


class MeasureShapes(Protocol):
    """Yields the surfaces of artefacts that an operator places before a rig."""

    def __call__(
        self,
        rig: RigFile,
        folder: Path,
        progress: Progress,
        *,
        model: RigModel,
        places: list[Place],
        ask: Callable[[str], bool],
        domain: int | None,
    ) -> Iterator[Shape]:
        """Take the arguments of `accept`, the calibration and the places."""


def accept(
    rig: RigFile,
    rig_path: Path,
    folder: Path,
    progress: Progress,
    *,
    measure: Callable[[], MeasureShapes],
    ask: Callable[[str], bool],
    domain: int | None = None,
) -> Acceptance:
    """Measure balls, ball bar and plane at all places and write the page of the test.

    Parameters
    ----------
    rig, rig_path
        The rig file, with the section ``acceptance``, and its path.
    folder
        Where the page, and of a real rig the recording, are written.
    progress
        Receives the progress.
    measure
        Returns the function that measures artefacts with the nodes of a rig; not called for a virtual rig.
    ask
        Asks an operator to place an artefact; returns False when the operator stops. Not used for a virtual rig.
    domain
        ROS_DOMAIN_ID; None takes the one of the environment.

    Raises
    ------
    ConfigurationError
        The rig file has no section ``acceptance``, no projector, or no calibration that fits it.
    CalibrationError
        An artefact was not found at its place.
    StepFailedError
        The operator stopped.
    """
    model = calibration_to_check(rig, rig_path)
    if rig.acceptance is None:
        raise ConfigurationError(
            f"{rig_path}: has no section acceptance; it states ball_diameter_mm, bar_spacing_mm, volume_mm and the "
            "maximum permissible errors"
        )
    artefacts = rig.acceptance.artefacts
    places = artefacts.places()
    if rig.virtual_rig is not None:
        shapes = _virtual_shapes(rig, model, places, artefacts, progress)
    else:
        shapes = measure()(rig, folder, progress, model=model, places=places, ask=ask, domain=domain)
    results = []
    for number, (place, shape) in enumerate(zip(places, shapes, strict=True), start=1):
        try:
            results.append(measure_place(place, shape, artefacts))
        except CalibrationError as error:
            raise CalibrationError(f"place {number}, {place_in_words(place)}: {error}") from error
    result = Acceptance(artefacts, rig.acceptance.limits, tuple(results))
    folder.mkdir(parents=True, exist_ok=True)
    write_acceptance_page(result, folder / ACCEPTANCE_PAGE, rig=model.identifier, created=datetime.now(UTC))
    return result


def _virtual_shapes(
    rig: RigFile, model: RigModel, places: list[Place], artefacts: Artefacts, progress: Progress
) -> Iterator[Shape]:
    """Yield the surfaces of the artefacts before a virtual rig, rendered without nodes."""
    from fringedic.calibration.virtual_artefacts import measure_virtual_artefact

    virtual, patterns = rig.virtual_configuration(), rig.patterns()
    for number, place in enumerate(places, start=1):
        progress.part(number, len(places), place_in_words(place))
        yield measure_virtual_artefact(virtual, patterns, model, place, artefacts)
