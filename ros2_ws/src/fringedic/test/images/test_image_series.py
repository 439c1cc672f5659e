"""Series of images without a rig: displacement, strain and scale against the exact values."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import pyvista
import scipy.io
import xarray as xr
from scipy.ndimage import gaussian_filter, map_coordinates

import fringedic
from fringedic.errors import CorrelationError, DatasetError, ErrorCode, ImageError
from fringedic.export import export_dataset
from fringedic.frames.mosaic import has_mosaic
from fringedic.images import measure_images
from fringedic.images.sentences import order_sentences, series_sentences
from fringedic.report import write_report
from fringedic.surface import flat_strain

SIZE = (150, 200)
PIXEL = 5e-5  # [m]
STRAIN, CONTRACTION = 4e-3, -1.2e-3  # per image, along x and y


def speckle(seed=3):
    """Grey levels of random spots, wider than the images on all sides."""
    texture = gaussian_filter(np.random.default_rng(seed).normal(size=(SIZE[0] + 60, SIZE[1] + 60)), 1.5)
    return 128 + 40 * texture / texture.std()


def stretched(texture, number, noise):
    """Image `number`: the point at (row, column) is now `number` times strained."""
    row, column = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    where = [30 + row / (1 + number * CONTRACTION), 30 + column / (1 + number * STRAIN)]
    grey = map_coordinates(texture, where, order=5) + noise.normal(0, 1, SIZE)
    return np.clip(grey, 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Four images, 2 before 10, and a note."""
    place, noise, texture = tmp_path_factory.mktemp("images"), np.random.default_rng(1), speckle()
    for number, name in enumerate((1, 2, 9, 10)):
        cv2.imwrite(str(place / f"load_{name}.tif"), stretched(texture, number, noise))
    (place / "notes.txt").write_text("no image")
    return place


@pytest.fixture(scope="module")
def dataset(folder, tmp_path_factory):
    told = []
    target = tmp_path_factory.mktemp("measured") / "series.nc"
    series = measure_images(
        [folder], target, pixel_size=PIXEL, strain_window=41, progress=lambda image, count: told.append((image, count))
    )
    assert [image.name for image in series.images] == [f"load_{name}.tif" for name in (1, 2, 9, 10)]
    assert [count for _, count in told] == [4] * 4
    assert series.failed == []
    with fringedic.open_experiment(series.dataset) as opened:
        yield opened.load()


def inner(values):
    return values.isel(row=slice(8, -8), column=slice(8, -8))


def test_residual_is_the_noise_of_both_images(dataset):
    """Noise of 1 and quantisation of 1/12 grey level² in each; interpolation reduces that of one of them."""
    spread = inner(dataset.grey_residual).std(("row", "column")).values
    assert np.isnan(spread[0])
    assert (spread[1:] > np.sqrt(13 / 12)).all()
    assert (spread[1:] < np.sqrt(2 * 13 / 12)).all()


def test_strain_is_exact_within_its_uncertainty(dataset):
    last = inner(dataset.sel(step=3))
    exact = {"e_xx": 3 * STRAIN + 4.5 * STRAIN**2, "e_yy": 3 * CONTRACTION + 4.5 * CONTRACTION**2, "e_xy": 0.0}
    for name, value in exact.items():
        error = last[name] - value
        assert abs(float(error.mean())) < 60e-6, name
        assert 0.7 < float(error.std() / last[f"sigma_{name}"].median()) < 1.3, name
    assert float(last.e_1.median()) == pytest.approx(exact["e_xx"], abs=60e-6)
    assert float(last.e_2.median()) == pytest.approx(exact["e_yy"], abs=60e-6)


def test_scale_gives_metres_with_y_upwards(dataset):
    last = dataset.sel(step=3)
    np.testing.assert_allclose(last.u, PIXEL * last.displacement_x, rtol=1e-6)
    np.testing.assert_allclose(last.v, -PIXEL * last.displacement_y, rtol=1e-6)
    assert (dataset.u.attrs["units"], dataset.rms_displacement.attrs["units"]) == ("m", "m")
    assert float(dataset.y_mm[0]) == pytest.approx(1e3 * PIXEL * 0.5 * (SIZE[0] - 1))
    assert dataset.valid_fraction.values[0] > 0.85


