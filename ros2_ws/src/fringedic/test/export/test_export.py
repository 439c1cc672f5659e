"""Every exported file, read back with the library that users would take, against the dataset it came from."""

import csv
import errno
import json
import os
import shutil
import tracemalloc
from pathlib import Path

import h5py
import meshio
import numpy as np
import pytest
import pyvista
import scipy.io
import tifffile
import xarray as xr
import zarr
from aligned_rig import aligned_rig
from PIL import Image

from fringedic.datasets import open_experiment, stores
from fringedic.datasets.quantities import MAPS, STEP_NUMBERS, layout_of_images
from fringedic.datasets.rows import Row
from fringedic.datasets.writer import DatasetWriter
from fringedic.errors import ExportError
from fringedic.export import FORMATS, export_dataset, tables
from fringedic.metadata import Metadata
from fringedic.signals import SignalValue, signals_of
from fringedic.steps.parameters import CouplingParameters, DicParameters, PhaseParameters
from fringedic.steps.recorded_parameters import StepSettings

ROWS, COLUMNS, SPACING = 4, 5, 3
PIXEL = 50e-6  # [m]
START = 1_700_000_000_000_000_000  # [ns]
RIG = aligned_rig(
    (COLUMNS * SPACING, ROWS * SPACING),
    PIXEL,
    (100, 75),
    400.0,
    projector_position=(-0.2, 0.0, 0.4),
    identifier="bench",
)
HOLE = (1, 3)  # row, column that is not measured
METADATA = Metadata.from_text("specimen: {name: sheet 4, section_mm2: 12.5, operator: Ada, force_sign: -1}")


def maps(step):
    """A surface that rises to the right and upwards, moved left, upwards and to the camera, more each step."""
    row, column = np.mgrid[:ROWS, :COLUMNS].astype(float)
    x = PIXEL * (SPACING * column - 7.0)
    y = -PIXEL * (SPACING * row - 5.5)
    values = {name: np.full((ROWS, COLUMNS), np.nan) for name in MAPS}
    values |= {"x": x, "y": y, "z": 1e-3 + 0.1 * x + 0.3 * y}
    values |= {
        "u": -2e-6 * step * (1 + column),
        "v": 3e-6 * step * (1 + row),
        "w": 5e-6 * step * (1 + column + 2 * row),
    }
    values |= {"sigma_u": 0 * x + 1e-7, "sigma_v": 0 * x + 2e-7, "sigma_w": 0 * x + 3e-7}
    values |= {"e_11": -150e-6 * step + 0 * x, "e_22": 250e-6 * step + 1e-6 * column, "e_12": 10e-6 * row}
    values |= {"displacement_x": -0.04 * step + 0 * x, "displacement_y": -0.06 * step + 0 * x}
    values |= {"phase": 0.1 * column, "modulation": 40.0 + row, "texture": 100.0 + column}
    values |= {"shape_x": x, "shape_y": y, "shape_z": values["z"] + values["w"]}
    for name, each in values.items():
        if name not in ("modulation", "texture"):
            each[HOLE] = np.nan
    return {name: each.astype(np.float32) for name, each in values.items()}


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    path = tmp_path_factory.mktemp("dataset") / "sheet.nc"
    parameters = {"phase": PhaseParameters(), "dic": DicParameters(spacing=SPACING), "coupling": CouplingParameters()}
    settings = StepSettings(parameters, RIG, {"camera": {"exposure_time_s": 0.01}}, METADATA)
    with DatasetWriter(path, {"experiment": "sheet", "source": "bag"}) as writer:
        writer.add_signals(signals_of([]).values())
        for step in (0, 1, 2):
            stamp = START + step * 1_500_000_000
            row = Row(step, stamp, "", 0, max(step - 1, 0), 0.9, 1e-5 * step, maps(step))
            row.signals = {"force": SignalValue(10.0 * step), "position": SignalValue(1e-4 * step)}
            writer.add(row, settings)
        white = {"displacement_x": maps(2)["displacement_x"], "displacement_y": maps(2)["displacement_y"]}
        row = Row(3, START + 4_000_000_000, "", 0, 0, 0.9, float("nan"), white)
        row.signals = {"force": SignalValue(20.0), "position": SignalValue(2e-4)}
        writer.add(row, settings)
        writer.add(Row(4, START + 5_000_000_000, "step 4: frames 2 of 8 never arrived"), settings)
    with open_experiment(path) as opened:
        yield opened


