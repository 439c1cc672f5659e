"""The list of tests, an earlier test that is opened, and the marks that are kept with it."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import xarray as xr
from served import write_test

from fringedic.camera.distortion import DistortionMap
from fringedic.configuration.programme import Programme
from fringedic.configuration.test_card import Card
from fringedic.datasets.stores import save_netcdf
from fringedic.errors import ConfigurationError, OperatorError
from fringedic.evaluation import region_statistics
from fringedic.evidence.changes import begin_log
from fringedic.evidence.log import read_log
from fringedic.frames.region import Polygon, Region
from fringedic.report.page_server.catalogue import Catalogue, opened_test, small_picture
from fringedic.report.page_server.maps import RecordedMaps, SpooledMaps
from fringedic.report.page_server.marks import MARKS, Asked, KeepMarks, Mark, Marks, load_marks, readings
from fringedic.report.page_server.recorded import RecordedRig
from fringedic.rig.model import RigModel

PLATE_7: dict[str, str | float] = {
    "specimen": "plate 7",
    "operator": "M. Weber",
    "customer": "Smith",
    "width [mm]": 25.0,
}


def listed(catalogue: Catalogue, folder: Path) -> list[dict[str, Any]]:
    """Return the tests when their datasets have been read."""
    end = time.monotonic() + 30
    while time.monotonic() < end:
        tests = [each.shown() for each in catalogue.tests(folder).values()]
        if all(each["verdict"] for each in tests):
            return tests
        time.sleep(0.02)
    raise AssertionError("the datasets have not been read")


def test_tests_are_listed_with_specimen_operator_and_result(tmp_path: Path) -> None:
    write_test(tmp_path, "plate-7", PLATE_7, stretch=1e-3)
    write_test(tmp_path, "plate-8", {"specimen": "plate 8"}, stretch=1e-3, failed=1)
    (tmp_path / "killed" / "bag").mkdir(parents=True)
    found = {each["name"]: each for each in listed(Catalogue(), tmp_path)}
    seven = found["plate-7"]
    assert (seven["specimen"], seven["operator"], seven["answers"]["width [mm]"]) == ("plate 7", "M. Weber", 25.0)
    assert (seven["state"], seven["verdict"]) == ("good", "3 steps measured")
    assert (found["plate-8"]["state"], found["plate-8"]["verdict"]) == ("bad", "1 of 3 steps failed")
    assert (found["killed"]["verdict"], found["killed"]["results"]) == ("no results", False)


def test_specimen_of_a_test_that_was_started_elsewhere_is_that_of_its_dataset(tmp_path: Path) -> None:
    (write_test(tmp_path, "plate-7", PLATE_7, stretch=1e-3) / "test.yaml").unlink()
    [found] = listed(Catalogue(), tmp_path)
    assert (found["specimen"], found["answers"], found["continues"]) == ("plate 7", PLATE_7, False)


def test_a_programme_with_measured_moves_has_no_largest_number_of_steps(tmp_path: Path) -> None:
    folder = write_test(tmp_path, "plate-7", {}, stretch=1e-3)
    steps = [
        {"continuous": {"to_mm": 1.0, "speed_mm_per_s": 0.1}},
        {"ramp": {"to_mm": 0.0, "from_mm": 1.0, "steps": 5}},
    ]
    Card(programme=Programme.model_validate({"steps": steps})).save(folder)
    assert listed(Catalogue(), tmp_path)[0]["verdict"] == "3 steps measured"
    (folder / "results.nc").unlink()
    [found] = listed(Catalogue(), tmp_path)
    assert (found["verdict"], found["continues"]) == ("no results", True)


def test_a_damaged_dataset_does_not_hide_the_others(tmp_path: Path) -> None:
    (write_test(tmp_path, "plate-7", PLATE_7, stretch=1e-3) / "results.nc").write_text("no dataset")
    write_test(tmp_path, "plate-8", {}, stretch=1e-3)
    catalogue = Catalogue()
    end = time.monotonic() + 30
    while time.monotonic() < end and catalogue.tests(tmp_path)["plate-8"].found is None:
        time.sleep(0.02)
    assert {name: each.found is None for name, each in catalogue.tests(tmp_path).items()} == {
        "plate-7": True,
        "plate-8": False,
    }


def test_an_earlier_test_is_opened_and_pictured(tmp_path: Path) -> None:
    write_test(tmp_path, "plate-7", PLATE_7, stretch=1e-3)
    tests = Catalogue().tests(tmp_path)
    rig = opened_test(tests, "plate-7")
    assert opened_test(tests, "plate-7") is rig, "it stays open"
    assert [step["signals"]["force"] for step in rig.snapshot()["steps"]] == [0.0, 100.0, 200.0]
    picture = cv2.imdecode(np.frombuffer(small_picture(rig), np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    assert picture.shape == (12, 20, 4)
    with pytest.raises(OperatorError, match="there is no test plate-9"):
        opened_test(tests, "plate-9")


def test_marks_read_the_values_of_the_dataset(tmp_path: Path) -> None:
    rig = RecordedRig(write_test(tmp_path, "plate-7", PLATE_7, stretch=1e-3) / "results.nc")
    marks = [
        Mark(name="P", kind="point", points=[[40.0, 40.0]]),
        Mark(name="G", kind="gauge", points=[[16.0, 40.0], [80.0, 40.0]]),
        Mark(name="L", kind="line", points=[[0.0, 40.0], [80.0, 40.0]]),
        Mark(name="A", kind="area", points=[[0.0, 0.0], [80.0, 0.0], [80.0, 80.0], [0.0, 80.0]]),
        Mark(name="far", kind="area", points=[[900.0, 0.0], [980.0, 0.0], [980.0, 80.0]]),
    ]
    point, gauge, line, area, far = readings(rig.maps, Asked(name="u", marks=marks))
    assert [each["value"] for each in point] == pytest.approx([0, 4e-6, 8e-6], rel=1e-5)
    assert point[1]["sigma"] == pytest.approx(1e-7)
    assert [each["value"] for each in gauge] == pytest.approx([0, 1e-3, 2e-3], rel=1e-3)
    assert (line[1]["minimum"], line[1]["maximum"]) == pytest.approx((0, 8e-6), rel=1e-5)
    assert (area[2]["value"], area[2]["maximum"], area[2]["measured"]) == pytest.approx((8e-6, 16e-6, 1.0), rel=1e-5)
    assert "no point of the result" in far[0]["problem"]
    outside = readings(rig.maps, Asked(name="u", marks=[Mark(name="P", kind="point", points=[[900.0, 40.0]])]))[0]
    assert "lies outside the result" in outside[0]["problem"]
    [[one]] = readings(rig.maps, Asked(name="u", marks=marks[:1], steps=[2]))
    assert one["step"] == 2


def test_an_area_has_the_uncertainty_of_the_library(tmp_path: Path) -> None:
    """That of a running test was reduced with the part of the calibration, that of a dataset not at all."""
    source = write_test(tmp_path, "plate-7", PLATE_7, stretch=1e-3) / "results.nc"
    rig = RigModel(
        camera_width=160,
        camera_height=96,
        camera_distance=0.8,
        pixel_size=100e-6,
        pixel_aspect=1.0,
        principal_column=79.5,
        principal_row=47.5,
        camera_distortion=DistortionMap(160, 96, 1e-3 * np.eye(3), np.zeros((3, 3))),
        projector_width=800,
        projector_height=600,
        projector_position=(-0.3, 0.0, 0.9),
        projector_focal_length=1200.0,
        projector_principal_column=399.5,
        projector_principal_row=299.5,
        parameter_names=("pixel_size",),
        covariance=((1e-3 * 100e-6) ** 2,),
    )
    calibration = json.dumps(dataclasses.asdict(rig), default=lambda array: array.tolist())
    with xr.open_dataset(source) as opened:
        dataset = opened.load()
    dataset = dataset.assign(displacement_x=dataset.u / 1e-4, displacement_y=0 * dataset.u)
    save_netcdf(dataset.assign_attrs(calibration=calibration, displacement_window_px=16), tmp_path / "results.nc")
    recorded = RecordedMaps(tmp_path / "results.nc")
    corners = [[16.0, 16.0], [128.0, 16.0], [128.0, 80.0], [16.0, 80.0]]
    area = Asked(name="u", marks=[Mark(name="A", kind="area", points=corners)], steps=[2])
    region = Region((Polygon(tuple((x, y) for x, y in corners)),))
    table = region_statistics(recorded.experiment.sel(step=2), ["u"], region)
    expected = float(table.u.sel(statistic="standard_uncertainty"))
    assert 0 < expected < 0.8e-7, "the noise of 0.1 µm is reduced"
    [[reading]] = readings(recorded, area)
    assert reading["sigma"] == pytest.approx(expected)
    running = SpooledMaps(tmp_path / "spooled")
    names = recorded.names()[2]
    running.put(2, {name: each.values for name, each in recorded.dataset(2, names).items()}, spacing=8)
    [[reading]] = readings(running, area)
    assert reading["sigma"] == pytest.approx(1e-7), "the calibration is not known while the test runs"
    running.complete(recorded)
    [[reading]] = readings(running, area)
    assert reading["sigma"] == pytest.approx(expected)


def test_an_extensometer_has_no_reading_at_a_step_without_a_surface(tmp_path: Path) -> None:
    maps = SpooledMaps(tmp_path)
    maps.put(0, {"displacement_x": np.zeros((5, 5), np.float32)}, spacing=8)
    gauge = Mark(name="G", kind="gauge", points=[[0.0, 8.0], [32.0, 8.0]])
    [[reading]] = readings(maps, Asked(name="displacement_x", marks=[gauge]))
    assert "step 0 has no map x, y, z" in reading["problem"]


def test_marks_that_another_page_kept_are_those_of_an_opened_test(tmp_path: Path) -> None:
    rig = RecordedRig(write_test(tmp_path, "plate-7", PLATE_7, stretch=1e-3) / "results.nc")
    assert rig.snapshot()["marks"]["notes"] == {}
    Marks(notes={1: "of the page of the test that ran last"}).save(rig.folder)
    assert rig.snapshot()["marks"]["notes"] == {1: "of the page of the test that ran last"}


def test_marks_and_notes_are_kept_with_the_test_and_noted_in_its_log(tmp_path: Path) -> None:
    folder = write_test(tmp_path, "plate-7", PLATE_7, stretch=1e-3)
    begin_log(folder, "run", details={})
    rig = RecordedRig(folder / "results.nc")
    marks = [Mark(name="hole", kind="point", points=[[40.0, 40.0]])]
    asyncio.run(rig.do(KeepMarks(marks=marks, notes={2: "a crack begins"})))
    assert load_marks(folder) == Marks(marks=marks, notes={2: "a crack begins"})
    assert rig.snapshot()["marks"]["notes"] == {2: "a crack begins"}
    last = read_log(folder).entries[-1]
    assert (last.action, list(last.files)) == ("marks and notes", [MARKS])
    (folder / MARKS).write_text("marks: 3")
    assert "marks" in RecordedRig(folder / "results.nc").snapshot()["marks"]["problem"]
    with pytest.raises(ConfigurationError):
        load_marks(folder)


def test_marks_from_outside_are_checked() -> None:
    marks = [{"name": "P", "kind": "gauge", "points": [[1, 2]]}]
    with pytest.raises(ValueError, match="P: a gauge has 2 to 2 points, not 1"):
        KeepMarks.model_validate({"marks": marks})
    twice = [{"name": "P", "kind": "point", "points": [[1, 2]]}] * 2
    with pytest.raises(ValueError, match="two marks have the name P"):
        KeepMarks.model_validate({"marks": twice})
    kept = KeepMarks.model_validate_json('{"marks": [], "notes": {"3": "text"}}')
    assert kept.notes == {3: "text"}
