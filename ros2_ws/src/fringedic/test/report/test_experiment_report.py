"""The report: noise floors against known noise, what it says, what it names as missing, and that it needs no net."""

import base64
import io
import json
import re

import numpy as np
import pytest
import xarray as xr
from aligned_rig import aligned_rig
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from fringedic.datasets import open_experiment
from fringedic.datasets.attributes import sensor_of
from fringedic.datasets.rows import Row
from fringedic.datasets.writer import DatasetWriter
from fringedic.errors import DatasetError
from fringedic.evaluation.noise_floor import check_static_steps, noise_floors, static_steps
from fringedic.figures.animation import save_animation
from fringedic.figures.charts import curve_charts, extensometer_charts
from fringedic.figures.maps import map_figure, scale_between
from fringedic.figures.panels import Panel
from fringedic.metadata import Metadata
from fringedic.report import write_report
from fringedic.report.data import ReportData
from fringedic.report.entries import hardware_entries, specimen_entries
from fringedic.report.experiment import _recording
from fringedic.report.processing_entries import analysis_entries, base_and_angle, fringe_entries
from fringedic.report.tables import step_columns
from fringedic.report.warnings import warnings
from fringedic.signals import SignalValue, signals_of
from fringedic.steps.parameters import CouplingParameters, DicParameters, PhaseParameters
from fringedic.steps.recorded_parameters import StepSettings

ROWS, COLUMNS, SPACING, PIXEL = 40, 60, 2, 100e-6
START = 1_700_000_000_000_000_000
NOISE = {"u": 0.4e-6, "v": 0.3e-6, "w": 8e-6}  # of one step; the reference has as much
STRAIN_NOISE, BIAS = 20e-6, 2e-6  # of e_11; of w [m]
RIG = aligned_rig(
    (120, 80), PIXEL, (100, 75), 400.0, projector_position=(-0.3, 0.0, 0.4), identifier="bench 3", source="planes"
)
METADATA = (
    "specimen: {name: sheet 4, section_mm2: 10.0, operator: Ada & Bob}\nhardware: {lens: 'Maker 35 mm', aperture: f/8}"
)


def maps(step, generator, reference):
    row, column = np.mgrid[:ROWS, :COLUMNS].astype(float)
    x, y = PIXEL * SPACING * (column - 30), -PIXEL * SPACING * (row - 20)
    load = max(step - 2, 0)
    values = {"x": x, "y": y, "z": 0.2 * x, "e_12": 0 * x, "displacement_x": 0 * x, "displacement_y": 0 * x}
    values |= {"u": -1e-3 * load * x, "v": 3e-3 * load * (y + 4e-3), "w": 5e-6 * load + 0 * x}
    for name, sigma in NOISE.items():
        # the reference step measures itself: its displacement is exactly zero
        noise = generator.normal(0, sigma, x.shape) - reference[name]
        values[name] = values[name] + noise if step else 0 * x
        values[f"sigma_{name}"] = 0 * x + np.sqrt(2) * sigma
    if step:
        values["w"] = values["w"] + BIAS
    values["e_11"] = -1e-3 * load + generator.normal(0, STRAIN_NOISE, x.shape) * (step > 0)
    values["e_22"] = 3e-3 * load + 0 * x
    values |= {"shape_z": values["z"] + values["w"], "phase_sigma": 0 * x + 0.012, "texture": 0 * x + 90}
    values["u"][:, :5] = np.nan
    return {name: each.astype(np.float32) for name, each in values.items()}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    file = tmp_path_factory.mktemp("report") / "sheet.nc"
    parameters = {
        "phase": PhaseParameters(minimum_modulation_grey_level=4.0),
        "dic": DicParameters(spacing=SPACING, window=24),
        "coupling": CouplingParameters(strain_window_px=41),
    }
    rig = {"camera": {"source": "files", "exposure_time_s": 0.01}}
    settings = StepSettings(parameters, RIG, rig, Metadata.from_text(METADATA))
    generator = np.random.default_rng(5)
    reference = {name: generator.normal(0, sigma, (ROWS, COLUMNS)) for name, sigma in NOISE.items()}
    with DatasetWriter(file, {"experiment": "sheet <4>", "source": "bag"}) as writer:
        writer.add_signals(signals_of([]).values())
        for step, position in enumerate((0.0, 0.3e-6, 0.0, 1e-4, 2e-4)):
            stamp = START + step * 10**9
            row = Row(step, stamp, "", 0, 3 if step == 4 else 0, 0.9, 1e-5 * step, maps(step, generator, reference))
            row.signals = {"force": SignalValue(20.0 * step), "position": SignalValue(position)}
            writer.add(row, settings)
        failed = Row(5, START + 5 * 10**9, "frame 3 of 8 <never> arrived", signals={"position": SignalValue(0.0)})
        writer.add(failed, settings)
    return file