@pytest.fixture(scope="module")
def exported(dataset, tmp_path_factory):
    folder = tmp_path_factory.mktemp("exported")
    pictures = ("png", "gif")  # drawing takes most of the time: one step with a surface and one without
    done = export_dataset(dataset, folder, [name for name in FORMATS if name not in pictures])
    done += export_dataset(dataset, folder, pictures, steps=[2, 3])
    done = {each.format: each for each in done}
    assert set(done) == set(FORMATS)
    assert all(each.path is not None and each.path.exists() for each in done.values())
    assert not [name for name in os.listdir(folder) if name.startswith(".")]
    return done


@pytest.fixture(params=[True, False], ids=["scale", "no scale"])
def image_series(request, tmp_path):
    """Three images without times, whose points move to the right and downwards."""
    scaled = request.param
    attributes = {"experiment": "series", "image_width": 14, "image_height": 11} | (
        {"pixel_size": PIXEL} if scaled else {}
    )
    parameters = {"dic": DicParameters(spacing=SPACING)}
    with DatasetWriter(tmp_path / "series.nc", attributes, layout_of_images(scaled)) as writer:
        for step in (0, 1, 2):
            moved = {
                "displacement_x": np.full((ROWS, COLUMNS), 0.4 * step, np.float32),
                "displacement_y": np.full((ROWS, COLUMNS), 0.3 * step, np.float32),
            }
            rms = 0.5 * step * (PIXEL if scaled else 1.0)
            row = Row(step, None, "", 0, 0, valid_fraction=1.0, rms_displacement=rms, maps=moved, image=f"{step}.tif")
            writer.add(row, StepSettings(parameters, None, {}, None))
    with open_experiment(tmp_path / "series.nc") as opened:
        yield opened


def measured(dataset, name, step, factor):
    values = dataset[name].sel(step=step).values
    return values[np.isfinite(dataset["w"].sel(step=2).values)] / factor


def check_metadata(found):
    assert found["calibration"]["camera_distance"] == 0.4
    assert found["parameters"][0]["parameters"]["dic"]["spacing"] == SPACING
    assert found["facts"]["specimen"]["operator"] == "Ada"
    assert found["software"].startswith("fringedic ")
    assert len(found["commit"]) >= 7
    assert found["exported_by_commit"]


def test_the_dataset_carries_its_origin(dataset):
    attributes = {**dataset.attrs, "exported_by_commit": "-"}
    for name in ("calibration", "parameters", "facts"):
        attributes[name] = json.loads(attributes[name])
    check_metadata(attributes)


@pytest.mark.parametrize("name", ["netcdf", "zarr"])
def test_netcdf_and_zarr_are_the_dataset(dataset, exported, name):
    with open_experiment(exported[name].path) as again:
        xr.testing.assert_identical(again.load(), dataset.load())
        assert again.time.values[1] == np.datetime64(START + 1_500_000_000, "ns")


def test_netcdf_opens_in_hdf5(dataset, exported):
    with h5py.File(exported["netcdf"].path) as file:
        np.testing.assert_array_equal(file["w"][2], dataset.w.sel(step=2).values)
        assert file["w"].chunks == (1, ROWS, COLUMNS)
        assert file["w"].attrs["units"] in ("m", b"m")


def test_zarr_opens_without_this_library(dataset, exported):
    group = zarr.open_group(exported["zarr"].path, mode="r")
    np.testing.assert_array_equal(group["w"][2], dataset.w.sel(step=2).values)
    assert group["w"].attrs["units"] == "m"


def test_vtk_series_shows_the_surface_in_mm_with_its_displacement(dataset, exported):
    reader = pyvista.get_reader(exported["vtk"].path / "sheet.pvd")
    assert reader.time_values == [0.0, 1.5, 3.0]
    reader.set_active_time_value(3.0)
    mesh = reader.read()[0]
    points = np.stack([measured(dataset, name, 2, 1e-3) for name in "xyz"], axis=-1)
    np.testing.assert_allclose(mesh.points, points, rtol=1e-6, atol=1e-9)
    moved = np.stack([measured(dataset, name, 2, 1e-3) for name in "uvw"], axis=-1)
    np.testing.assert_allclose(mesh["displacement_mm"], moved, rtol=1e-6)
    # to the left, upwards and towards the camera
    assert (mesh["displacement_mm"] * [-1, 1, 1] > 0).all()
    np.testing.assert_allclose(mesh["e_22_ustrain"], measured(dataset, "e_22", 2, 1e-6), rtol=1e-6)
    assert mesh.n_points == ROWS * COLUMNS - 1
    assert mesh.n_cells == (ROWS - 1) * (COLUMNS - 1) - 4
    normals = mesh.compute_normals(point_normals=False, consistent_normals=False, auto_orient_normals=False)["Normals"]
    assert (normals[:, 2] > 0.9).all(), "faces look towards the camera"
    assert [mesh.field_data[name][0] for name in STEP_NUMBERS] == [0, 1, 1]
    check_metadata(json.loads(mesh.field_data["metadata"][0]))
    assert exported["vtk"].problems == ["step 3 has no surface", "step 4 has no surface"]


