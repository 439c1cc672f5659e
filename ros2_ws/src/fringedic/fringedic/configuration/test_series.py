"""A series of tests: several specimens with the same programme and answers, beside the rig file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import yaml
from pydantic import Field, model_validator

from fringedic.configuration.test_form import Answers
from fringedic.configuration.yaml_section import Section, load_sections
from fringedic.recording.manifest import write_whole

MOST_SPECIMENS = 200


class Series(Section):
    """Names of specimens, and what is common to their tests."""

    specimens: list[Annotated[str, Field(min_length=1, max_length=100)]] = Field(
        [], max_length=MOST_SPECIMENS, description="Names of the specimens, in the order of their tests."
    )
    answers: Answers = Field({}, description="Answers of the form of the test that are common to all.")
    text: str = Field("", description="The programme (YAML); empty for that of the rig file.")
    planned: float = Field(0.0, description="When it was planned [s since 1970]; entered by the program.")

    @model_validator(mode="after")
    def _specimens_differ(self) -> Series:
        twice = next((name for name in self.specimens if self.specimens.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f"the specimen {twice} is named twice: remove one")
        return self

    def save(self, file: Path) -> None:
        """Write the series."""
        write_whole(file, yaml.safe_dump(self.model_dump(), sort_keys=False, allow_unicode=True))


def series_file(rig_file: Path) -> Path:
    """Return the file of the series of a rig, beside its rig file."""
    return rig_file.with_name(f"{rig_file.stem}_series.yaml")


def load_series(file: Path) -> Series:
    """Return the series in a file; an empty one without it.

    Raises
    ------
    ConfigurationError
        The file is damaged.
    """
    return load_sections(file, Series) if file.is_file() else Series()