@pytest.fixture(scope="module")
def dataset(path):
    with open_experiment(path) as opened:
        yield opened


@pytest.fixture(scope="module")
def page(path):
    gauges = {"1": ((60, 20), (60, 60)), "far": ((60, 20), (500, 20))}
    return write_report(path, gauges=gauges).read_text("utf-8")


def test_extensometers(page):
    """v = 3e-3 (y + 4 mm) per step of load along y, and along z as much as w is uneven there: not at all."""
    assert "Stress over their strain" in page
    row = re.search(r"<td>1: \(60, 20\) to \(60, 60\)</td>(.*?)</tr>", page).group(1)
    length, _, strain, sigma = (float(each) for each in re.findall(r">([-\d.e]+)(?: mm| µm)?<", row))
    # the centres of the gauge subsets are 40 px apart
    assert length == pytest.approx(4.0, abs=0.01)
    assert abs(strain - 6000) < 5 * sigma, f"{strain} +- {sigma} µm/m, 6000 are true"
    assert 0 < sigma < 300
    assert "extensometer far: (60, 20) to (500, 20) px: the point" in page


def test_steps_at_rest_are_those_beside_the_reference(dataset):
    assert static_steps(dataset) == [1, 2], "step 5 came back to the position after the test"
    assert static_steps(dataset.assign(position=dataset.position * np.nan)) == []
    itself = dataset.assign(rms_displacement=dataset.rms_displacement.where(dataset.step != 1, 0.0))
    assert static_steps(itself) == [2], "step 1 was compared with itself"
    later = dataset.assign(
        reference_step=dataset.reference_step.where(dataset.reference_step < 0, 2),
        rms_displacement=dataset.rms_displacement + 1e-6,
    )
    assert static_steps(later) == [0, 1]
    changed = later.assign(reference_step=later.reference_step.where(later.step != 1, 1))
    assert static_steps(changed) == [0], "a step that is its own reference has no noise"


def test_noise_floors_are_those_of_the_known_noise(dataset):
    floors = {floor.name: floor for floor in noise_floors(dataset, [1, 2])}
    points = ROWS * (COLUMNS - 5)
    assert floors["u"].points == points
    assert floors["w"].points == ROWS * COLUMNS
    for name, sigma in NOISE.items():
        spread = 4 / np.sqrt(2 * floors[name].points)  # four standard errors
        assert floors[name].spatial == pytest.approx(np.sqrt(2) * sigma, rel=spread), name
        assert floors[name].temporal == pytest.approx(sigma, rel=1.5 * spread), name
        assert floors[name].predicted == pytest.approx(np.sqrt(2) * sigma, rel=1e-5)
    assert floors["w"].bias == pytest.approx(BIAS, abs=4 * NOISE["w"] * np.sqrt(1.5 / (ROWS * COLUMNS)))
    assert floors["e_11"].spatial == pytest.approx(STRAIN_NOISE, rel=0.06)
    assert np.isnan(floors["e_11"].predicted)
    assert np.isnan(noise_floors(dataset, [1])[0].temporal)
    assert noise_floors(dataset, []) == []


def test_steps_that_a_person_names_as_at_rest_are_checked(dataset, path, tmp_path):
    assert check_static_steps(dataset, [0, 2, 1, 2]) == [1, 2], "step 0 is the reference: its displacement is 0"
    both = [write_report(path, tmp_path / f"{len(steps)}.html", static_steps=steps) for steps in ([1, 2], [0, 1, 2])]
    floors = [re.search(r"<td>w \[µm\]</td>.*?</tr>", page.read_text("utf-8")) for page in both]
    assert floors[0].group() == floors[1].group()
    with pytest.raises(DatasetError, match="no displacement of step 5 to take the noise from: name steps that were"):
        write_report(path, tmp_path / "x.html", static_steps=[1, 5])
    failed = dataset.assign(error=dataset["error"].where(dataset.step != 2, "step 2: no surface"))
    with pytest.raises(DatasetError, match="no displacement of step 2"):
        check_static_steps(failed, [1, 2])
    later = dataset.assign(reference_step=dataset.reference_step.where(dataset.step < 3, 3))
    with pytest.raises(DatasetError, match="steps 1, 3 are relative to steps 0, 3: name steps at rest of one"):
        check_static_steps(later, [1, 3])
    with pytest.raises(DatasetError, match="no step 8, 9 to take the noise from"):
        check_static_steps(dataset, [9, 1, 8])
    assert check_static_steps(dataset, []) == []


