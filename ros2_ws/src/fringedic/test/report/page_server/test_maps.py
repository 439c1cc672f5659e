"""Maps of a running test in a folder, and of a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from fringedic.errors import DatasetError
from fringedic.report.page_server import maps
from fringedic.report.page_server.maps import RecordedMaps, SpooledMaps, described, gauge, tile
from fringedic.report.page_server.recorded import RecordedRig


def plane(rows: int, columns: int, value: float = 1.0) -> np.ndarray:
    return np.full((rows, columns), value, np.float32)


def test_maps_of_a_server_that_was_ended_are_found_again(tmp_path: Path) -> None:
    SpooledMaps(tmp_path).put(3, {"u": plane(4, 5), "not a map": plane(4, 5)}, 2)
    found = SpooledMaps(tmp_path)
    assert found.names() == {3: ["u"]}
    assert found.dataset(3, ["u"])["column"].values.tolist() == [0, 2, 4, 6, 8]
    found.clear()
    assert found.names() == {}


def test_steps_that_no_server_heard_come_from_the_recording(tmp_path: Path) -> None:
    recorded, heard = SpooledMaps(tmp_path / "recorded"), SpooledMaps(tmp_path / "heard")
    for step in range(3):
        recorded.put(step, {"displacement_x": plane(4, 5), "u": plane(4, 5)}, 2)
    heard.put(1, {"displacement_x": plane(4, 5, 7.0)}, 2)
    heard.put(2, {"displacement_x": plane(4, 5, 7.0), "u": plane(4, 5, 7.0)}, 2)
    heard.complete(recorded)
    assert {step: set(names) for step, names in heard.names().items()} == {
        step: {"u", "displacement_x"} for step in range(3)
    }
    assert [float(tile(heard, step, "u").values.mean()) for step in range(3)] == [1.0, 1.0, 7.0]
    assert tile(heard, 0, "u").spacing == 2


def test_maps_at_every_pixel_are_sampled_at_the_points(tmp_path: Path) -> None:
    row, column = np.mgrid[0:7, 0:9].astype(np.float32)
    spooled = SpooledMaps(tmp_path)
    spooled.put(0, {"u": plane(4, 5), "shape_z": 10 * row + column}, 2)
    np.testing.assert_array_equal(tile(spooled, 0, "shape_z").values, (10 * row + column)[::2, ::2])


def test_oldest_steps_are_removed_when_the_maps_become_too_many(tmp_path: Path) -> None:
    spooled = SpooledMaps(tmp_path, most_bytes=3 * 4 * 100 * 100)
    for step in range(5):
        spooled.put(step, {"u": plane(100, 100, step)}, 1)
    assert list(spooled.names()) == [3, 4]
    with pytest.raises(DatasetError, match="step 0 has no map u: choose"):
        tile(spooled, 0, "u")


def test_large_map_is_decimated_without_interpolation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(maps, "MOST_VALUES", 100)
    values = np.arange(30 * 40, dtype=np.float32).reshape(30, 40)
    spooled = SpooledMaps(tmp_path)
    spooled.put(0, {"u": values}, 3)
    found = tile(spooled, 0, "u")
    assert found.values.size <= 100
    assert found.spacing == 3 * 4
    np.testing.assert_array_equal(found.values, values[::4, ::4])


def test_gauge_without_displacements_is_refused(tmp_path: Path) -> None:
    spooled = SpooledMaps(tmp_path)
    spooled.put(0, {"texture": plane(4, 5)}, 1)
    with pytest.raises(DatasetError, match="no step has a displacement yet: measure two steps"):
        gauge(spooled, (0, 0), (2, 2), 1)


def test_description_has_the_unit_of_people() -> None:
    assert described("w") | {"meaning": ""} == {
        "name": "w",
        "meaning": "",
        "unit": "µm",
        "factor": 1e-6,
        "sigma": "sigma_w",
        "resolution": None,
        "level": 2,
    }
    assert described("texture")["sigma"] is None
    assert described("e_12")["resolution"] == "resolution_e_12"


@pytest.mark.parametrize("measured", [slice(0, 14), slice(31, 32), slice(50, 64)], ids=["upper", "one row", "lower"])
def test_maps_that_are_measured_in_a_few_rows_are_found(tmp_path: Path, measured: slice) -> None:
    values = np.full((2, 64, 48), np.nan, np.float32)
    values[1, measured] = 1e-6
    fields = {"u": (("step", "row", "column"), values), "error": ("step", ["", ""])}
    axes = {"step": [0, 1], "row": range(64), "column": range(48)}
    xr.Dataset(fields, axes).to_netcdf(tmp_path / "sheet.nc", engine="h5netcdf")
    assert RecordedMaps(tmp_path / "sheet.nc").names() == {0: [], 1: ["u"]}


def test_recording_without_results_is_refused(tmp_path: Path) -> None:
    with pytest.raises((DatasetError, OSError), match="nowhere"):
        RecordedMaps(tmp_path / "nowhere")


def test_maps_of_the_overlap_of_several_sensors_are_listed_and_shown(tmp_path: Path) -> None:
    axes = {"step": [1], "row": range(4), "column": range(5)}
    values = {"u": 1e-6, "overlap_u": 0.5, "sigma_shape": 2e-6, "sensors": 2.0}
    fields = {name: (("step", "row", "column"), plane(4, 5, value)[None]) for name, value in values.items()}
    joined = xr.Dataset({**fields, "error": ("step", [""])}, axes, {"sensor": "joined"})
    joined.to_netcdf(tmp_path / "bag.joined.nc", engine="h5netcdf")
    rig = RecordedRig(tmp_path / "bag.joined.nc")
    shown = {each["name"]: (each["unit"], each["factor"]) for each in rig.snapshot()["quantities"]}
    assert shown == {
        "u": ("µm", 1e-6),
        "overlap_u": ("standard deviations", 1.0),
        "sigma_shape": ("µm", 1e-6),
        "sensors": ("", 1.0),
    }
    assert tile(rig.maps, 1, "overlap_u").values.tolist() == plane(4, 5, 0.5).tolist()