def test_extensometer_and_rigid_motion_need_no_shape(dataset):
    gauge = dataset.fringedic.extensometer((40, 75), (160, 75), subset=21)
    assert gauge.length.attrs["units"] == "m"
    assert float(gauge.length[0]) == pytest.approx(120 * PIXEL)
    error = gauge.strain.values - STRAIN * np.arange(4)
    assert abs(error[1:]).max() < 4 * float(gauge.sigma_strain[-1])
    rest = dataset.fringedic.remove_rigid_motion()
    assert abs(float(rest.displacement_x.sel(step=3).mean())) < 1e-3
    assert float(rest.translation.sel(step=3, axis="x")) == pytest.approx(float(dataset.u.sel(step=3).mean()), rel=0.02)
    np.testing.assert_allclose(rest.displacement_sigma_x, dataset.displacement_sigma_x, rtol=1e-4)
    again = dataset.fringedic.strain(41)
    for name in ("e_xx", "e_yy", "e_xy", "sigma_e_xx", "sigma_e_yy", "sigma_e_xy"):
        np.testing.assert_allclose(again[name], dataset[name].sel(step=3), rtol=2e-6, atol=1e-12)
    wider = dataset.fringedic.strain(61)
    assert wider.attrs["virtual_strain_gauge_px"] == 32 + 64, "17 points every 4 px"
    assert float(wider.sigma_e_xx.median()) < float(dataset.sigma_e_xx.sel(step=3).median())


@pytest.mark.parametrize(
    ("measure", "along", "title"),
    [
        ("green-lagrange", lambda e: e + e**2 / 2, "Green-Lagrange strain ((F^T F - 1)/2)"),
        ("logarithmic", np.log1p, "logarithmic strain (ln U, Hencky)"),
        ("engineering", lambda e: e, "engineering strain (U - 1, Biot)"),
    ],
)
def test_every_file_names_the_measure_of_the_strain(folder, tmp_path, measure, along, title):
    files = [folder / "load_1.tif", folder / "load_10.tif"]
    series = measure_images(files, tmp_path / "a.nc", pixel_size=PIXEL, strain_measure=measure)
    with fringedic.open_experiment(series.dataset) as dataset:
        last = inner(dataset.sel(step=1))
        for name, value in (("e_xx", 3 * STRAIN), ("e_yy", 3 * CONTRACTION)):
            assert float(last[name].median()) == pytest.approx(along(value), abs=20e-6), name
        assert (dataset.attrs["strain_measure"], dataset.attrs["shear_strain"][:6]) == (measure, "tensor")
        assert dataset.e_xx.long_name == f"{title} along x (right)"
        assert dataset.e_xy.long_name == f"{title}, tensor shear of x (right) and y (up)"
        again = dataset.fringedic.strain(41)
        np.testing.assert_allclose(again.e_xx, dataset.e_xx.sel(step=1), rtol=2e-6, atol=1e-12)
        np.testing.assert_allclose(again.sigma_e_xy, dataset.sigma_e_xy.sel(step=1), rtol=2e-6, atol=1e-12)
        assert again.attrs["strain_measure"] == measure
        [sentence] = [each for each in series_sentences(series, dataset) if each.startswith("strain of")]
        short = title.replace(" strain", "")
        assert f"{short}, e_xy is the tensor shear" in sentence
        done = {each.format: each for each in export_dataset(dataset, tmp_path, ["csv", "vtk", "mat", "tiff"])}
    heading = (done["csv"].path / "step_001.csv").read_text("utf-8-sig").splitlines()[0].split(",")
    word = title.split(" ")[0]
    assert {f"e_xx [µstrain] {word}", f"e_xy [µstrain] {word} tensor shear", "sigma_e_xy [µstrain]"} <= set(heading)
    origins = [
        (done["csv"].path / "metadata.json").read_text("utf-8"),
        str(scipy.io.loadmat(done["mat"].path)["metadata"]),
        next(done["tiff"].path.glob("step_001_e_xy*.tif")).read_bytes().decode("latin-1"),
        str(pyvista.read(next(done["vtk"].path.glob("*_001.vtp"))).field_data["metadata"][0]),
    ]
    for origin in origins:
        assert f'"strain_measure": "{measure}"' in origin.replace("&quot;", '"')
        assert '"shear_strain": "tensor' in origin.replace("&quot;", '"')