def test_steps_at_rest_whose_reference_is_not_in_the_dataset(dataset, tmp_path):
    """The texture of the reference cannot be looked for, and the recording beside the dataset cannot be read."""
    (tmp_path / "bag").mkdir()
    dataset.sel(step=[1, 2, 3]).to_netcdf(tmp_path / "part.nc", engine="h5netcdf")
    page = write_report(tmp_path / "part.nc", static_steps=[1, 2]).read_text("utf-8")
    assert "<td>w [µm]</td>" in page
    assert "the recording cannot be read: " in page


def test_curves_and_warnings_tell_that_the_reference_changes(dataset):
    changed = dataset.assign(reference_step=dataset.reference_step.where((dataset.step < 3) | (dataset.step > 4), 3))
    sentence = "displacements are relative to steps 0, 3: 'fringedic process --reference 0' measures all"
    assert [sentence in "".join(warnings(ReportData(each, None, None), [], [])) for each in (dataset, changed)] == [
        False,
        True,
    ]
    gauge = xr.Dataset({"strain": ("step", np.arange(6.0)), "sigma_strain": ("step", np.ones(6))})
    charts = curve_charts(changed, 1e-5) + extensometer_charts(changed, {"1": gauge}, 1e-5)
    curves = {chart.layout.title.text: chart.data[0] for chart in charts}
    for title in ("Median displacement", "Median strain", "Virtual extensometers"):
        np.testing.assert_array_equal(curves[title].x, [0, 1, 2, np.nan, 3, 4, 5], title)
    for title in ("Stress over strain", "Stress over their strain"):
        assert np.isnan([curves[title].x[3], curves[title].y[3]]).all(), title
        assert np.isfinite([curves[title].x[4], curves[title].y[4]]).all(), title
    assert len(curves["Virtual extensometers"].error_y.array) == 7
    assert len(curves["Force over crosshead position"].x) == 6, "force and position have no reference step"


def test_further_signals_have_curves_with_their_uncertainty_and_can_be_chosen_for_the_axes(dataset):
    """Also in the joined dataset of several sensors, whose signals are those of one of them."""
    steps = dataset.sizes["step"]
    torque, sigma = np.linspace(0.0, 25.0, steps), np.full(steps, 0.5)
    about = {"units": "N m", "quantity": "torque"}
    known = {"torque": ("step", torque, about), "torque_sigma": ("step", sigma, {"units": "N m"})}
    charts = {each.layout.title.text: each for each in curve_charts(dataset.assign(known), 1e-5)}
    np.testing.assert_array_equal(charts["torque"].data[0].y, torque)
    np.testing.assert_array_equal(charts["torque"].data[0].error_y.array, sigma)
    assert charts["torque"].layout.yaxis.title.text == "torque [N m]"
    chosen = charts["Any quantity over any other"]
    assert chosen.layout.yaxis.title.text == "torque [N m]"
    labels = [[button.label for button in menu.buttons] for menu in chosen.layout.updatemenus]
    for axis, found in zip("xy", labels, strict=True):
        assert {f"{axis}: {each}" for each in ("step", "force [N]", "position [mm]", "torque [N m]")} <= set(found)
        assert any(each.startswith(f"{axis}: median e_") for each in found)
    across = next(each for each in chosen.layout.updatemenus[0].buttons if each.label == "x: torque [N m]")
    assert list(across.args[0]["x"][0]) == torque.tolist()
    assert across.args[1] == {"xaxis.title.text": "torque [N m]"}
    without = {each.layout.title.text for each in curve_charts(dataset, 1e-5)}
    assert not {"torque", "Any quantity over any other"} & without


def test_a_drift_that_is_rounding_is_written_as_zero(dataset):
    steps = dataset.sizes["step"]
    drift = np.full(steps, 2e-9)
    drift[:2] = -2.661e-19, 3e-19  # of samples that are all the same
    changed = dataset.assign(position_drift=("step", drift, {"units": "m"}))
    [column] = [each for each in step_columns(changed) if each.heading.startswith("drift of position")]
    assert column.cells == ["0", "0", *["0.002"] * (steps - 2)]


