"""From recorded frames to a dataset: the desk command against the nodes' own messages, and against the truth."""

import json
import os
import shutil
import subprocess
import sys
import textwrap
from dataclasses import asdict
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from mcap.reader import make_reader
from pydantic import BaseModel
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.ndimage import gaussian_filter

from fringedic.campaign.recordings import fingerprint
from fringedic.configuration.rig_file import RigFile
from fringedic.configuration.virtual_calibration import calibration_of
from fringedic.datasets import MAPS, dataset_from_derived, open_experiment, process_bag
from fringedic.datasets.derived import Collected
from fringedic.datasets.quantities import SCALARS, STEP_NUMBERS
from fringedic.datasets.rows import Row, with_lost_steps
from fringedic.datasets.sentences import confirmation_sentence, references_sentence
from fringedic.datasets.signals import signal_names, signal_series
from fringedic.datasets.writer import DatasetWriter
from fringedic.errors import ConfigurationError, DatasetError, RecordingError
from fringedic.evaluation import compare_with_truth, truth_errors
from fringedic.frames.collector import Stack
from fringedic.frames.records import FrameRecord, stamp_of
from fringedic.frames.region import Region
from fringedic.metadata import Metadata
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.patterns.render import render_pattern
from fringedic.recording.earlier_versions import translate
from fringedic.recording.frames import records
from fringedic.recording.reader import BagReader
from fringedic.recording.topics import Topic
from fringedic.recording.writer import BagWriter
from fringedic.report.tables import step_columns
from fringedic.signals import Channel, Signal, attach, remove_attachment
from fringedic.steps.displacement_tracker import DisplacementTracker, white_texture
from fringedic.steps.parameters import CouplingParameters, DicParameters, PhaseParameters
from fringedic.steps.phase import phase_step
from fringedic.steps.recorded_parameters import StepSettings
from fringedic.steps.shape_tracker import ShapeTracker
from fringedic.steps.step_results import STRAIN_FIELDS
from fringedic.surface import surface_strain
from fringedic.virtual_rig import VirtualRig

RECORDED = Path(__file__).parents[1] / "recordings" / "version_0_1" / "bag"
MESSAGES = Path(__file__).parents[3] / "fringedic_msgs" / "msg"
RAW = {
    "camera/image_raw": "sensor_msgs/msg/Image",
    "camera/exposure": "fringedic_msgs/msg/Exposure",
    "experiment/step": "fringedic_msgs/msg/StepStatus",
    "experiment/reference": "fringedic_msgs/msg/Reference",
    "calibration": "fringedic_msgs/msg/RigCalibration",
    "node_parameters": "fringedic_msgs/msg/NodeParameters",
    "load_frame/state": "fringedic_msgs/msg/LoadState",
    "signals": "fringedic_msgs/msg/Signal",
}
DERIVED = {
    **{f"phase/{name}": "sensor_msgs/msg/Image" for name in ("map", "sigma", "modulation", "texture")},
    **{f"dic/{name}": "sensor_msgs/msg/Image" for name in ("displacement", "sigma")},
    **{f"coupling/{name}": "sensor_msgs/msg/PointCloud2" for name in ("shape", "displacement")},
    **{f"{node}/status": "fringedic_msgs/msg/NodeStatus" for node in ("phase", "dic", "coupling")},
}
POSITIONS = (0.0, 0.3e-3, 0.6e-3, 0.9e-3)  # [m]
SPACING = 2
START = 1_700_000_000_000_000_000  # [ns]


class ExperimentParameters(BaseModel):
    """What the experiment node records of itself, in part."""

    shifts: int = 4
    facts: str = ""


@cache
def interfaces():
    """The types of all messages, and the topics of a rig."""
    store = get_typestore(Stores.ROS2_JAZZY)
    own = {each for each in (RAW | DERIVED).values() if each.startswith("fringedic_msgs")}
    for type_name in sorted(own | {"fringedic_msgs/msg/Correction", "fringedic_msgs/msg/Remark"}):
        definition = (MESSAGES / f"{type_name.rsplit('/', 1)[1]}.msg").read_text()
        store.register(get_types_from_msg(definition, type_name))
    topics = []
    for topic, type_name in (RAW | DERIVED).items():
        definition, _ = store.generate_msgdef(type_name, ros_version=2)
        topics.append(Topic(f"/rig/{topic}", type_name, definition, "ros2msg", store.hash_rihs01(type_name), ""))
    return store, topics


