"""Recordings and datasets in an object store, here that of fsspec in memory: the results are those of the desk."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import fsspec
import pytest

import fringedic
from fringedic.errors import RecordingError
from fringedic.recording import info
from fringedic.recording.remote import RemoteRecording

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"
ADDRESS = "memory://laboratory/plate-1"


@pytest.fixture
def remote() -> Iterator[fsspec.AbstractFileSystem]:
    files = fsspec.filesystem("memory")
    files.put(str(RECORDED), "/laboratory/plate-1/bag", recursive=True)
    yield files
    files.rm("/laboratory", recursive=True)


def test_a_remote_recording_is_processed_into_the_working_folder(
    remote: fsspec.AbstractFileSystem, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file = fringedic.process_bag(f"{ADDRESS}/bag", overrides={"dic.spacing": 8})
    assert file == Path("plate-1.nc")
    here = fringedic.process_bag(RECORDED, output=tmp_path / "desk.nc", overrides={"dic.spacing": 8})
    remote.put(str(here), "/laboratory/plate-1/results.nc")
    with fringedic.open_experiment(file) as found, fringedic.open_experiment(here) as desk:
        assert found.identical(desk)
        for place in (ADDRESS, f"{ADDRESS}/bag", f"{ADDRESS}/results.nc"):
            with fringedic.open_experiment(place) as opened:
                assert opened.identical(desk)


def test_the_content_of_a_remote_recording_is_that_of_its_index(
    remote: fsspec.AbstractFileSystem, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = f"{ADDRESS}/bag"
    fetched = [len(file.tail) for file in RemoteRecording(place).files]
    monkeypatch.setattr(type(remote), "cat_ranges", None)  # the chunks are fetched by it
    assert info(place) == replace(info(RECORDED), path=place)
    assert sum(fetched) <= 1_000_000


def test_other_recordings_below_an_address_are_left_alone(remote: fsspec.AbstractFileSystem) -> None:
    """Files of one name replaced each other in the copy, so that a dataset could contain two specimens."""
    expected = info(f"{ADDRESS}/bag")
    for beside in ("parts/bag-1", "bag_recovered"):
        remote.put(str(RECORDED), f"/laboratory/plate-1/{beside}", recursive=True)
    assert info(ADDRESS) == replace(expected, path=ADDRESS)
    with pytest.raises(RecordingError, match="memory://laboratory: holds several recordings; give the folder of one"):
        info("memory://laboratory")


@pytest.mark.usefixtures("remote")
def test_what_is_not_there_is_named() -> None:
    with pytest.raises(RecordingError, match=f"{ADDRESS}: has no dataset; 'fringedic process {ADDRESS}' measures it"):
        fringedic.open_experiment(ADDRESS)
    for call in (fringedic.process_bag, info):
        with pytest.raises(RecordingError, match=r"memory://laboratory/none: holds no .mcap file"):
            call("memory://laboratory/none")  # type: ignore[operator]
    with pytest.raises(RecordingError, match=r"nowhere://plate/results.nc: is no known kind of address"):
        fringedic.open_experiment("nowhere://plate")