def test_conditions_are_known_or_named_as_missing(dataset):
    data = ReportData(dataset, None, None)
    listed = [*specimen_entries(data), *hardware_entries(data), *analysis_entries(data), *fringe_entries(data)]
    values = {entry.name: entry.value for entry in listed}
    assert values["field of view"] == "12 x 8 mm"
    assert values["image scale"] == "10 px/mm (100 µm/px)"
    assert values["stand-off"] == "400 mm"
    assert values["exposure time"] == "10 ms"
    assert values["subset"] == "24 px (2.4 mm)"
    assert values["step (spacing)"] == "2 px (0.2 mm)"
    # (21 - 1) x 2 + 24
    assert values["strain window"] == "21 points (40 px) (4 mm)"
    assert values["virtual strain gauge"] == "64 px (6.4 mm)"
    assert values["base camera to projector"] == "300 mm"
    assert values["angle between camera and projector"] == "36.87°"
    assert values["phase noise"] == "12 mrad"
    assert values["modulation threshold"].startswith("4 grey levels")
    assert (values["operator"], values["lens"], values["aperture"]) == ("Ada & Bob", "Maker 35 mm", "f/8")
    assert "attached files" not in values
    attached = ReportData(dataset.assign_attrs(attachments=json.dumps({"machine.csv": 64 * "a"})), None, None)
    entries = {entry.name: entry.value for entry in analysis_entries(attached)}
    assert entries["attached files"] == f"machine.csv (description: SHA-256 {12 * 'a'}...)"
    unknown = {entry.name for entry in listed if entry.value is None}
    assert unknown >= {
        *("camera", "focal length", "filters", "calibration target", "patterning technique", "feature size"),
        *("image noise", "projector", "pitches", "acquisition rate", "plane residual", "known-distance check"),
    }
    notes = {entry.name: entry.note for entry in listed}
    assert notes["filters"] == "enter hardware.filters in the rig file"


def test_the_calibration_tells_its_date_and_residual_when_they_were_recorded(dataset):
    metadata = json.loads(dataset.facts)
    metadata["calibration"] = {
        "created": "2023-11-14T20:13:20+00:00",
        "residual_um": 6.5,
        "predicted_um": 6.25,
        "verdict": "go",
    }
    data = ReportData(dataset.assign_attrs(facts=json.dumps(metadata)), None, None)
    listed = {entry.name: entry for entry in fringe_entries(data)}
    assert listed["plane residual"].value == "6.5 µm RMS"
    assert "6.25 µm" in listed["plane residual"].note
    assert listed["date of the calibration"].value == "2023-11-14 20:13 UTC"
    assert listed["date of the calibration"].note == "2.0 hours before the test"
    assert listed["calibration"].note == "go"


def test_base_and_angle_are_those_of_the_pin_holes():
    base, angle = base_and_angle({"camera_distance": 0.3, "projector_position": (0.3, 0.0, 0.3)})
    assert base == pytest.approx(0.3)
    assert np.degrees(angle) == pytest.approx(45)


def test_the_page_says_everything_and_needs_no_network(page):
    for word in ("sheet &lt;4&gt;", "Ada &amp; Bob", "bench 3, from planes", "Green-Lagrange", "quintic B-spline"):
        assert word in page, word
    assert "<li>step 5: frame 3 of 8 &lt;never&gt; arrived</li>" in page
    assert "step 4 could not be compared with the reference step; increments were summed" in page
    cells = [re.findall("<td[^>]*>([^<]*)</td>", row) for row in page.split('id="steps"')[1].splitlines()]
    assert [row[7:9] for row in cells if len(row) == 10] == [["0", "0"]] * 4 + [["0", "3"], ["-", "-"]]
    assert "10.58720/idics/gpg.ed2" in page
    assert "Conformity is not claimed" in page
    assert "simulated" not in page.split("</style>")[1].split("<script")[0]
    text = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert not re.search(r"<(script|link|img|iframe)[^>]+(src|href)=[\"']?(https?:)?//", page), "loads from the network"
    assert re.findall(r"<img[^>]+src=\"(data:image/\w+);base64", text) == ["data:image/png"] * (4 + 5 + 1)
    assert len(page) < 15e6
    assert (
        page.count('class="plotly-graph-div"') == 7
    )  # surface, displacement, strain, force, stress; extensometers: strain, stress