class Bench:
    """A recording in the making: the virtual rig, the messages, and the chain as the nodes run it."""

    def __init__(self, path):
        self.store, topics = interfaces()
        rig_file = RigFile(
            camera={"source": "virtual"},
            projector={},
            virtual_rig={"preset": "plate", "size": "tiny"},
            calibration="virtual_rig",
            load_frame={},
        )
        self.rig = VirtualRig(rig_file.virtual_configuration())
        self.calibration = calibration_of(rig_file.virtual_configuration())
        self.patterns = rig_file.patterns()
        self.writer = BagWriter(path)
        for topic in topics:
            self.writer.add_recorded_topic(topic)
        self.now = START
        self.frame = 0
        self.logged = {}
        self.displacement = DisplacementTracker(DicParameters(spacing=SPACING, window=24))
        self.shape = ShapeTracker(CouplingParameters(strain_window_px=25))
        self.shape.set_calibration(self.calibration)

    def make(self, type_name, stamp=0, **values):
        """A message with zeros where nothing is given."""
        types = self.store.types
        seconds, nanoseconds = divmod(stamp, 1_000_000_000)
        time = types["builtin_interfaces/msg/Time"](seconds, nanoseconds)
        header = types["std_msgs/msg/Header"](time, "")
        zeros = {1: {"string": ""}, 3: np.zeros(0), 4: np.zeros(0)}
        fields = {}
        for name, (kind, detail) in self.store.fielddefs[type_name][1]:
            if name == "header":
                fields[name] = header
            elif name in values:
                fields[name] = values[name]
            elif int(kind) == 1:
                fields[name] = "" if detail[0] == "string" else 0
            else:
                fields[name] = zeros[int(kind)]
        return types[type_name](**fields)

    def thermocouple(self, stamp, temperature):
        about = {"name": "temperature_grip", "quantity": "temperature", "unit": "K", "source": "thermocouple"}
        time = self.store.types["builtin_interfaces/msg/Time"](*divmod(stamp, 1_000_000_000))
        values = {"stamps": [time], "values": np.array([temperature]), "sigmas": np.array([0.5])}
        self.write("signals", stamp, **about, **values)

    def write(self, topic, stamp=0, **values):
        type_name = (RAW | DERIVED)[topic]
        message = self.make(type_name, stamp, **values)
        self.now += 1_000_000
        data = bytes(self.store.serialize_cdr(message, type_name))
        self.writer.write(f"/rig/{topic}", data, self.now, self.now)

    def image(self, topic, stamp, pixels):
        channels = 1 if pixels.ndim == 2 else pixels.shape[2]
        encoding = {"uint8": "mono8", "uint16": "mono16", "float32": f"32FC{channels}"}[pixels.dtype.name]
        data = np.ascontiguousarray(pixels).view(np.uint8).ravel()
        height, width = pixels.shape[:2]
        self.write(topic, stamp, height=height, width=width, encoding=encoding, step=data.size // height, data=data)

    def cloud(self, topic, stamp, fields):
        points = np.stack(list(fields.values()), axis=-1)
        field = self.store.types["sensor_msgs/msg/PointField"]
        rows, columns, number = points.shape
        self.write(
            topic,
            stamp,
            height=rows,
            width=columns,
            fields=[field(name, 4 * place, 7, 1) for place, name in enumerate(fields)],
            point_step=4 * number,
            row_step=4 * number * columns,
            data=points.view(np.uint8).ravel(),
            is_bigendian=False,
            is_dense=False,
        )

    def parameters(self, node, model):
        parameter = self.store.types["rcl_interfaces/msg/Parameter"]
        kinds = {
            bool: (1, "bool_value"),
            int: (2, "integer_value"),
            float: (3, "double_value"),
            str: (4, "string_value"),
            list: (7, "integer_array_value"),
        }
        recorded = []
        for name, value in {**model.model_dump(), "unknown_to_this_version": 1}.items():
            kind, place = kinds[type(value)]
            value = np.array(value, np.int64) if isinstance(value, list) else value
            content = self.make("rcl_interfaces/msg/ParameterValue", type=kind, **{"bool_value": False, place: value})
            recorded.append(parameter(name, content))
        self.write("node_parameters", self.now, node=node, parameters=recorded)

    def begin(self):
        for node, model in (
            ("phase", PhaseParameters()),
            ("dic", self.displacement.parameters),
            ("coupling", self.shape.parameters),
            ("experiment", ExperimentParameters()),
        ):
            self.parameters(node, model)
        values = asdict(self.calibration)
        for name in ("projector_position", "projector_rotation", "covariance"):
            values[name] = np.array(values[name], dtype=float)
        self.write("calibration", self.now, **{**values, "parameter_names": []})
        self.write("experiment/reference", self.now, experiment="plate", step=0)

    def step(self, number, position, *, white=False, leave_out=(), derived=True, image=None):
        """Expose one step, or take a picture of something else, and publish what the nodes make of it."""
        patterns = [ProjectedPattern(PatternKind.WHITE)] if white else self.patterns
        width, height = self.rig.projector_shape[::-1]
        frames, records = [], []
        for index, projection in enumerate(patterns):
            self.now += 20_000_000
            stamp = self.now
            pattern = render_pattern(projection, width, height)
            frame = self.rig.expose(pattern, position, self.frame) if image is None else image
            self.frame += 1
            record = FrameRecord("plate", number, index, len(patterns), projection, stamp, 0.01)
            frames.append(frame)
            records.append(record)
            if index in leave_out:
                continue
            force = 1e6 * position + index
            self.write("load_frame/state", stamp + 1000, mode=3, force=force, position=position)
            self.thermocouple(stamp + 3000, 295.0 + number)
            if index == 1:  # the machine gave no readable reply
                self.write("load_frame/state", stamp + 2000, mode=0, force=float("nan"), position=float("nan"))
            self.image("camera/image_raw", stamp, frame)
            self.write(
                "camera/exposure",
                stamp,
                experiment="plate",
                step=number,
                index=index,
                count=len(patterns),
                kind=int(projection.kind),
                orientation=int(projection.orientation),
                pitch=projection.pitch,
                shift=projection.shift,
                shifts=projection.shifts,
                exposure_time=0.01,
            )
            self.writer.flush()
            self.logged[number, index] = self.now
        self.write("load_frame/state", stamp + 8_000_000, mode=2, force=-1.0, position=-1.0)
        if leave_out:
            error = "frames are missing"
            self.write(
                "experiment/step", records[-1].stamp, experiment="plate", step=number, stage=4, error_message=error
            )
        elif derived:
            self.publish(Stack("plate", number, records, np.stack(frames), records[-1].stamp))

    def publish(self, stack):
        stamp, number = stack.stamp, stack.step
        status = {"experiment": "plate", "step": number}
        if stack.kind == PatternKind.WHITE:
            texture = white_texture(stack.frames[-1])
            self.write("phase/status", stamp, **status, skipped=True, valid_fraction=float("nan"))
        else:
            phase = phase_step(stack, PhaseParameters())
            texture = phase.texture
            for name in ("sigma", "modulation", "texture"):
                self.image(f"phase/{name}", stamp, getattr(phase, name))
            self.image("phase/map", stamp, phase.phase)
            self.write("phase/status", stamp, **status, valid_fraction=phase.valid_fraction, phase_sigma=phase.rms)
        dic = self.displacement.step("plate", number, stamp, texture)
        self.image("dic/displacement", stamp, dic.displacement)
        self.image("dic/sigma", stamp, dic.sigma)
        found = {"valid_fraction": dic.valid_fraction, "rms_displacement_px": dic.rms}
        found |= {"correlated_step": dic.correlated_step}
        found |= {"window": dic.field.attrs["window_px"], "method": dic.field.attrs["method"]}
        self.write("dic/status", stamp, **{**status, **found})
        if stack.kind == PatternKind.WHITE:
            self.write("coupling/status", stamp, **status, skipped=True, valid_fraction=float("nan"))
            return
        coupling = self.shape.step(phase, dic)
        # a status may be recorded before the clouds it belongs to
        found = {"valid_fraction": coupling.valid_fraction, "rms_displacement": coupling.rms}
        self.write("coupling/status", stamp, **{**status, **found})
        self.cloud("coupling/shape", stamp, coupling.shape)
        self.cloud("coupling/displacement", stamp, coupling.displacement)


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Four steps of the plate, a white one, and one that lacks its frames 2 and 5."""
    folder = tmp_path_factory.mktemp("bench")
    bench = Bench(folder / "plate")
    bench.begin()
    for number, position in enumerate(POSITIONS):
        bench.step(number, position)
    bench.step(4, POSITIONS[-1], white=True)
    bench.step(5, POSITIONS[-1], leave_out=(2, 5))
    bench.step(6, POSITIONS[1])
    bench.writer.close()
    bench.bag = folder / "plate"
    return bench


@pytest.fixture(scope="module")
def processed(bench):
    said = []
    path = process_bag(bench.bag, progress=lambda step, error: said.append((step, error)))
    assert [step for step, _ in said] == [0, 1, 2, 3, 4, 5, 6]
    with open_experiment(path) as dataset:
        yield dataset


def identical(one, other):
    return one.shape == other.shape and one.dtype == other.dtype and np.array_equal(one, other, equal_nan=True)


def test_the_dataset_lies_beside_the_recording_and_is_labelled(bench, processed):
    assert (bench.bag.parent / "plate.nc").is_file()
    assert {name: processed.sizes[name] for name in ("step", "row", "column")} == {"step": 7, "row": 60, "column": 80}
    assert set(processed.sizes) - {"step", "row", "column"} == {"force_time", "position_time", "temperature_grip_time"}
    assert processed.row.values.tolist() == list(range(0, 120, SPACING))
    assert processed.column.values.tolist() == list(range(0, 160, SPACING))
    for name, quantity in MAPS.items():
        assert processed[name].dims == ("step", "row", "column")
        assert processed[name].dtype == np.float32
        assert (processed[name].units, processed[name].long_name) == quantity
    assert processed.experiment == "plate"
    assert processed.software.startswith("fringedic ")
    assert json.loads(processed.calibration)["camera_distance"] == bench.calibration.camera_distance
    parameters = json.loads(processed.parameters)
    assert len(parameters) == 1
    assert parameters[0]["parameters"]["dic"]["window"] == 24


def test_desk_and_nodes_agree_bit_by_bit(bench, processed, tmp_path):
    with open_experiment(dataset_from_derived(bench.bag, output=tmp_path / "derived.nc")) as derived:
        assert derived.step.values.tolist() == [0, 1, 2, 3, 4, 5, 6]
        unmeasured = str(derived.error.sel(step=5).values)
        assert unmeasured == "the recording contains no result of this step; measure it with fringedic process"
        derived = derived.drop_sel(step=5)
        desk = processed.sel(step=derived.step)
        for name in [*MAPS, *SCALARS, *STEP_NUMBERS, "time"]:
            assert identical(desk[name].values, derived[name].values), name
        assert np.isfinite(desk["w"].sel(step=3)).mean() > 0.7
        assert desk.correlated_step.values.tolist() == [0] * 6
        assert not desk.increments_summed.any()


def test_phase_and_displacement_are_checked(processed, bench, tmp_path):
    at_rest, moved = processed.sel(step=0), processed.sel(step=3)
    for name in ("displacement_closure_x", "displacement_closure_y", "phase_closure"):
        assert np.isfinite(moved[name]).mean() > 0.5, name
        assert 0.6 < np.nanstd(moved[name]) < 1.6, name
        assert moved[name].units == "standard deviations"
    assert np.isnan(at_rest.displacement_closure_x).all()
    assert np.isfinite(at_rest.phase_closure).mean() > 0.5
    assert 0.9 < float(moved.confirmed_fraction) <= 1
    assert "are confirmed within 3 sigma" in confirmation_sentence(processed)
    with open_experiment(dataset_from_derived(bench.bag, output=tmp_path / "derived.nc")) as derived:
        in_fringes = [0, 1, 2, 3, 6]  # the nodes publish no texture of the white step 4
        for name in ("displacement_closure_x", "displacement_closure_y"):
            assert identical(*(each[name].sel(step=in_fringes).values for each in (processed, derived))), name
        assert np.isnan(derived.displacement_closure_x.sel(step=4)).all()
        assert "are confirmed within 3 sigma" in confirmation_sentence(derived)
        assert np.isnan(derived.phase_closure).all(), "its check needs the frames"


def test_steps_whose_increments_were_summed_are_told_by_desk_and_nodes(tmp_path):
    """A texture that turns into another one within eight steps, which also moves."""
    generator = np.random.default_rng(7)
    first, last = (gaussian_filter(generator.normal(size=(120, 160)), 1.4, mode="wrap") for _ in range(2))
    bench = Bench(tmp_path / "plate")
    bench.begin()
    for number, angle in enumerate(np.linspace(0, np.pi / 2, 8)):
        texture = np.roll(np.cos(angle) * first + np.sin(angle) * last, number, axis=1)
        bench.step(number, 0.0, white=True, image=np.round(128 + 40 * texture / first.std()).clip(0, 255).astype("u1"))
    bench.writer.close()
    desk = process_bag(tmp_path / "plate", output=tmp_path / "desk.nc")
    with open_experiment(desk) as dataset:
        checked = np.isfinite(dataset.displacement_closure_x).any(["row", "column"]).values
        assert checked.tolist() == [bool(step) and not summed for step, summed in enumerate(dataset.increments_summed)]
        assert 1 < checked.sum() < 7
    nodes = dataset_from_derived(tmp_path / "plate", output=tmp_path / "nodes.nc")
    with open_experiment(desk) as one, open_experiment(nodes) as other:
        for name in ("displacement_x", "displacement_sigma_x", *STEP_NUMBERS):
            assert identical(one[name].values, other[name].values), name
        steps = one.correlated_step.values.tolist()
        assert one.reference_step.values.tolist() == [0] * 8
        assert steps[:2] == [0, 0]
        assert steps == sorted(steps)
        assert steps[-1] >= 3
        assert one.increments_summed.values.tolist() == [int(step > 0) for step in steps]
        moved = float(one.displacement_x[-1].median())
        assert abs(moved - 7) < 0.1, f"{moved} px: does not count from the reference step"


def test_recordings_of_versions_that_did_not_tell_say_so():
    collected = Collected({"dic/status", "dic/displacement", "dic/sigma"})
    image = {"height": 1, "width": 1, "encoding": "32FC2", "step": 8, "is_bigendian": 0, "data": np.zeros(8, np.uint8)}
    header = SimpleNamespace(stamp=SimpleNamespace(sec=1, nanosec=0))
    status = SimpleNamespace(header=header, step=3, error_code=0, error_message="", valid_fraction=1.0, frames=1)
    vars(status).update(experiment="plate", node="dic", rms=0.5)
    translate("fringedic_msgs/msg/NodeStatus", status)
    rows = []
    for topic in ("dic/displacement", "dic/sigma"):
        rows += collected.take(topic, SimpleNamespace(header=header, **image))
    rows += collected.take("dic/status", status)
    assert [(row.step, row.reference_step, row.correlated_step) for row in rows] == [(3, 3, None)]


def test_a_step_without_its_last_status_keeps_its_place():
    """As when coupling was killed: appended at the end, it was the last step of the dataset."""
    topics = {"dic/status", "coupling/status"}
    collected = Collected(topics)
    rows = []
    for step in (4, 5, 6):
        header = SimpleNamespace(stamp=SimpleNamespace(sec=step, nanosec=0))
        status = SimpleNamespace(header=header, step=step, error_code=0, error_message="", valid_fraction=1.0)
        status.skipped = False
        for topic in topics - ({"coupling/status"} if step == 5 else set()):
            rows += collected.take(topic, status)
    rows += collected.finish()
    assert [row.step for row in rows] == [4, 5, 6]
    assert [bool(row.error) for row in rows] == [False, True, False]
    assert "lacks coupling/status" in rows[1].error


def test_a_failed_step_that_nodes_ended_with_different_stamps_is_one_row():
    """The phase node ends it at the frame that it refuses, the others when they hear of the error: two rows."""
    topics = {"phase/status", "dic/status"}
    collected = Collected(topics)
    rows = []
    for step, seconds, topic in ((1, 10, "phase/status"), (1, 11, "dic/status"), *((2, 20, each) for each in topics)):
        header = SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=0))
        status = {
            "header": header,
            "step": step,
            "valid_fraction": 1.0,
            "skipped": False,
            "error_message": f"{topic} failed",
        }
        rows += collected.take(topic, SimpleNamespace(**status, error_code=int(step == 1)))
    rows += collected.finish()
    assert [(row.step, row.error) for row in rows] == [(1, "phase/status failed"), (2, "")]


def test_results_do_not_depend_on_the_number_of_threads(bench, processed, tmp_path):
    script = """
        import sys
        from fringedic.datasets import process_bag
        process_bag(sys.argv[1], output=sys.argv[2])
    """
    environment = {"NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(Path(__file__).parents[2])}
    subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script), str(bench.bag), str(tmp_path / "one.nc")],
        env={**os.environ, **environment},
        check=True,
    )
    with open_experiment(tmp_path / "one.nc") as single:
        for name in MAPS:
            assert identical(single[name].values, processed[name].values), name


def test_errors_against_the_truth_are_small_and_have_the_right_sign(bench, processed, tmp_path):
    truth_file = tmp_path / "truth.nc"
    bench.rig.save_truth(truth_file, [*POSITIONS, POSITIONS[-1], POSITIONS[-1], POSITIONS[1]])
    table = compare_with_truth(processed, tmp_path)
    predicted = {"u": "sigma_u", "v": "sigma_v", "w": "sigma_w", "z": "shape_sigma_z"}
    for step in (1, 2, 3, 6):
        row = table.sel(step=step)
        for name, sigma in predicted.items():
            noise = 1e6 * float(np.sqrt(np.square(processed[sigma].sel(step=step)).mean()))
            error = float(row[f"error_{name}"])
            limit = 1.5 * noise + (10 if name in "uv" else 0)  # the dots of this coarse texture bias u and v near edges
            assert 0.5 * noise < error < limit, f"step {step}: {name}, predicted noise {noise:.1f} µm"
        assert row.measured_fraction > 0.8
    assert np.isnan(table.sel(step=5).error_u)
    assert table.sel(step=5).measured_fraction == 0
    with xr.open_dataset(truth_file) as truth:
        errors = truth_errors(processed, truth, 3)
        exact = truth.isel(step=3).sel(row=processed.row, column=processed.column)
        measured = processed.sel(step=3)
        for name in "uvw":
            np.testing.assert_allclose(
                errors[f"error_{name}"] + exact[name].where(errors.visible),
                measured[name].where(errors.visible),
                atol=1e-9,
            )
    # the upper grip pulls along +y and the lower one stands still: v grows from the bottom of the image to its top
    v = processed.v.sel(step=3)
    assert v.isel(row=slice(0, 10)).median() > v.isel(row=slice(-10, None)).median() > 0


def test_load_and_time_are_those_of_the_exposures(bench, processed):
    index_mean = np.mean(range(len(bench.patterns)))
    for step in (0, 1, 2, 3):
        assert processed.position.sel(step=step) == pytest.approx(POSITIONS[step], abs=1e-12)
        assert processed.force.sel(step=step) == pytest.approx(1e6 * POSITIONS[step] + index_mean)
    assert np.all(np.diff(processed.time.values) > np.timedelta64(0, "ns"))
    assert processed.time.values[0] > np.datetime64(START, "ns")


def test_a_step_without_its_frames_has_no_maps_and_says_why(processed):
    failed = processed.sel(step=5)
    assert str(failed.error.values) == "frames 2, 5 of 8 never arrived"
    assert np.isnan(failed.phase).all()
    assert np.isnan(failed.displacement_x).all()
    assert str(processed.sel(step=6).error.values) == ""


@pytest.mark.parametrize(
    ("lost", "topics", "error"),
    [
        ({-1}, ["camera/image_raw"], "never arrived"),
        (set(range(-40, 40)), ["camera/image_raw"], "the recording contains no image of this step"),
        (set(range(-40, 40)), ["camera/image_raw", "camera/exposure"], "the recording contains no image of this step"),
    ],
)
def test_a_step_that_lost_images_keeps_its_place(lost, topics, error, tmp_path):
    """It was the last row, or had none."""
    reader = BagReader(RECORDED)
    exposed = [record.stamp for record in records(reader) if record.step == 1]
    stamps = {exposed[index] for index in lost if -len(exposed) <= index < len(exposed)}
    names = reader.find(*topics)
    with BagWriter(tmp_path / "bag") as writer:
        for topic in reader.topics.values():
            writer.add_recorded_topic(topic)
        for each in reader.stored():
            is_of_frame = each.topic in names.values()
            if not (is_of_frame and stamp_of(reader.decode(each.topic, each.data)) in stamps):
                writer.write(*each)
    told = []
    with open_experiment(process_bag(tmp_path / "bag", progress=lambda *each: told.append(each))) as dataset:
        assert dataset.step.values.tolist() == [0, 1, 2]
        assert [error in str(each) for each in dataset.error.values] == [False, True, False]
        assert np.isnan(dataset.w.sel(step=1)).all()
        assert dataset.force.notnull().all()
    assert [step for step, _ in told] == [0, 1, 2]


@pytest.mark.parametrize(
    ("exposed", "measured", "rows"),
    [
        ([0, 1, 2, 3], [0, 3], [0, -1, -2, 3]),
        ([0, 1, 2], [], [0, -1, -2]),
        ([0, 1, 3, 2], [0, 1, 3, 2], [0, 1, 3, 2]),  # the clock was set back: step 2 is not lost
        ([0, 3, 2, 1], [0, 3, 1], [0, 3, 1, -2]),
    ],
)
def test_every_exposed_step_has_one_row(exposed, measured, rows):
    found = with_lost_steps(map(Row, measured), exposed, "lost")
    assert [-row.step if row.error else row.step for row in found] == rows


def test_a_step_that_was_not_proven_to_hold_has_no_maps(tmp_path):
    """All its frames are recorded, and it was a row like any other; its force was even the tare.

    The experiment node was killed in the last step.
    """
    bench = Bench(tmp_path / "plate")
    bench.begin()
    metadata = Metadata.from_text("specimen: {force_tare_newton: first_step}")
    bench.parameters("experiment", ExperimentParameters(facts=metadata.to_text()))
    codes = {0: 112, 2: 114, 3: 109}  # not held, drift, dic
    for number in range(6):
        bench.write("experiment/step", bench.now, experiment="plate", step=number, stage=0)
        bench.step(number, POSITIONS[min(number, 3)])
        if number == 5:
            break
        code = codes.get(number)
        stage = {"stage": 3} if code is None else {"stage": 4, "error_code": code, "error_message": f"code {code}"}
        bench.write("experiment/step", bench.now, experiment="plate", step=number, **stage)
    bench.writer.close()
    for file in (process_bag(tmp_path / "plate"), dataset_from_derived(tmp_path / "plate", output=tmp_path / "d.nc")):
        with open_experiment(file) as dataset:
            *errors, interrupted = dataset.error.values.tolist()
            assert errors == ["code 112", "", "code 114", "", ""]
            assert interrupted.startswith("the step was interrupted before it was known that the machine held")
            assert dataset.w.notnull().any(["row", "column"]).values.tolist() == [False, True, False, True, True, False]
            assert np.isnan(dataset.rms_displacement.sel(step=[0, 2, 5])).all()
            assert float(dataset.force.sel(step=1)) == 0


def test_parameters_are_those_of_each_step(tmp_path):
    """The first row waits for the second, and was described with the parameters of that."""
    bench = Bench(tmp_path / "plate")
    bench.begin()
    for number, window in enumerate((24, 24, 32)):
        if window != 24:
            bench.parameters("dic", DicParameters(window=window, spacing=SPACING))
        bench.step(number, POSITIONS[number], derived=False)
    bench.writer.close()
    with open_experiment(process_bag(tmp_path / "plate", steps=[0, 2])) as dataset:
        entries = json.loads(dataset.parameters)
    assert [(each["from_step"], each["parameters"]["dic"]["window"]) for each in entries] == [(0, 24), (2, 32)]


def test_a_dataset_of_a_shorter_recording_is_not_opened_for_it(tmp_path):
    """As one that a report made during the run: later steps were missing without a word."""
    bag = tmp_path / "bag"
    shutil.copytree(RECORDED, bag)
    process_bag(bag, steps=[0, 1])
    with open_experiment(bag) as dataset:
        assert dataset.sizes["step"] == 2
    shutil.rmtree(bag)
    reader = BagReader(RECORDED)
    with BagWriter(bag, compression="none") as writer:
        for topic in reader.topics.values():
            writer.add_recorded_topic(topic)
        for message in reader.stored():
            writer.write(*message)
    with pytest.raises(DatasetError, match=r"bag\.nc: was made when .*bag had another size; 'fringedic process"):
        open_experiment(bag)
    process_bag(bag, output=tmp_path / "results.nc")
    with open_experiment(bag) as dataset:
        assert dataset.sizes["step"] == 3
    (tmp_path / "bag.nc").rename(tmp_path / "results.nc")
    with pytest.raises(DatasetError, match=r"results\.nc: was made when .*bag had another size; 'fringedic process"):
        open_experiment(tmp_path)
    process_bag(bag)
    for path in (bag, tmp_path):
        with open_experiment(path) as dataset:
            assert dataset.sizes["step"] == 3
    process_bag(bag, output=tmp_path / "results.nc", overwrite=True)
    shutil.copytree(bag, tmp_path / "bag-2")  # as of a command that was killed before it joined the parts
    (tmp_path / "bag.nc").unlink()
    for path in (bag, tmp_path):
        with pytest.raises(DatasetError, match=r"results\.nc: lacks what bag-2, .*'fringedic run --continue' goes on"):
            open_experiment(path)
    process_bag(bag)
    with open_experiment(tmp_path) as dataset:
        assert "bag-2" in dataset.damage


def test_a_white_step_has_a_displacement_and_no_shape(processed):
    white = processed.sel(step=4)
    assert str(white.error.values) == ""
    assert np.isnan(white.phase).all()
    assert np.isnan(white.w).all()
    difference = white.displacement_y - processed.sel(step=3).displacement_y
    assert abs(float(difference.median())) < 0.02


def test_the_reference_does_not_move(processed):
    first = processed.sel(step=0)
    assert set(np.unique(first.displacement_x.values[np.isfinite(first.displacement_x)])) == {0.0}
    assert processed.reference_step.values.tolist() == [0, 0, 0, 0, 0, -1, 0]


def test_the_strain_of_a_dataset_is_that_of_the_run_for_the_same_window(bench, processed, tmp_path):
    """Maps, standard deviations and points without a strain, of datasets of the desk and of the nodes."""
    with open_experiment(dataset_from_derived(bench.bag, output=tmp_path / "derived.nc")) as derived:
        for dataset in (processed, derived):
            for step in (0, 1, 3, 6):
                again = dataset.fringedic.strain(window=25, step=step)
                for name in STRAIN_FIELDS:
                    expected = dataset[name].sel(step=step).values
                    assert np.isfinite(expected).mean() > 0.4
                    # a resolution is the root of a difference of nearly equal squares
                    least = 1e-9 if name.startswith("resolution") else 1e-12
                    np.testing.assert_allclose(again[name].values, expected, rtol=2e-6, atol=least, err_msg=name)
                assert again.attrs["virtual_strain_gauge_px"] == 24 + 24
    wider = processed.fringedic.strain(window=41, step=3)
    assert 0.1 < float((wider.sigma_e_11 / processed.sigma_e_11.sel(step=3)).median()) < 0.6
    assert wider.attrs["virtual_strain_gauge_px"] == 40 + 24


def test_means_of_the_strain_agree_with_the_truth_within_their_uncertainty(bench, processed):
    """Means over the whole plate and its halves, at three loads; their root mean square z-score is about 1."""
    scores = []
    for step, position in ((1, POSITIONS[1]), (2, POSITIONS[2]), (3, POSITIONS[3])):
        measured = processed.sel(step=step).load()
        truth = bench.rig.truth(position).isel(row=slice(None, None, SPACING), column=slice(None, None, SPACING))
        truth = truth[list("xyzuvw")].assign_coords(row=measured.row, column=measured.column)
        exact = surface_strain(truth.where(np.isfinite(measured.u)), window=25)
        names = ["e_11", "e_22", "e_12"]
        error = measured.assign({name: measured[name] - exact[name] for name in names})
        for first, last in (((0, 0), (159, 119)), ((0, 0), (79, 119)), ((80, 0), (159, 119))):
            table = error.fringedic.region(names, Region.rectangle(first, last))[names].to_array()
            scores += (table.sel(statistic="mean") / table.sel(statistic="standard_uncertainty")).values.tolist()
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.5, np.round(scores, 1)


def test_overrides_change_the_results_and_wrong_ones_are_named(bench, processed, tmp_path):
    path = process_bag(bench.bag, output=tmp_path / "wide.nc", overrides={"dic.window": 40}, steps=[2])
    with open_experiment(path) as wide:
        assert wide.step.values.tolist() == [0, 2]
        assert not identical(wide.displacement_x.values[1], processed.displacement_x.sel(step=2).values)
        assert json.loads(wide.parameters)[0]["parameters"]["dic"] == {
            **DicParameters(spacing=SPACING, window=40).model_dump()
        }
    with pytest.raises(ConfigurationError, match=r"no parameter 'dic\.windw'; known are dic\.window, dic\.spacing"):
        process_bag(bench.bag, output=tmp_path / "x.nc", overrides={"dic.windw": 40})
    with pytest.raises(ConfigurationError, match=r"dic\.window = 4: Input should be greater than or equal to 8"):
        process_bag(bench.bag, output=tmp_path / "x.nc", overrides={"dic.window": 4})
    with pytest.raises(DatasetError, match=r"the folder .*absent does not exist; make it, or choose another output"):
        process_bag(bench.bag, output=tmp_path / "absent" / "x.nc")
    assert list(tmp_path.glob("*x.nc*")) == []


@pytest.mark.usefixtures("processed")
def test_a_result_is_not_overwritten_unasked(bench, tmp_path):
    with pytest.raises(DatasetError, match=r"plate\.nc exists already"):
        process_bag(bench.bag)
    path = process_bag(bench.bag, output=tmp_path / "a.nc", steps=[0])
    before = path.read_bytes()

    def interrupt(*_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        process_bag(bench.bag, output=path, overwrite=True, progress=interrupt)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_missing_parts_are_named(bench, tmp_path):
    with BagWriter(tmp_path / "empty"):
        pass
    with pytest.raises(RecordingError, match=r"has no camera/image_raw, camera/exposure; it holds no message"):
        process_bag(tmp_path / "empty")
    with pytest.raises(RecordingError, match=r"phase/status, .*'fringedic process .*empty' measures it"):
        open_experiment(tmp_path / "empty")
    with pytest.raises(DatasetError, match=r"no frame of experiment 'skin'; it has plate"):
        process_bag(bench.bag, output=tmp_path / "x.nc", experiment="skin")
    (tmp_path / "text.nc").write_text("no dataset")
    with pytest.raises(DatasetError, match="cannot be read as NetCDF"):
        open_experiment(tmp_path / "text.nc")
    xr.Dataset({"a": ("x", [1.0])}).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(DatasetError, match="is no experiment"):
        open_experiment(tmp_path / "other.nc")


def test_a_recording_without_calibration_gives_the_displacement_and_says_what_is_missing(tmp_path):
    bench = Bench(tmp_path / "plate")
    for number in range(2):
        bench.step(number, POSITIONS[number], derived=False)
    bench.writer.close()
    given = {"dic.spacing": 4, "specimen.force_sign": 1, "specimen.force_tare_newton": 0.0}
    with open_experiment(process_bag(tmp_path / "plate", overrides=given, reference=0)) as dataset:
        assert "no calibration yet" in str(dataset.error.values[1])
        assert np.isfinite(dataset.displacement_y[1]).mean() > 0.8
        assert np.isnan(dataset.w).all()
        assert "calibration" not in dataset.attrs


def test_a_recording_that_is_cut_off_is_measured_as_far_as_it_goes(bench, processed, tmp_path):
    shutil.copytree(bench.bag, tmp_path / "plate")
    file = tmp_path / "plate" / "plate_0.mcap"
    with file.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    place = next(each.chunk_start_offset for each in chunks if each.message_start_time > bench.logged[2, 3])
    file.write_bytes(file.read_bytes()[: place + 100])
    with open_experiment(process_bag(tmp_path / "plate")) as cut:
        assert "not closed" in cut.damage
        assert cut.step.values.tolist() == [0, 1, 2]
        assert identical(cut.w.values[:2], processed.w.values[:2])
        assert str(cut.error.values[2]) == "frames 4, 5, 6, 7 of 8 never arrived"
        assert np.isnan(cut.w[2]).all()
    assert "damage" not in processed.attrs


def test_another_sensor_is_in_the_dataset_beside_force_and_position(bench, processed):
    """With its samples on their own time axis; no reader has to know it."""
    assert signal_names(processed) == ["force", "position", "temperature_grip"]
    steps = processed.step.values
    np.testing.assert_allclose(processed.temperature_grip, 295.0 + steps)
    np.testing.assert_allclose(processed.temperature_grip_sigma, 0.5)
    assert np.isnan(processed.force_sigma).all(), "the load frame states none"
    temperature, force = (signal_series(processed, name) for name in ("temperature_grip", "force"))
    assert temperature.channel == Channel("temperature_grip", "temperature", "K", "", "thermocouple")
    assert sorted(set(temperature.values)) == [295.0 + step for step in steps]
    assert len(force.stamps) > len(temperature.stamps)
    assert np.diff(temperature.stamps).min() >= 20_000_000
    np.testing.assert_allclose(processed.temperature_grip_drift.drop_sel(step=4), 0.0, atol=1e-9)
    assert np.isnan(processed.temperature_grip_drift.sel(step=4)), "the white step has one sample"
    # one newton per frame; from the begin of the first exposure to the end of the last one
    assert len(bench.patterns) - 1 < processed.force_drift.sel(step=1) < len(bench.patterns)
    headings = [column.heading for column in step_columns(processed)]
    assert {"force [N]", "position [mm]", "temperature_grip [K]", "sigma of temperature_grip [K]"} <= set(headings)
    assert {"drift of force [N]", "drift of temperature_grip [K]"} <= set(headings)
    with pytest.raises(DatasetError, match="no samples of a signal 'voltage', only those of: force, position, temp"):
        signal_series(processed, "voltage")


def test_attached_signals_are_in_the_dataset_until_they_are_removed(bench, tmp_path):
    shutil.copytree(bench.bag, tmp_path / "plate")
    file = tmp_path / "machine.csv"
    file.write_text(
        "time [s];Load [kN];grip [degC]\n" + "".join(f"{n / 10};{0.5 + n};20,5\n".replace(",", ".") for n in range(50))
    )
    attach(tmp_path / "plate", file, offset=(0.0, 0.0), sigmas={"force": 3.0}, instead=True)
    path = process_bag(tmp_path / "plate", steps=[0, 1])
    with open_experiment(tmp_path / "plate") as dataset:
        assert dataset["grip"].values == pytest.approx([293.65, 293.65])
        assert dataset["force"].attrs["source"] == "machine"
        assert (dataset["force_sigma"].values >= 3.0).all()
        begin = dataset["force_series"].attrs["units"], dataset["force_time"].values[0].astype(np.int64)
        assert begin == ("N", BagReader(tmp_path / "plate").start_time)
        assert json.loads(dataset.attrs["attachments"]).keys() == {"machine.csv"}
    planned = fingerprint(str(tmp_path / "plate"))
    remove_attachment(tmp_path / "plate", "machine.csv")
    assert fingerprint(str(tmp_path / "plate")) != planned
    with pytest.raises(DatasetError, match=r"was made before files were attached to .*, or removed"):
        open_experiment(tmp_path / "plate")
    assert path.exists()


def test_signals_of_any_names_have_their_own_variables(tmp_path):
    names = ["grip 1", "grip_1", "grip/1", "grip", "grip_sigma", "w", "step"]
    signals = [Signal(Channel(name, "length", "m"), *(np.arange(3) for _ in range(3))) for name in names]
    settings = StepSettings({"dic": DicParameters()}, None, {}, None)
    with DatasetWriter(tmp_path / "many.nc", {}) as writer:
        writer.add_signals(signals)
        writer.add(Row(0, 0, maps={"displacement_x": np.zeros((8, 8), np.float32)}), settings)
    with open_experiment(tmp_path / "many.nc") as dataset:
        assert len(signal_names(dataset)) == len(names)


def test_zarr_holds_the_same(bench, processed, tmp_path):
    path = process_bag(bench.bag, output=tmp_path / "plate.zarr", steps=[0, 5, 4])
    with open_experiment(path) as folder:
        assert folder.step.values.tolist() == [0, 4, 5]
        chosen = processed.sel(step=folder.step)
        assert folder.error.values.tolist() == chosen.error.values.tolist()
        for name in ("phase", "time", "force", "valid_fraction"):
            assert identical(folder[name].values, chosen[name].values), name
        assert folder.calibration == processed.calibration
        assert folder.commit == processed.commit
        assert folder.w.encoding["chunks"] == (1, 60, 80)
    with pytest.raises(DatasetError, match=r"plate\.zarr exists already"):
        process_bag(bench.bag, output=path)
    process_bag(bench.bag, output=path, steps=[0], overwrite=True)
    with open_experiment(path) as folder:
        assert folder.step.values.tolist() == [0]
    assert [each.name for each in tmp_path.iterdir()] == ["plate.zarr"]
    with pytest.raises(DatasetError, match=r"is named \.nc \(NetCDF\) or \.zarr"):
        process_bag(bench.bag, output=tmp_path / "plate.txt")


def test_a_reference_step_that_failed_before_its_first_frame_is_none(tmp_path):
    """It had been announced: a part of the steps was refused, because that step has no frame."""
    bench = Bench(tmp_path / "plate")
    bench.begin()  # announces step 0
    bench.write("experiment/step", bench.now, experiment="plate", step=0, stage=4, error_message="no hold")
    bench.write("experiment/reference", bench.now, experiment="plate", step=1)
    for number in (1, 2):
        bench.step(number, POSITIONS[number], derived=False)
    bench.writer.close()
    with open_experiment(process_bag(tmp_path / "plate", steps=[2])) as dataset:
        assert (dataset.step.values.tolist(), dataset.reference_step.values.tolist()) == ([1, 2], [1, 1])


def white_steps(path, steps, *references):
    """A recording of white steps, in which references are announced: (before which step, replacing a lost one)."""
    bench = Bench(path)
    bench.begin()
    for number in steps:
        for step, lost in references:
            if step == number:
                bench.write("experiment/reference", bench.now, experiment="plate", step=step, previous_lost=lost)
        bench.step(number, POSITIONS[number], white=True)
        bench.write("experiment/step", bench.now, experiment="plate", step=number, stage=3)
    bench.writer.close()
    return path


def test_steps_count_from_the_reference_that_the_nodes_had_lost(tmp_path):
    """They counted from the first step after the loss, which is loaded; the results of the nodes do so."""
    lost = white_steps(tmp_path / "lost", range(3), (1, True))
    asked = white_steps(tmp_path / "asked", range(3), (1, False))
    with open_experiment(process_bag(lost)) as found, open_experiment(process_bag(asked)) as other:
        assert found.reference_step.values.tolist() == [0, 0, 0]
        assert other.reference_step.values.tolist() == [0, 1, 1]
        moved = [float(each.displacement_y.isel(step=2).median()) for each in (found, other)]
        first = float(found.displacement_y.isel(step=1).median())
        assert moved == pytest.approx([2 * first, first], rel=0.05), "the plate moves as far in each step"
        assert references_sentence(other).startswith("displacements are relative to steps 0, 1")
    with pytest.raises(DatasetError, match=r"count from step 1 instead of step 0, .* 'fringedic process .*lost'"):
        dataset_from_derived(lost, output=tmp_path / "nodes.nc")


def test_a_recording_without_the_reference_before_it_says_so(tmp_path):
    """A part of a run that was continued counts from its first step, at the load of that step."""
    bench = Bench(tmp_path / "part")
    bench.parameters("experiment", ExperimentParameters())
    bench.write("experiment/reference", bench.now, experiment="plate", step=2, previous_lost=True)
    for number in (2, 3):
        bench.step(number, POSITIONS[number], white=True)
    bench.writer.close()
    with open_experiment(process_bag(tmp_path / "part")) as part:
        assert references_sentence(part).startswith("displacements are relative to step 2, at the load of that step")
    asked = process_bag(tmp_path / "part", output=tmp_path / "asked.nc", reference=2)
    with open_experiment(asked) as part:
        assert references_sentence(part) == ""


def test_another_reference_step_turns_the_displacement_round(bench, processed, tmp_path):
    path = process_bag(bench.bag, output=tmp_path / "other.nc", reference=3)
    with open_experiment(path) as other:
        assert other.step.values.tolist() == [0, 1, 2, 3, 4, 5, 6]
        assert set(other.reference_step.values.tolist()) == {3, -1}
        assert set(np.unique(other.v.sel(step=3).values[np.isfinite(other.v.sel(step=3))])) == {0.0}
        back, forth = other.v.sel(step=0), processed.v.sel(step=3)
        assert float(forth.median()) > 100e-6, "the plate moves up against step 0"
        assert float(back.median()) == pytest.approx(-float(forth.median()), rel=0.05)
        # two displacements add up: 0 -> 1 is 3 -> 1 minus 3 -> 0
        between = float((other.v.sel(step=1) - back).median())
        assert between == pytest.approx(float(processed.v.sel(step=1).median()), rel=0.05)
    with pytest.raises(DatasetError, match=r"experiment 'plate' has no step 9; it has 0, 1, 2, 3, 4, 5, 6"):
        process_bag(bench.bag, output=tmp_path / "x.nc", reference=9)


def test_several_references_follow_each_other_whatever_was_recorded(bench, tmp_path):
    path = process_bag(bench.bag, output=tmp_path / "other.nc", reference=(0, 1, 3))
    alone = process_bag(bench.bag, output=tmp_path / "alone.nc", reference=3)
    with open_experiment(path) as other, open_experiment(alone) as against_3:
        named = other.reference_step.values
        assert set(named[:1].tolist()) == {0}
        assert set(named[1:3].tolist()) <= {1, -1}
        assert set(named[3:].tolist()) <= {3, -1}
        assert identical(other.v.sel(step=3).values, against_3.v.sel(step=3).values)
        later = [step for step in (4, 5, 6) if np.isfinite(other.v.sel(step=step)).any()]
        assert later
        for step in later:
            difference = other.v.sel(step=step) - against_3.v.sel(step=step)
            assert abs(float(difference.median())) < 1e-6, "the search begins elsewhere, the reference is the same"


def test_metadata_are_found_again_and_the_force_gets_its_tare_and_sign(tmp_path):
    bench = Bench(tmp_path / "plate")
    bench.begin()
    metadata = Metadata.from_text(
        "specimen: {name: sheet 4, section_mm2: 12.5, force_tare_newton: first_step, force_sign: -1}"
    )
    bench.parameters("experiment", ExperimentParameters(facts=metadata.to_text()))
    for number in range(3):
        bench.step(number, POSITIONS[number], derived=False)
    bench.writer.close()
    with open_experiment(process_bag(tmp_path / "plate")) as dataset:
        read = 1e6 * np.array(POSITIONS[:3]) + np.mean(range(len(bench.patterns)))
        np.testing.assert_allclose(dataset.force, -(read - read[0]))
        specimen = json.loads(dataset.facts)["specimen"]
        assert (specimen["name"], specimen["section_mm2"]) == ("sheet 4", 12.5)
        assert json.loads(dataset.rig)["experiment"] == {"shifts": 4, "unknown_to_this_version": 1}
    with pytest.raises(ConfigurationError, match=r"specimen\.section_mm2: Input should be greater than 0"):
        Metadata.from_text("{specimen: {section_mm2: 0.0}}")
    with pytest.raises(ConfigurationError, match=r"specimen\.nam: Extra inputs"):
        Metadata.from_text("{specimen: {nam: x}}")
    assert Metadata().to_text() == ""
    assert Metadata.from_text("") == Metadata()


def test_the_dataset_of_a_run_is_found_from_its_recording(bench, tmp_path):
    shutil.copytree(bench.bag, tmp_path / "bag")
    process_bag(tmp_path / "bag", output=tmp_path / "results.nc", steps=[1])
    with open_experiment(tmp_path / "bag") as dataset:
        assert dataset.step.values.tolist() == [0, 1]
    (tmp_path / "bag").rename(tmp_path / "other")
    with open_experiment(tmp_path / "other") as dataset:
        assert "no result of this step" in str(dataset.error.sel(step=5).values), "results.nc is of another recording"


def test_maps_are_read_when_they_are_used(processed):
    unread = "values with dtype=float32"  # of the text of an array that is not in memory
    assert unread in repr(processed.w)
    assert unread in repr(processed.phase)
    assert unread not in repr(processed.w.sel(step=3).load())
    assert unread in repr(processed.w)
    picked = processed.w.isel(step=[3, 1], row=slice(10, None, 7), column=[5, 2, 2])
    np.testing.assert_array_equal(picked.values, processed.w.values[[3, 1]][:, 10::7][:, :, [5, 2, 2]])