def test_ply_holds_the_moved_surface(dataset, exported):
    """Read by two programs with readers of their own, of which one allows comments of a line only."""
    file = exported["ply"].path / "step_002.ply"
    moved = [
        measured(dataset, axis, 2, 1e-3) + measured(dataset, way, 2, 1e-3)
        for axis, way in zip("xyz", "uvw", strict=True)
    ]
    for points in (pyvista.read(file).points, meshio.read(file).points):
        np.testing.assert_allclose(points, np.stack(moved, axis=-1), rtol=1e-6, atol=1e-9)
    mesh = meshio.read(file)
    assert [(block.type, len(block.data)) for block in mesh.cells] == [("quad", (ROWS - 1) * (COLUMNS - 1) - 4)]
    np.testing.assert_allclose(mesh.point_data["w_um"], measured(dataset, "w", 2, 1e-6), rtol=1e-6)
    lines = file.read_bytes().split(b"end_header\n", 1)[0].decode("ascii").splitlines()
    assert {"comment units mm", "comment correlated_step 1", "comment increments_summed 1"} <= set(lines)
    assert max(map(len, lines)) < 80
    check_metadata(json.loads((file.parent / "metadata.json").read_text("utf-8")))


def test_csv_names_its_units(dataset, exported):
    folder = exported["csv"].path
    assert (
        (folder / "step_001.csv").read_text("utf-8-sig").splitlines()[0].startswith("row [px],column [px],phase [rad]")
    )
    table = np.genfromtxt(folder / "step_001.csv", delimiter=",", names=True, deletechars="", encoding="utf-8-sig")
    assert len(table) == ROWS * COLUMNS - 1
    np.testing.assert_allclose(table["u_[µm]"], measured(dataset, "u", 1, 1e-6), rtol=1e-6)
    np.testing.assert_allclose(table["z_[mm]"], measured(dataset, "z", 1, 1e-3), rtol=1e-6)
    np.testing.assert_allclose(table["e_11_[µstrain]"], -150, rtol=1e-6)
    assert table["row_[px]"][0] == 0
    assert table["column_[px]"][1] == SPACING
    steps = np.genfromtxt(
        folder / "steps.csv", delimiter=",", names=True, deletechars="", encoding="utf-8-sig", dtype=None
    )
    assert steps["time_[s]"].tolist() == [0.0, 1.5, 3.0, 4.0, 5.0]
    assert steps["force_[N]"][:4].tolist() == [0, 10, 20, 20]
    assert steps["position_[mm]"][2] == 0.2
    assert steps["rms_displacement_[µm]"][1] == 10
    assert steps["reference_step"].tolist() == [0, 0, 0, 0, -1]
    assert steps["correlated_step"].tolist() == [0, 0, 1, 0, -1]
    assert steps["increments_summed"].tolist() == [0, 0, 1, 0, -1]
    assert "never arrived" in str(steps["error"][4])
    check_metadata(json.loads((folder / "metadata.json").read_text()))
    assert exported["csv"].problems == ["step 4 has no measured point"]


def steps_of(exported):
    """Return the table of steps in CSV as text, by heading."""
    with open(exported.path / "steps.csv", newline="", encoding="utf-8-sig") as stream:
        heading, *lines = csv.reader(stream)
    return dict(zip(heading, map(list, zip(*lines, strict=True)), strict=True))


def test_csv_names_the_unit_of_the_displacement_of_images(image_series, tmp_path):
    [done] = export_dataset(image_series, tmp_path, ["csv"])
    steps = steps_of(done)
    if "pixel_size" in image_series.attrs:
        assert steps["rms_displacement [µm]"] == ["0.0", "25.0", "50.0"]
    else:
        assert steps["rms_displacement [px]"] == ["0.0", "0.5", "1.0"]
    assert steps["valid_fraction [1]"] == ["1.0"] * 3