def test_the_charts_show_the_numbers_of_the_dataset(page):
    charts = re.findall(r'Plotly\.newPlot\(\s*"[^"]+",\s*(\[.*?\]),\s*\{"', page, flags=re.DOTALL)
    curves = [trace for chart in charts for trace in json.loads(chart)]
    w = next(trace for trace in curves if trace.get("name") == "w")
    assert w["x"] == [0, 1, 2, 3, 4, 5]
    assert w["y"][5] is None
    assert w["y"][4] == pytest.approx(10 + BIAS * 1e6, abs=1)  # µm
    stress = next(trace for trace in curves if trace.get("name") == "stress [MPa]")
    assert stress["y"][4] == pytest.approx(80 / 10)  # N / mm²
    assert stress["x"][4] == pytest.approx(6000, rel=1e-3)  # µm/m


def test_the_moving_picture_has_one_frame_per_measured_step(dataset, tmp_path):
    panel = Panel("w", "displacement w")
    file = save_animation(dataset, tmp_path / "w.gif", panel)
    with Image.open(file) as picture:
        assert picture.n_frames == 5
        picture.seek(4)
        seen = np.asarray(picture.convert("RGB")).astype(float)
    ends = [np.nanpercentile(dataset.w.sel(step=step), (0.5, 99.5)) for step in range(5)]
    scale = scale_between(dataset.w, min(low for low, _ in ends), max(high for _, high in ends))
    drawn = FigureCanvasAgg(map_figure(dataset.sel(step=4), panel, scale, title="step 4: displacement w"))
    drawn.draw()
    difference = np.abs(seen - np.asarray(drawn.buffer_rgba())[..., :3])
    assert np.percentile(difference, 90) < 4, "another picture, or contours that the map does not have"
    with pytest.raises(DatasetError, match="no step has the map nothing"):
        save_animation(dataset, tmp_path / "x.gif", Panel("nothing", ""))


def test_the_page_shows_the_last_step_of_its_moving_picture_until_the_slider_moves(page):
    player = page.split('<figure class="player"')[1].split("</figure>")[0]
    frames = re.findall(r"<img [^>]*base64,([^\"]+)\"( hidden)?>", player)
    assert [bool(hidden) for _, hidden in frames] == [True] * 4 + [False]
    assert 'max="4" value="4"' in player
    pictures = [Image.open(io.BytesIO(base64.b64decode(data))) for data, _ in frames]
    assert len({picture.size for picture in pictures}) == 1
    assert len({picture.tobytes() for picture in pictures}) == 5


@pytest.mark.parametrize(
    "name", ["reference_step", "valid_fraction", "rms_displacement", "position", "displacement_x", "u"]
)
def test_a_dataset_without_a_variable_that_a_report_needs_is_refused(dataset, tmp_path, name):
    dataset.drop_vars(name).to_netcdf(tmp_path / "part.nc", engine="h5netcdf")
    with pytest.raises(DatasetError, match=rf"part\.nc: has no {name}, which a report needs; give the whole dataset"):
        write_report(tmp_path / "part.nc")


@pytest.mark.usefixtures("page")
def test_a_report_is_not_overwritten_unasked_and_unwritable_places_are_named(path, tmp_path):
    with pytest.raises(DatasetError, match=r"report\.html exists already"):
        write_report(path)
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(DatasetError, match="cannot be written"):
        write_report(path, tmp_path / "file" / "report.html")
    with pytest.raises(DatasetError, match="no step 9"):
        write_report(path, tmp_path / "x.html", static_steps=[9])
    bare = write_report(path, tmp_path / "bare.html", static_steps=[]).read_text("utf-8")
    assert "the noise floor is not measured" in bare
    assert '<p class="missing">not measured</p>' in bare


@pytest.mark.parametrize("source", ["../bag", "/", "..", "a\0b", "x" * 5000, 7])
def test_recording_of_a_dataset_is_looked_for_by_its_name_alone(dataset, tmp_path, source):
    (tmp_path / "sheet.nc").write_bytes(b"")
    (tmp_path / "bag").mkdir()
    assert _recording(tmp_path / "sheet.nc", dataset.assign_attrs(source=source)) is None
    assert _recording(tmp_path / "sheet.nc", dataset.assign_attrs(source="bag")) == tmp_path / "bag"


@pytest.mark.parametrize("sensor", ["../left", "", 7])
def test_sensor_of_a_dataset_is_a_name(dataset, sensor):
    with pytest.raises(DatasetError, match=r"sensor of the dataset is .* letters, digits and single underscores"):
        sensor_of(dataset.assign_attrs(sensor=sensor))
