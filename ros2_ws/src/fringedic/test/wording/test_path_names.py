"""Names of files and folders: nothing leaves its folder, and no two are the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from fringedic.wording import path_name, recording_names

TEXTS = ["", ".", "..", "...", "/", "a/b", "../../etc", "/absolute", "a\\b", "a\0b", "a\nb", " ", ".hidden", "~0", "*"]
PLACES = {
    "recordings/plate-7/bag": "plate-7",
    "recordings/bag_replayed": "bag_replayed",
    "recordings/plate.7": "plate.7",
    "recordings/plate.7/plate_0.mcap": "plate_0",
    "s3://laboratory/recordings/plate-7/bag": "plate-7",
    "recordings/..": Path.cwd().name,
}


@pytest.mark.parametrize("text", [*TEXTS, "é" * 300])
def test_any_text_becomes_one_visible_part_of_a_path(tmp_path: Path, text: str) -> None:
    folder = tmp_path / path_name(text)
    folder.mkdir()
    assert folder.resolve().parent == tmp_path
    assert not folder.name.startswith(".")
    assert "~" not in folder.name  # parts of a recording are numbered with it
    (tmp_path / f"{path_name(text)}-2026-11-28T18-19-52_displacement_x.nc").touch()


def test_long_names_that_begin_alike_stay_apart() -> None:
    assert path_name("a" * 300) != path_name("a" * 301)


@pytest.mark.parametrize(("place", "name"), PLACES.items())
def test_a_recording_has_the_name_of_its_run(place: str, name: str) -> None:
    assert recording_names([place]) == {place: name}


def test_a_recording_above_the_present_folder_has_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "plate-7" / "batch").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "plate-7" / "batch")
    assert recording_names(["../bag"]) == {"../bag": "plate-7"}


def test_names_that_become_the_same_stay_apart() -> None:
    places = ["/a/plate 7", "/a/plate-7", "/a/plate  7", "/b/x"]
    names = recording_names(places)
    assert len(set(names.values())) == len(places)
    assert names["/b/x"] == "x"
    assert names == recording_names(reversed(places))