def test_tables_of_images_contain_their_names(image_series, tmp_path):
    done = {each.format: each for each in export_dataset(image_series, tmp_path, ["csv", "mat", "tiff"], steps=[0, 2])}
    assert steps_of(done["csv"])["image"] == ["0.tif", "2.tif"]
    content = scipy.io.loadmat(done["mat"].path, squeeze_me=True, simplify_cells=True)
    assert content["image"].tolist() == ["0.tif", "2.tif"]
    for step in (0, 2):
        file = next(done["tiff"].path.glob(f"step_{step:03d}_displacement_x*.tif"))
        with tifffile.TiffFile(file) as opened:
            assert json.loads(opened.pages.first.description)["image"] == f"{step}.tif"


def test_matlab_gets_si_units_and_names_them(dataset, exported):
    content = scipy.io.loadmat(exported["mat"].path, squeeze_me=True, simplify_cells=True)
    np.testing.assert_array_equal(content["w"], dataset.w.values.transpose(1, 2, 0))
    assert content["units"]["w"] == "m"
    assert content["units"]["displacement_x"] == "px"
    assert content["time"].tolist() == [0.0, 1.5, 3.0, 4.0, 5.0]
    assert content["column"].tolist() == [0, 3, 6, 9, 12]
    np.testing.assert_allclose(content["force"][:3], [0, 10, 20])
    assert content["correlated_step"].tolist() == [0, 0, 1, 0, -1]
    check_metadata(json.loads(str(content["metadata"])))


def test_matlab_has_one_map_in_memory_at_a_time(tmp_path):
    names = ("u", "v", "w", "x", "y", "z", "e_11", "e_22")
    values = np.random.default_rng(1).normal(size=(2, 200, 200)).astype(np.float32)
    axes = {"step": range(2), "row": range(200), "column": range(200)}
    fields = dict.fromkeys(names, (("step", "row", "column"), values)) | {"error": ("step", ["", ""])}
    xr.Dataset(fields, axes, {"experiment": "large"}).to_netcdf(tmp_path / "large.nc", engine="h5netcdf")
    with open_experiment(tmp_path / "large.nc") as opened:
        tables.write_matlab(opened.isel(step=[0]), tmp_path / "first.mat")  # what is loaded once
        tracemalloc.start()
        tables.write_matlab(opened, tmp_path / "large.mat")
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert peak < 6 * values.nbytes, f"{peak / values.nbytes:.1f} maps"
    content = scipy.io.loadmat(tmp_path / "large.mat", simplify_cells=True)
    assert set(content) >= {*names, "row", "units", "metadata"}
    np.testing.assert_array_equal(content["e_22"], values.transpose(1, 2, 0))


def test_tiff_maps_are_32_bit_in_the_unit_of_their_name(dataset, exported):
    folder = exported["tiff"].path
    with tifffile.TiffFile(folder / "step_002_w_um.tif") as file:
        image = file.asarray()
        description = json.loads(file.pages[0].description)
    assert image.dtype == np.float32
    assert image.shape == (ROWS, COLUMNS)
    assert np.isnan(image[HOLE])
    np.testing.assert_allclose(image, dataset.w.sel(step=2).values / 1e-6, rtol=1e-6)
    assert description["unit"] == "µm"
    assert description["spacing_px"] == SPACING
    assert (description["correlated_step"], description["increments_summed"]) == (1, 1)
    check_metadata(description)
    assert tifffile.imread(folder / "step_001_shape_z_mm.tif")[0, 0] == pytest.approx(
        float(dataset.shape_z[1, 0, 0]) * 1e3
    )
    assert (folder / "step_003_displacement_x_px.tif").exists()
    assert not list(folder.glob("step_004*"))


def test_pictures_are_written(exported):
    assert {path.name for path in exported["png"].path.iterdir()} >= {"step_002.png", "step_003.png"}
    with Image.open(exported["png"].path / "step_002.png") as picture:
        check_metadata(json.loads(picture.info["Description"]))
    with Image.open(exported["gif"].path / "w.gif") as picture:
        check_metadata(json.loads(picture.info["comment"]))