def test_the_report_names_the_measure_of_the_strain(folder, tmp_path):
    files = [folder / "load_1.tif", folder / "load_10.tif"]
    measure_images(files, tmp_path / "a.nc", strain_measure="engineering")
    page = write_report(tmp_path / "a.nc", tmp_path / "a.html").read_text("utf-8")
    assert "engineering (U - 1, Biot) in the image, from least-squares planes; e_xy is the tensor shear" in page


def test_an_unknown_measure_of_a_dataset_is_one_sentence(dataset):
    with pytest.raises(DatasetError, match="'strain_measure' of the dataset is 'small': write one of green-lagrange"):
        dataset.assign_attrs(strain_measure="small").fringedic.strain(41)


@pytest.mark.parametrize(("scale", "unit"), [({"pixel_size": PIXEL}, "m"), ({}, "px")])
def test_rigid_motion_of_images_turns_about_their_middle(scale, unit):
    """Points that turn about the middle of the image, seen in a corner of it, have no translation."""
    angle, column, row = 0.02, np.arange(0, 80, 4), np.arange(0, 60, 4)
    x, y = np.meshgrid(column - 0.5 * (SIZE[1] - 1), 0.5 * (SIZE[0] - 1) - row)
    u, v = x * (np.cos(angle) - 1) - y * np.sin(angle), x * np.sin(angle) + y * (np.cos(angle) - 1)
    maps = {"displacement_x": (("row", "column"), u), "displacement_y": (("row", "column"), -v)}
    attributes = {"image_width": SIZE[1], "image_height": SIZE[0], **scale}
    turned = xr.Dataset(maps, {"row": row, "column": column}, attributes)
    rest = turned.fringedic.remove_rigid_motion()
    assert rest.translation.attrs["units"] == unit
    np.testing.assert_allclose(rest.translation, 0.0, atol=1e-9)
    np.testing.assert_allclose(rest.rotation, [0.0, 0.0, angle], atol=1e-9)
    gauge = turned.fringedic.extensometer((10, 10), (70, 50), subset=4)
    assert float(gauge.strain) == pytest.approx(0.0, abs=1e-12)
    assert float(gauge.length) == pytest.approx(np.hypot(60, 40) * scale.get("pixel_size", 1.0))


def test_images_in_memory_have_the_same_methods(folder):
    first, last = (cv2.imread(str(folder / f"load_{name}.tif"), cv2.IMREAD_UNCHANGED) for name in (1, 10))
    field = fringedic.measure_displacement(first, last, spacing=4)
    gauge = field.fringedic.extensometer((40, 75), (160, 75), subset=21)
    assert gauge.length.attrs["units"] == "px"
    assert float(gauge.strain) == pytest.approx(3 * STRAIN, abs=2e-4)
    assert float(flat_strain(field, window=41).e_xx.median()) == pytest.approx(3 * STRAIN, abs=2e-4)
    assert field.fringedic.plot("displacement_y").get_ylabel() == "row [px]"


def test_one_bad_image_does_not_end_the_series(folder, tmp_path):
    files = [folder / f"load_{name}.tif" for name in (1, 2, 9)]
    other = tmp_path / "other.tif"
    cv2.imwrite(str(other), stretched(speckle(99), 0, np.random.default_rng(2)))
    (tmp_path / "empty.tif").write_bytes(b"")
    series = measure_images([*files[:2], other, tmp_path / "empty.tif", files[2]], tmp_path / "a.nc")
    assert [image.step for image in series.failed] == [2, 3]
    assert "other.tif" in series.failed[0].error
    assert "empty.tif is not an image" in series.failed[1].error
    with fringedic.open_experiment(series.dataset) as dataset:
        assert [bool(error) for error in dataset.error.values] == [False, False, True, True, False]
        assert float(dataset.e_xx.sel(step=4).median()) == pytest.approx(2 * STRAIN, abs=2e-4)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["load_0.25", "load_0.5", "load_0"], "load_0.25.tif is before load_0.tif"),
        (["reference", "load_1", "load_10", "load_2"], "load_10.tif is before load_2.tif"),
        (["load_0", "load_0.25", "load_0.5"], ""),
        (["reference", "load_1", "load_2"], ""),
        (["load_2", "load_0", "load_1"], ""),  # somebody's own order
    ],
)
def test_alphabetical_order_that_differs_from_that_of_the_numbers_is_reported(names, words):
    files = [Path("images") / f"{name}.tif" for name in names]
    assert [sentence.split(",")[0] for sentence in order_sentences(files)] == ([f"order: {words}"] if words else [])


