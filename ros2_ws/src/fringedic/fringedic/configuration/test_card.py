"""The card of a test: what was entered before it and what it was going to do, beside its recording."""

from __future__ import annotations

from pathlib import Path

import yaml
from pydantic import Field

from fringedic.configuration.programme import Programme
from fringedic.configuration.test_form import Answers
from fringedic.configuration.yaml_section import Section, load_sections
from fringedic.recording.manifest import write_whole

CARD = "test.yaml"
"""Name of the file in the folder of a test."""


class Card(Section):
    """What was entered before a test, and its programme."""

    rig_file: str = Field("", description="Name of the rig file.")
    answers: Answers = Field({}, description="Answers of the form of the test, by the names of its fields.")
    programme: Programme | None = Field(None, description="The load steps; none of a test by hand.")

    def save(self, folder: Path) -> None:
        """Write the card into the folder of a test, which is created when it does not exist."""
        folder.mkdir(parents=True, exist_ok=True)
        content = self.model_dump(mode="json", exclude_unset=True)
        write_whole(folder / CARD, yaml.safe_dump(content, sort_keys=False, allow_unicode=True))


def load_card(folder: Path) -> Card | None:
    """Return the card in the folder of a test; None without one.

    Raises
    ------
    ConfigurationError
        The file is damaged.
    """
    return load_sections(folder / CARD, Card) if (folder / CARD).is_file() else None