def test_r3xa_says_what_is_known_and_nothing_else(exported):
    document = json.loads(exported["r3xa"].path.read_text("utf-8"))
    assert {"title", "description", "version", "authors", "date"} <= document.keys()
    assert (document["version"], document["authors"], document["date"]) == ("2024.7.1", "Ada", "2023-11-14")
    camera = document["data_sources"][0]
    assert camera["kind"] == "data_sources/camera"
    assert camera["image_size"][0]["value"] == 15
    assert camera["exposure"] == {"kind": "unit", "unit": "ms", "value": 10.0}
    assert camera["image_scale"]["value"] == pytest.approx(20.0)
    assert camera["image_scale"]["unit"] == "px/mm"
    assert "lens" not in camera
    assert "aperture" not in camera
    assert "noise" not in camera
    assert document["settings"][0]["sizes"] == [{"kind": "unit", "unit": "mm2", "value": 12.5, "title": "section"}]


def test_images_without_times_have_no_times_in_their_exports(image_series, tmp_path):
    done = {each.format: each for each in export_dataset(image_series, tmp_path, ["csv", "mat", "r3xa"])}
    assert [heading for heading in steps_of(done["csv"]) if "time" in heading] == []
    content = scipy.io.loadmat(done["mat"].path, squeeze_me=True, simplify_cells=True)
    assert "time" not in content
    assert "time" not in content["units"]
    document = json.loads(done["r3xa"].path.read_text("utf-8"))
    assert "date" not in document
    assert "time_reference" not in document["data_sets"][0]
    assert document["data_sets"][0]["timestamps"] == []
    assert "date and time_reference" in done["r3xa"].problems[0]


def test_vtk_series_of_images_without_times_counts_steps(image_series, tmp_path):
    [done] = export_dataset(image_series, tmp_path, ["vtk"], steps=[1, 2])
    if "pixel_size" not in image_series.attrs:
        assert done.path is None
        return
    reader = pyvista.get_reader(done.path / "series.pvd")
    assert reader.time_values == [1.0, 2.0]
    assert "TimeValue" not in pyvista.read(done.path / "step_001.vtp").field_data


def test_r3xa_of_images_describes_their_displacement(image_series, tmp_path):
    [done] = export_dataset(image_series, tmp_path, ["r3xa"])
    camera, analysis = json.loads(done.path.read_text("utf-8"))["data_sources"]
    assert camera["description"] == "images"
    assert [side["value"] for side in camera["image_size"]] == [14, 11]
    assert (analysis["title"], analysis["output_components"]) == ("in-plane displacement", 2)
    scaled = "pixel_size" in image_series.attrs
    assert analysis["output_units"] == [{"kind": "unit", "unit": "m" if scaled else "px"}]
    assert ("image_scale" in camera, "field_of_view" in camera) == (scaled, scaled)
    if scaled:
        assert camera["image_scale"]["value"] == pytest.approx(20.0)
        assert [side["value"] for side in camera["field_of_view"]] == pytest.approx([0.7, 0.55])


def test_chosen_steps_keep_their_times(dataset, tmp_path):
    done = {
        each.format: each for each in export_dataset(dataset, tmp_path, ["csv", "mat", "vtk", "r3xa"], steps=[1, 2])
    }
    assert steps_of(done["csv"])["time [s]"] == ["1.5", "3.0"]
    assert scipy.io.loadmat(done["mat"].path, squeeze_me=True)["time"].tolist() == [1.5, 3.0]
    assert pyvista.get_reader(done["vtk"].path / "sheet.pvd").time_values == [1.5, 3.0]
    [results] = json.loads(done["r3xa"].path.read_text("utf-8"))["data_sets"]
    assert (results["time_reference"], results["timestamps"]) == (pytest.approx(START * 1e-9), [1.5, 3.0])


def test_times_of_a_selection_stay_comparable_when_it_is_exported_again(dataset, tmp_path):
    [selected] = export_dataset(dataset, tmp_path, ["netcdf"], steps=[1, 2])
    with open_experiment(selected.path) as again:
        [done] = export_dataset(again, tmp_path, ["csv"], steps=[2])
    assert steps_of(done)["time [s]"] == ["3.0"]


