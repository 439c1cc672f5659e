"""The form of a test: its answers become the metadata of the specimen, or are refused with one sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from fringedic.configuration.programme import Programme
from fringedic.configuration.rig_file import RigFile, load_rig_file
from fringedic.configuration.test_card import Card, load_card
from fringedic.configuration.test_form import DEFAULT_FORM, FormField, answered_specimen
from fringedic.configuration.test_series import Series, load_series, series_file
from fringedic.errors import ConfigurationError
from fringedic.metadata import SpecimenMetadata
from fringedic.report.laboratory import Laboratory

RIG: dict[str, Any] = {"camera": {"source": "virtual"}, "virtual_rig": {"preset": "plate", "size": "tiny"}}
FORM = [
    FormField(name="specimen", entry="name", required=True),
    FormField(name="section [mm²]", entry="section_mm2", kind="number", minimum=0.1),
    FormField(name="width [mm]", kind="number", minimum=0, maximum=500),
    FormField(name="direction", choices=["L", "T"]),
]


def test_answers_become_entries_of_the_specimen() -> None:
    before = SpecimenMetadata(name="of the rig file", operator="Weber", entries={"width [mm]": 10.0, "kept": "yes"})
    answers: dict[str, str | float] = {"specimen": " plate 7 ", "section [mm²]": 50, "width [mm]": "", "direction": "T"}
    found = answered_specimen(FORM, before, answers)
    assert (found.name, found.section_mm2, found.operator) == ("plate 7", 50.0, "Weber")
    assert found.entries == {"kept": "yes", "direction": "T"}, "an empty answer removes that of the rig file"


def test_the_form_asks_for_what_the_certificate_shows_of_a_specimen() -> None:
    shown = set(Laboratory().details.values()) & SpecimenMetadata.model_fields.keys()
    assert {"customer", "test_number", "number"} <= shown <= {field.entry for field in DEFAULT_FORM}


@pytest.mark.parametrize(
    ("answers", "problem"),
    [
        ({}, "specimen: is missing; a test of this rig needs it"),
        ({"specimen": ""}, "specimen: is missing"),
        ({"specimen": "7", "width [mm]": "wide"}, "width .mm.: 'wide' is no number"),
        ({"specimen": "7", "width [mm]": 501}, "width .mm.: 501 is above 500"),
        ({"specimen": "7", "direction": "X"}, "direction: X is none of L, T"),
        ({"specimen": "7", "colour": "red"}, "the form of a test has no field 'colour'; its fields are specimen, "),
    ],
)
def test_a_wrong_answer_is_refused(answers: dict[str, str | float], problem: str) -> None:
    with pytest.raises(ConfigurationError, match=problem):
        answered_specimen(FORM, SpecimenMetadata(), answers)


@pytest.mark.parametrize(
    ("form", "problem"),
    [
        ([{"name": "a"}, {"name": "a"}], "two fields have the name a"),
        ([{"name": "a", "entry": "notes"}, {"name": "b", "entry": "notes"}], "two fields have the entry notes"),
        ([{"name": "a", "entry": "section_mm2"}], "section_mm2 is of kind: number"),
        ([{"name": "a", "entry": "gauges_px"}], "specimen has no text or number gauges_px; use name, "),
        ([{"name": "a", "minimum": 1.0}], "minimum and maximum belong to kind: number"),
    ],
)
def test_a_form_that_has_two_meanings_is_refused(form: list[dict[str, Any]], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        RigFile.model_validate({**RIG, "test_form": form})


def test_the_form_is_that_of_the_rig_file(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump({**RIG, "test_form": [{"name": "batch", "required": True}]}))
    rig = load_rig_file(tmp_path / "rig.yaml")
    assert answered_specimen(rig.test_form, rig.specimen, {"batch": "B3"}).entries == {"batch": "B3"}


def test_card_and_series_are_read_as_they_were_written(tmp_path: Path) -> None:
    programme = Programme.model_validate({"steps": [{}, {"cycle": {"times": 2, "steps": [{"position_mm": 1.0}]}}]})
    card = Card(rig_file="rig.yaml", answers={"specimen": "plate 7", "width [mm]": 25.0}, programme=programme)
    card.save(tmp_path / "test")
    assert load_card(tmp_path / "test") == card
    assert load_card(tmp_path) is None
    series = Series(specimens=["a", "b"], answers={"width [mm]": 25.0}, text="{steps: [{}]}")
    series.save(series_file(tmp_path / "rig.yaml"))
    assert load_series(tmp_path / "rig_series.yaml") == series
    with pytest.raises(ValueError, match="the specimen a is named twice"):
        Series(specimens=["a", "a"])
