"""The form of a test: what a laboratory asks before each test, and the metadata that its answers become."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

from pydantic import Field, model_validator

from fringedic.configuration.yaml_section import Section, validate
from fringedic.errors import ConfigurationError
from fringedic.metadata import SpecimenMetadata
from fringedic.wording.translation import translatable

Answers = dict[str, str | float]
"""Answers by the names of their fields."""
MOST_FIELDS = 40
_LONGEST = 1000  # characters of an answer
_ENTRIES = {name: "text" for name, field in SpecimenMetadata.model_fields.items() if field.annotation is str}
_ENTRIES |= {"section_mm2": "number"}  # entries of the metadata that a field can be, and their kinds


class FormField(Section):
    """One field of the form."""

    name: str = Field(
        min_length=1, max_length=60, description="Name on the page and in reports, with its unit, such as 'width [mm]'."
    )
    entry: str | None = Field(
        None,
        description="Key of `specimen` that the answer replaces, such as name, material, section_mm2 or operator; "
        "without one it is one of `specimen.entries`.",
    )
    kind: Literal["text", "number"] = Field("text", description="What is entered.")
    choices: list[str] | None = Field(None, min_length=1, description="The possible answers of a text.")
    minimum: float | None = Field(None, description="Smallest number.")
    maximum: float | None = Field(None, description="Largest number.")
    required: bool = Field(False, description="Whether a test cannot begin without an answer.")

    @model_validator(mode="after")
    def _fits_its_kind(self) -> FormField:
        if self.kind == "number" and self.choices:
            raise ValueError(f"{self.name}: choices are texts; leave out kind: number")
        if self.kind == "text" and (self.minimum, self.maximum) != (None, None):
            raise ValueError(f"{self.name}: minimum and maximum belong to kind: number")
        if self.entry is not None and self.entry not in _ENTRIES:
            raise ValueError(f"{self.name}: specimen has no text or number {self.entry}; use {', '.join(_ENTRIES)}")
        if self.entry is not None and self.kind != _ENTRIES[self.entry]:
            raise ValueError(f"{self.name}: the entry {self.entry} is of kind: {_ENTRIES[self.entry]}")
        return self

    def answer(self, value: str | float) -> str | float:
        """Return a valid answer.

        Raises
        ------
        ConfigurationError
            It is of the other kind, too long, outside the range, or none of the choices.
        """
        if self.kind == "number":
            return self._number(value)
        text = str(value).strip()
        if len(text) > _LONGEST:
            raise ConfigurationError(f"{self.name}: has {len(text)} characters, at most {_LONGEST} are allowed")
        if self.choices and text not in self.choices:
            raise ConfigurationError(f"{self.name}: {text[:60]} is none of {', '.join(self.choices)}")
        return text

    def _number(self, value: str | float) -> float:
        if isinstance(value, str):
            raise ConfigurationError(f"{self.name}: '{value[:60]}' is no number")
        if self.minimum is not None and value < self.minimum:
            raise ConfigurationError(f"{self.name}: {value:g} is below {self.minimum:g}")
        if self.maximum is not None and value > self.maximum:
            raise ConfigurationError(f"{self.name}: {value:g} is above {self.maximum:g}")
        return float(value)


SPECIMEN = translatable("specimen")
DEFAULT_FORM = (
    FormField(name=SPECIMEN, entry="name"),
    FormField(name=translatable("specimen number"), entry="number"),
    FormField(name=translatable("material"), entry="material"),
    FormField(name=translatable("width [mm]"), kind="number", minimum=0),
    FormField(name=translatable("thickness [mm]"), kind="number", minimum=0),
    FormField(name=translatable("section [mm²]"), entry="section_mm2", kind="number", minimum=0),
    FormField(name=translatable("direction")),
    FormField(name=translatable("operator"), entry="operator"),
    FormField(name=translatable("standard")),
    FormField(name=translatable("test number"), entry="test_number"),
    FormField(name=translatable("customer"), entry="customer"),
    FormField(name=translatable("notes"), entry="notes"),
)


def check_form(form: Sequence[FormField]) -> None:
    """Check that no two fields of a form mean the same.

    Raises
    ------
    ValueError
        Two fields have the same name or entry.
    """
    for what in ("name", "entry"):
        named = [getattr(field, what) for field in form if getattr(field, what) is not None]
        twice = next((each for each in named if named.count(each) > 1), None)
        if twice is not None:
            raise ValueError(f"two fields have the {what} {twice}: remove one")


def specimen_field(form: Sequence[FormField]) -> str:
    """Return the name of the field that contains the specimen's name: the tests of a series differ in it.

    Examples
    --------
    >>> specimen_field([FormField(name="Probe", entry="name")]), specimen_field(DEFAULT_FORM)
    ('Probe', 'specimen')
    """
    return next((field.name for field in form if field.entry == "name"), SPECIMEN)


def answers_of(form: Sequence[FormField], specimen: SpecimenMetadata) -> Answers:
    """Return the answers that a specimen's metadata are, by the names of the fields; only those that are known.

    Examples
    --------
    >>> answers_of(DEFAULT_FORM, SpecimenMetadata(name=translatable("plate 7"), entries={"width [mm]": 25.0}))
    {'specimen': 'plate 7', 'width [mm]': 25.0}
    """
    values = {
        field.name: getattr(specimen, field.entry) if field.entry else specimen.entries.get(field.name, "")
        for field in form
    }
    return {name: value for name, value in values.items() if value not in ("", None)}


def answered_specimen(
    form: Sequence[FormField], specimen: SpecimenMetadata, answers: Mapping[str, str | float]
) -> SpecimenMetadata:
    """Return the metadata of a specimen with the answers of a form.

    Parameters
    ----------
    form
        The fields.
    specimen
        The metadata of the rig file; answers replace them.
    answers
        By the names of the fields; a field without an answer keeps the entry of the rig file, an empty one removes it.

    Raises
    ------
    ConfigurationError
        There is no such field, an answer is not valid, or a required one is missing.

    Examples
    --------
    >>> answers = {"specimen": "7", "width [mm]": 25}
    >>> answered = answered_specimen(DEFAULT_FORM, SpecimenMetadata(material="PMMA"), answers)
    >>> answered.name, answered.material, answered.entries
    ('7', 'PMMA', {'width [mm]': 25.0})
    """
    fields = {field.name: field for field in form}
    unknown = next((name for name in answers if name not in fields), None)
    if unknown is not None:
        raise ConfigurationError(
            f"the form of a test has no field '{unknown[:60]}'; its fields are {', '.join(fields)}"
        )
    given = {name: "" if value == "" else fields[name].answer(value) for name, value in answers.items()}
    known = {name: value for name, value in {**answers_of(form, specimen), **given}.items() if value != ""}
    missing = next((field.name for field in form if field.required and field.name not in known), None)
    if missing is not None:
        raise ConfigurationError(f"{missing}: is missing; a test of this rig needs it")
    entries: dict[str, str | float] = {
        **specimen.entries,
        **{name: given[name] for name in given if not fields[name].entry},
    }
    changes: dict[str, Any] = {"entries": {name: value for name, value in entries.items() if value != ""}}
    for name, value in given.items():
        if (entry := fields[name].entry) is not None:
            changes[entry] = SpecimenMetadata.model_fields[entry].default if value == "" else value
    return validate(SpecimenMetadata, {**specimen.model_dump(), **changes}, "test")