def test_surfaces_of_images_have_the_origin_of_the_pictures(image_series, tmp_path):
    """The origin is the middle of the image, in the dataset, in VTK and in PLY."""
    if "pixel_size" not in image_series.attrs:
        return
    done = export_dataset(image_series, tmp_path, ["vtk", "ply"], steps=[0])
    x, y = np.meshgrid(image_series["x_mm"].values, image_series["y_mm"].values)
    for each, file in zip(done, ("step_000.vtp", "step_000.ply"), strict=True):
        points = pyvista.read(each.path / file).points
        np.testing.assert_allclose(points, np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=-1), atol=1e-6)


def test_nothing_is_overwritten_unasked(dataset, tmp_path):
    first = export_dataset(dataset, tmp_path, ["mat", "csv"], steps=[1])
    before = first[0].path.read_bytes()
    again = export_dataset(dataset, tmp_path, ["mat", "tiff"], steps=[2])
    assert again[0].path is None
    assert "sheet.mat exists already" in again[0].problems[0]
    assert again[1].path is not None, "the others go on"
    assert first[0].path.read_bytes() == before
    asked = export_dataset(dataset, tmp_path, ["mat"], steps=[2], overwrite=True)
    assert asked[0].path.read_bytes() != before


@pytest.mark.parametrize("name", ["../evil", "plate/1", "a\nb", ".."])
def test_the_name_of_the_experiment_is_no_path(dataset, tmp_path, name):
    folder = tmp_path / "out"
    done = export_dataset(dataset.assign_attrs(experiment=name), folder, ["mat", "vtk", "r3xa"], steps=[1])
    assert [each.path.parent for each in done] == [folder] * 3
    assert list(tmp_path.iterdir()) == [folder]
    assert len(list(done[1].path.glob("*.pvd"))) == 1
    assert json.loads(done[2].path.read_text())["title"] == name


def test_a_full_disk_is_named_and_keeps_the_previous_file(dataset, tmp_path, monkeypatch):
    [before] = export_dataset(dataset, tmp_path, ["netcdf"], steps=[1])
    content = before.path.read_bytes()
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=100_000))
    [done] = export_dataset(dataset, tmp_path, ["netcdf"], steps=[2], overwrite=True)
    assert done.path is None
    assert "the disk is full, the dataset needs 10 MB" in done.problems[0]
    assert before.path.read_bytes() == content
    assert list(tmp_path.iterdir()) == [before.path]


@pytest.mark.parametrize(("name", "file"), [("netcdf", "sheet.nc"), ("png", "sheet_png")])
def test_an_export_that_fails_names_the_wanted_file(dataset, tmp_path, monkeypatch, name, file):
    make = Path.mkdir

    def denied(place, *arguments, **options):
        if str(tmp_path) in str(place) and place != tmp_path:
            raise PermissionError(errno.EACCES, "Permission denied")
        return make(place, *arguments, **options)

    monkeypatch.setattr(stores, "_Output", denied)
    monkeypatch.setattr(Path, "mkdir", denied)
    [done] = export_dataset(dataset, tmp_path, [name], steps=[1])
    assert done.path is None
    assert done.problems[0].startswith(f"{tmp_path / file}: cannot be "), done.problems


def test_formats_that_cannot_hold_the_data_are_named_and_the_rest_goes_on(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr(tables, "MATLAB_LIMIT", 4 * ROWS * COLUMNS - 1)
    done = {each.format: each for each in export_dataset(dataset, tmp_path, ["mat", "vtk", "ply", "csv"], steps=[3])}
    assert "a .mat file cannot hold 'phase'" in done["mat"].problems[0]
    assert "no step has a surface" in done["vtk"].problems[0]
    assert "no step has a surface" in done["ply"].problems[0]
    assert [name for name, each in done.items() if each.path is not None] == ["csv"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["sheet_csv"]


def test_unwritable_folders_and_unknown_words_are_named(dataset, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(ExportError, match=r"file.*: cannot be made"):
        export_dataset(dataset, tmp_path / "file" / "folder", ["csv"])
    with pytest.raises(ExportError, match=r"no format doc; known are netcdf, zarr, vtk"):
        export_dataset(dataset, tmp_path, ["doc"])
    with pytest.raises(ExportError, match=r"no step 9; it has 0, 1, 2, 3, 4"):
        export_dataset(dataset, tmp_path, ["csv"], steps=[9])
    if os.geteuid():
        closed = Path(tmp_path / "closed")
        closed.mkdir(mode=0o500)
        done = export_dataset(dataset, closed, ["csv"])
        assert done[0].path is None
        assert "cannot be written" in done[0].problems[0]