def test_an_image_of_another_size_is_named_with_both_sizes(folder, tmp_path):
    files = [folder / f"load_{name}.tif" for name in (1, 2)]
    small = tmp_path / "small.tif"
    cv2.imwrite(str(small), cv2.imread(str(files[1]), cv2.IMREAD_UNCHANGED)[:100, :120])
    series = measure_images([files[0], small, files[1]], tmp_path / "a.nc")
    assert [image.error for image in series.failed] == [
        f"{small} has 120x100 px, {files[0]} has 200x150 px: give images of one size"
    ]
    with pytest.raises(ImageError, match=r"small\.tif has 120x100 px"):
        measure_images([files[0], small], tmp_path / "b.nc")


def test_nothing_is_left_when_no_image_shows_the_surface(folder, tmp_path):
    other = tmp_path / "other.tif"
    cv2.imwrite(str(other), stretched(speckle(99), 0, np.random.default_rng(2)))
    with pytest.raises(CorrelationError, match=r"other\.tif: ") as refused:
        measure_images([folder / "load_1.tif", other], tmp_path / "a.nc")
    assert refused.value.code in (None, ErrorCode.NO_CORRELATION)
    assert [file.name for file in tmp_path.iterdir()] == ["other.tif"]


def test_interrupted_series_keeps_what_was_measured(folder, tmp_path):
    def stop(image, _count):
        if image.step == 2:
            raise KeyboardInterrupt

    series = measure_images([folder], tmp_path / "a.nc", progress=stop)
    assert series.interrupted
    with fringedic.open_experiment(series.dataset) as dataset:
        assert dataset.step.values.tolist() == [0, 1, 2]


def test_changing_surface_is_followed_by_increments(tmp_path):
    """The spots are exchanged little by little: the last image has nothing in common with the first one."""
    noise, old, new = np.random.default_rng(4), speckle(1), speckle(2)
    for number, angle in enumerate(np.linspace(0, np.pi / 2, 7)):
        mixed = 128 + np.cos(angle) * (old - 128) + np.sin(angle) * (new - 128)
        cv2.imwrite(str(tmp_path / f"image_{number}.tif"), stretched(mixed, number, noise))
    series = measure_images([tmp_path], tmp_path / "a.nc")
    assert [image.error for image in series.failed] == []
    assert series.images[1].increment_from == ""
    assert series.images[-1].increment_from.startswith("image_")
    with fringedic.open_experiment(series.dataset) as dataset:
        # the new spots are noise to the old ones: a sixth of the contrast is exchanged per image
        assert float(dataset.e_xx.sel(step=6).median()) == pytest.approx(6 * STRAIN + 18 * STRAIN**2, rel=0.15)
        assert float(dataset.displacement_sigma_x.sel(step=6).median()) > 2 * float(
            dataset.displacement_sigma_x.sel(step=1).median()
        )


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"window": 4}, DatasetError, "window is 4: it has to be a whole number from 8 to 256"),
        ({"pixel_size": 0.0}, DatasetError, "pixel_size is 0.0"),
        ({"mask": np.ones((3, 3), bool)}, ImageError, "the mask has 3x3 px, the images have 200x150 px"),
        ({"output": "a.txt"}, DatasetError, "is named .nc"),
        (
            {"strain_measure": "small"},
            DatasetError,
            "strain_measure is 'small': it has to be one of green-lagrange, logarithmic, engineering",
        ),
    ],
)
def test_wrong_options_are_one_sentence(folder, tmp_path, monkeypatch, options, error, words):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=words):
        measure_images([folder], **{"output": "a.nc"} | options)
    assert not list(tmp_path.iterdir())


