"""What a person writes: ``campaign.yaml`` names recordings, their labels, the settings and the store."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import Field, model_validator

from fringedic.configuration.yaml_section import Section, load_sections
from fringedic.errors import CalibrationError, CampaignError
from fringedic.frames.sensor import SensorName
from fringedic.settings.base import FilePath

if TYPE_CHECKING:
    from fringedic.frames.region import Region

FILE = "campaign.yaml"
EXAMPLE = """\
# Recordings that are processed with the same settings into one store. Paths count from the folder of this file.
title: plates of batch 7
store: store                        # a folder, or an address such as s3://laboratory/batch-7
recordings:
  - path: recordings/plate-*        # a recording, the folder of a run, a folder with recordings, or a pattern
    material: PMMA                  # labels of the catalogue: specimen, material, group, test
    group: batch 7
    # exclude: [recordings/plate-3]  # left out; an entry can have its own settings and calibration, too
settings:                           # replace the recorded parameters, as --set of fringedic process
  dic.window: 32
# calibration: calibration/calibration.yaml   # replaces the recorded one
# reference: 0                                # step that all others are measured against
# elasticity: {strain: [0.0005, 0.002]}       # range of the regression for modulus and Poisson's ratio
"""


class Labels(Section):
    """Labels of recordings in the catalogue."""

    specimen: str = Field("", description="Name of the specimen; by default as recorded.")
    material: str = Field("", description="Its material; by default as recorded.")
    group: str = Field("", description="Group of specimens that belong together.")
    test: str = Field("", description="Number or name of the test.")


_Settings = dict[str, bool | int | float | str | list[int]]


class RecordingEntry(Labels):
    """Recordings with the same labels and settings."""

    path: str = Field(description="Recording, folder of a run, folder with recordings, or a pattern with * and **.")
    exclude: list[str] = Field([], description="Recordings of the path that are left out, named as in path.")
    settings: _Settings = Field({}, description="Parameters of these recordings, beside those of the campaign.")
    calibration: str | None = Field(None, description="Calibration of these recordings instead of the campaign's.")


_Pair = Annotated[list[float], Field(min_length=2, max_length=2)]


class Elasticity(Section):
    """What the elastic constants of the catalogue are computed from."""

    region_px: list[_Pair] = Field(
        [], description="Two corners of a rectangle, or the corners of a polygon: [column, row]; by default all points."
    )
    strain: _Pair = Field(
        [-1.0, 1.0], description="Smallest and largest axial strain of the regression; by default all steps."
    )
    force_sigma_newton: float = Field(0.0, ge=0, description="Standard uncertainty of a force [N].")
    load: str = Field("force", min_length=1, description="Signal with the force, such as that of an attached file.")

    @model_validator(mode="after")
    def _require_region(self) -> Self:
        if len(self.region_px) == 1:
            raise ValueError("region_px has one corner: give two of a rectangle, or those of a polygon")
        return self

    @property
    def region(self) -> Region | None:
        """The region; None for all points."""
        from fringedic.frames.region import Region  # not at the top: a state needs neither images nor rigs

        if not self.region_px:
            return None
        corners = [(column, row) for column, row in self.region_px]
        return Region.rectangle(*corners) if len(corners) == 2 else Region.polygon(corners)


class CampaignFile(Section):
    """Content of ``campaign.yaml``."""

    title: str = Field("", description="Title of the campaign.")
    store: str = Field("store", description="Folder or address (s3://...) of the results.")
    recordings: list[RecordingEntry] = Field(min_length=1, description="Recordings with their labels.")
    settings: _Settings = Field({}, description="Parameters that replace the recorded ones, such as dic.window.")
    sensor: SensorName | None = Field(None, description="Name of the sensor, if the recordings contain several.")
    registration: FilePath = Field(
        "",
        description="Registration that joins the sensors of recordings that contain several; by default that beside "
        "each recording.",
    )
    calibration: str | None = Field(None, description="File of a calibration that replaces the recorded ones.")
    reference: int | None = Field(None, description="Step that all others are measured against.")
    segments: int = Field(
        1, ge=1, description="Parts of a recording whose steps are processed beside each other; 1 is as the desk does."
    )
    elasticity: Elasticity = Field(
        default_factory=Elasticity, description="Region and range of the elastic constants of the catalogue."
    )


@dataclass(frozen=True)
class Campaign:
    """A campaign as it is written in its file.

    Attributes
    ----------
    folder
        Of the file; relative paths count from it.
    content
        The checked content.
    calibrations
        Texts of the calibrations by their names in the file.
    registration
        Text of the registration of sensors; empty if the file names none.
    """

    folder: Path
    content: CampaignFile
    calibrations: Mapping[str, str]
    registration: str = ""

    @property
    def store(self) -> str:
        """Address of the store."""
        return address(self.content.store, self.folder)

    def processing(self, entry: RecordingEntry) -> dict[str, Any]:
        """Return everything that results depend on beside recordings and software, as JSON values."""
        calibration = entry.calibration or self.content.calibration
        return {
            "overrides": dict(sorted({**self.content.settings, **entry.settings}.items())),
            "reference": self.content.reference,
            "calibration": self.calibrations[calibration] if calibration else "",
            "segments": self.content.segments,
            "elasticity": self.content.elasticity.model_dump(mode="json"),
            **({} if self.content.sensor is None else {"sensor": self.content.sensor}),
        }


def load_campaign(path: Path) -> Campaign:
    """Read and check the file of a campaign.

    Parameters
    ----------
    path
        The file, or its folder.

    Raises
    ------
    ConfigurationError
        The file cannot be read, or an entry is not allowed.
    CampaignError
        The calibration, or the registration, cannot be read.
    """
    from fringedic.rig.model import RigModel
    from fringedic.sensors.files import registration_from_text
    from fringedic.steps.recorded_parameters import RecordedParameters

    file = path / FILE if path.is_dir() else path
    content = load_sections(file, CampaignFile)
    entries: tuple[CampaignFile | RecordingEntry, ...] = (content, *content.recordings)
    for each in entries:
        RecordedParameters(each.settings)
    named = {each.calibration for each in entries if each.calibration}
    calibrations = {
        name: _checked_text(file, "calibration", file.parent / name, RigModel.from_text) for name in sorted(named)
    }
    registration = ""
    if content.registration:
        check = partial(registration_from_text, place=content.registration)
        registration = _checked_text(file, "registration", Path(content.registration), check)
    return Campaign(file.parent, content, calibrations, registration)


def address(store: str, folder: Path) -> str:
    """Return the address of a store: a URL as it is, a path from the folder of the campaign.

    Examples
    --------
    >>> address("s3://laboratory/batch-7", Path("/data"))
    's3://laboratory/batch-7'
    >>> address("store", Path("/data"))
    '/data/store'
    """
    return store if "://" in store else str((folder / store).absolute())


def store_address(place: str | os.PathLike[str]) -> str:
    """Return the address of the store of a campaign that is named by its folder, its file or the store itself."""
    if "://" in str(place):
        return str(place)
    path = Path(place)
    if path.is_file() or (path / FILE).is_file():
        file = path / FILE if path.is_dir() else path
        return address(load_sections(file, CampaignFile).store, file.parent)
    return str(path.absolute())


def _checked_text(file: Path, entry: str, path: Path, check: Callable[[str], object]) -> str:
    """Return the text of a file that a campaign names, once it was read without an error."""
    try:
        text = path.read_text("utf-8")
        check(text)
    except (OSError, ValueError, CalibrationError) as error:
        raise CampaignError(f"{file}: {entry} {path}: {error}") from error
    return text