def test_mask_limits_the_measured_surface(folder, tmp_path):
    mask = np.zeros(SIZE, bool)
    mask[40:120, 50:150] = True
    series = measure_images([folder], tmp_path / "a.nc", mask=mask)
    with fringedic.open_experiment(series.dataset) as dataset:
        measured = np.isfinite(dataset.displacement_x.sel(step=3))
        assert not measured.sel(row=slice(0, 36)).any()
        assert dataset.valid_fraction.values.min() > 0.8
        assert json.loads(dataset.attrs["parameters"])[-1]["parameters"]["strain"]["strain_window_px"] == 41


def sentences_of(series):
    with fringedic.open_experiment(series.dataset) as dataset:
        return dataset.load(), "\n".join(series_sentences(series, dataset))


def test_copies_of_an_image_are_named(folder, tmp_path):
    """A copy of the reference has no displacement and is confirmed everywhere."""
    first, second = ((folder / f"load_{name}.tif").read_bytes() for name in (1, 2))
    for name, content in (("0", first), ("1", first), ("2", second), ("3", second)):
        (tmp_path / f"image_{name}.tif").write_bytes(content)
    series = measure_images([tmp_path], tmp_path / "a.nc")
    dataset, words = sentences_of(series)
    assert [[(each.code, each.values) for each in image.remarks] for image in series.images] == [
        [],
        [("duplicate", {"step": 0})],
        [],
        [("duplicate", {"step": 2})],
    ]
    assert [json.loads(text or "[]") for text in dataset.remarks.values] == [
        [],
        [{"code": "duplicate", "step": 0}],
        [],
        [{"code": "duplicate", "step": 2}],
    ]
    assert float(dataset.confirmed_fraction[1]) == 1.0
    assert abs(dataset.displacement_x.sel(step=1)).max() < 1e-3
    assert "image_1.tif is identical to image_0.tif" in words
    assert "image_3.tif is identical to image_2.tif" in words


def test_an_image_that_is_refused_is_told_to_be_saturated(folder, tmp_path):
    first, second = (cv2.imread(str(folder / f"load_{name}.tif"), cv2.IMREAD_UNCHANGED) for name in (1, 2))
    white = np.clip(40 + 20 * (second.astype(float) - 70), 0, 255).astype(np.uint8)
    for name, image in (("0", first), ("1", second), ("2", white)):
        cv2.imwrite(str(tmp_path / f"image_{name}.tif"), image)
    series = measure_images([tmp_path], tmp_path / "a.nc")
    _, words = sentences_of(series)
    assert [image.name for image in series.failed] == ["image_2.tif"]
    assert [each.code for each in series.failed[0].remarks] == ["saturated"]
    assert "% of the pixels of image_2.tif are at the lowest or highest grey level" in words


def test_saturation_is_told_with_its_share(folder, tmp_path):
    first, last = (cv2.imread(str(folder / f"load_{name}.tif"), cv2.IMREAD_UNCHANGED) for name in (1, 2))
    overexposed = np.clip(100 + 1.2 * last.astype(float), 0, 255).astype(np.uint8)
    share = float(np.mean((overexposed == 255) | (overexposed == overexposed.min())))
    assert share > 0.4
    for name, image in (("0", first), ("1", overexposed)):
        cv2.imwrite(str(tmp_path / f"image_{name}.tif"), image)
    series = measure_images([tmp_path], tmp_path / "a.nc")
    _, words = sentences_of(series)
    assert series.images[1].remarks[0].code == "saturated"
    assert series.images[1].remarks[0].values["share"] == pytest.approx(share)
    assert f"saturated: {100 * share:.1f} % of the pixels of image_1.tif" in words


@pytest.mark.parametrize("gains", [((0.6, 1.0), (1.0, 0.7)), ((1.0, 0.5), (0.4, 1.0))])
def test_a_colour_mosaic_is_detected(tmp_path, gains):
    """The pixels of a colour sensor, green on a diagonal: without smoothing the filters are a texture that rests."""
    noise, texture = np.random.default_rng(4), speckle()
    for number in (0, 1):
        grey = np.tile(gains, (SIZE[0] // 2, SIZE[1] // 2)) * stretched(texture, number, noise)
        cv2.imwrite(str(tmp_path / f"image_{number}.tif"), np.rint(grey).astype(np.uint8))
    series = measure_images([tmp_path], tmp_path / "a.nc")
    dataset, words = sentences_of(series)
    assert [each.code for each in series.images[0].remarks] == ["mosaic"]
    assert "colour mosaic: image_0.tif" in words
    last = inner(dataset.sel(step=1))
    error = last.displacement_x - last.column * STRAIN
    assert float(np.sqrt((error**2).mean())) < 0.02
    assert 0.8 < float(np.sqrt(((error / last.displacement_sigma_x) ** 2).mean())) < 1.3


def test_grey_images_contain_no_mosaic():
    """Noise, textures of all widths, a ramp, printed grids of 4 and 12 px, and compression."""
    generator = np.random.default_rng(8)
    row, column = np.mgrid[:240, :320]
    looks = [128 + 40 * texture / texture.std() for texture in _textures(generator)]
    looks += [0.5 * column + 0.2 * row, *(200.0 * ((row % p < p / 3) & (column % p < p / 3)) for p in (4, 12))]
    for look in looks:
        grey = np.clip(look + generator.normal(0, 1, look.shape), 0, 255).astype(np.uint8)
        assert not has_mosaic(grey)
        assert not has_mosaic(cv2.imdecode(cv2.imencode(".jpg", grey)[1], cv2.IMREAD_GRAYSCALE))
        assert has_mosaic(grey * np.tile([[0.8, 1.0], [1.0, 0.85]], (120, 160)))


def _textures(generator):
    return [gaussian_filter(generator.normal(size=(240, 320)), width) for width in (0.01, 0.5, 1.0, 2.0, 5.0)]


def test_points_beside_an_occluder_are_not_valid(tmp_path):
    """A dark cable in front of the stretched surface moves: beside it, points and strain are NaN."""
    noise, texture = np.random.default_rng(4), speckle()
    for number, cable in ((0, 90), (1, 96)):
        image = stretched(texture, 3 * number, noise)
        image[:, cable : cable + 18] = 25
        image[:, cable + 4 : cable + 7] = 90
        cv2.imwrite(str(tmp_path / f"image_{number}.tif"), image)
    series = measure_images([tmp_path], tmp_path / "a.nc", strain_window=21)
    dataset, words = sentences_of(series)
    last = dataset.sel(step=1)
    refuted = float(last.refuted_fraction)
    assert refuted > 0.005
    assert f"{100 * refuted:.2f} % of the measured points" in words
    error = abs(last.displacement_x - last.column * 3 * STRAIN)
    assert float((error > 5 * last.displacement_sigma_x).sum() / error.count()) < 0.005
    lost = np.isnan(last.displacement_x) & np.isfinite(last.displacement_closure_x)
    assert lost.any()
    assert not lost.where(abs(last.column - 102) > 12 + 48, drop=True).any()  # a window and a half from the cable
    assert np.isnan(last.e_xx.values[lost.values]).all()
    assert float(last.valid_fraction) == pytest.approx(float(np.isfinite(last.displacement_x).mean()))


def test_a_fabric_is_followed_beyond_its_period(tmp_path):
    """Small steps add up to more than half a period: the count is kept, and what is not certain is told."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    generator = np.random.default_rng(8)
    for step in range(6):
        woven = 120 + 40 * (np.cos(2 * np.pi * (x - 3 * step) / 12) + np.cos(2 * np.pi * y / 12))
        cv2.imwrite(str(tmp_path / f"{step}.png"), np.rint(woven + generator.normal(0, 1.5, SIZE)))
    series = measure_images([tmp_path], tmp_path / "fabric.nc")
    with fringedic.open_experiment(series.dataset) as dataset:
        moved = dataset["displacement_x"].median(("row", "column")).values
        sentences = list(series_sentences(series, dataset))
    np.testing.assert_allclose(moved, 3.0 * np.arange(6), atol=0.02)
    assert any(each.startswith("periodic: the texture repeats every 12.0 px") for each in sentences)


def test_a_folder_without_images_is_named(tmp_path):
    with pytest.raises(ImageError, match="contains no images"):
        measure_images([tmp_path], tmp_path / "a.nc")
