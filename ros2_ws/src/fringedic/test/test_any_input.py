"""Every public function answers any input by a value, by NaN where it is not valid, or by an error of one sentence.

Each function has a call that works. One argument of it is replaced: by every value of a table, and by values that
Hypothesis makes up.
"""

import dataclasses
import inspect
import math
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from aligned_rig import aligned_rig
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.ndimage import gaussian_filter

import fringedic
import fringedic.datasets
import fringedic.evaluation
import fringedic.export
import fringedic.figures
import fringedic.images
from fringedic.errors import FringedicError
from fringedic.models import Model
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.rig_setup.response import response_patterns

pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning", "ignore:Degrees of freedom")
SHAPE = (20, 24)
IMAGE = ("row", "column")
RIG = aligned_rig((24, 20), 6e-4, (80, 60), 900.0, projector_position=(0.15, 0.0, 0.38))
PITCH = 10.0
NOWHERE = Path("nowhere")


def plane(angle=0.0, height=0.0):
    """Phase of the plane z = height + x tan(angle)."""
    column, row = np.meshgrid(np.arange(24.0), np.arange(20.0))
    across = RIG.pixel_size * (column - RIG.principal_column) / 0.4
    z = (height + 0.4 * math.tan(angle) * across) / (1 + math.tan(angle) * across)
    return RIG.phase(across * (0.4 - z), RIG.pixel_size * (RIG.principal_row - row) / 0.4 * (0.4 - z), z, PITCH)


def speckle(moved):
    surface = gaussian_filter(np.random.default_rng(1).normal(size=(56, 56)), 1.4)
    grey = 128 + 40 * surface / surface.std()
    return np.clip(grey[4:52, 4 - moved : 52 - moved], 0, 255).astype(np.uint8)


def in_plane():
    """A displacement by half a pixel to the right."""
    values = {"displacement_x": 0.5, "displacement_y": 0.0, "sigma_x": 0.01, "sigma_y": 0.01}
    maps = {name: (IMAGE, np.full(SHAPE, value, np.float32)) for name, value in values.items()}
    maps["valid"] = (IMAGE, np.ones(SHAPE, bool))
    return xr.Dataset(maps, {"row": np.arange(20), "column": np.arange(24)}, {"window_px": 16, "method": "dense"})


SIGMA = np.full(SHAPE, 0.01)
SURFACE = RIG.reconstruct(plane(), PITCH, SIGMA)
CLOUD = fringedic.couple(SURFACE, RIG.reconstruct(plane(height=1e-4), PITCH, SIGMA), in_plane(), calibration=RIG)
MAPS = CLOUD.merge(in_plane().drop_vars(("sigma_x", "sigma_y"))).assign(shape_z=CLOUD.z)
EXPERIMENT = xr.concat([MAPS] * 2, dim="step").assign(
    step=[0, 1],
    force=("step", [1.0, 2.0]),
    position=("step", [0.0, 1e-3]),
    time=("step", np.array([0, 1], "datetime64[ns]")),
    error=("step", ["", ""]),
)
MEASURED = EXPERIMENT.assign(reference_step=("step", [0, 0])).assign_attrs(
    parameters='[{"parameters": {"dic": {"window": 16, "method": "dense"}}}]'
)
STRAINED = EXPERIMENT.assign(dict.fromkeys(("e_11", "e_22", "sigma_e_11", "sigma_e_22"), EXPERIMENT["u"]))
CORNERS = np.array([(x, y, 0.0) for x in (-0.1, 0.1) for y in (-0.1, 0.1)])
TRIANGLES = np.array([[0, 2, 3], [0, 3, 1]])
MODEL = Model("plane", CORNERS, TRIANGLES, False, np.array([0.0, 5.0]), np.array([0 * CORNERS, 1e-3 * CORNERS]))
NOMINAL = Model("plane", CORNERS, TRIANGLES, False, np.empty(0), np.empty((0, 4, 3)))
SHAPED = EXPERIMENT.assign(
    shape_x=EXPERIMENT.x, shape_y=EXPERIMENT.y, shape_z=EXPERIMENT.z, shape_sigma_z=EXPERIMENT.sigma_w
)
SEQUENCE = fringedic.fringe_sequence(80, 6, [80, 10], 4)
FRAMES = np.array([0.8 * image.astype(np.float32) + 10 for image in SEQUENCE])
MOVING = np.array([[100 + 50 * np.cos(2 * np.pi * (np.arange(80) / 40 - k / 8))] * 40 for k in range(1, 9)], np.float32)
ANGLES = [math.radians(angle) for angle in (0, -15, -10, 10, 15)]
_COLUMN, _ROW = 2 * np.pi / 7.3 * np.array(np.meshgrid(np.arange(96.0), np.arange(96.0)))  # lines turned by 2 degree
GRID = 128 + 50 * np.cos(0.9994 * _COLUMN + 0.0349 * _ROW) + 50 * np.cos(0.9994 * _ROW - 0.0349 * _COLUMN)
GREYS = response_patterns()
ALBEDO = np.random.default_rng(1).uniform(100, 200, (20, 30))
MASK = np.ones((48, 48), bool)
REGION = fringedic.Region.rectangle((2, 2), (15, 15))
FRINGES = {"width": 80, "height": 6, "shifts": 4, "orientation": "vertical", "periods": 1}
CALLS = {
    fringedic.demodulate: {"frames": FRAMES[:4], "shifts": 4, "noise": 1.0, "saturation": 250.0},
    fringedic.demodulate_moving: {
        "frames": MOVING,
        "times": np.arange(8.0),
        "patterns": [ProjectedPattern(PatternKind.FRINGES, pitch=40.0, shift=k, shifts=8) for k in range(1, 9)],
        "displacement": fringedic.ImageMotion.uniform((40, 80), -1.0, 0.0),
        "drift": -0.1,
        "exposure_time": 0.1,
    },
    fringedic.absolute_phase: {
        "frames": FRAMES,
        "patterns": SEQUENCE.patterns,
        "noise": 1.0,
        "saturation": 250.0,
        "minimum_modulation": 1.0,
    },
    fringedic.unwrap_hierarchical: {
        "wrapped": [plane() / 8, np.angle(np.exp(1j * plane()))],
        "pitches": [80.0, 10.0],
    },
    fringedic.unwrap_spatial: {"wrapped": np.angle(np.exp(1j * plane()))},
    fringedic.fringe_sequence: {"pitches": [80.0, 10.0], **FRINGES},
    fringedic.gray_code_sequence: {"pitch": 10.0, **FRINGES},
    fringedic.one_image_sequence: {"width": 80, "height": 6, "pitch": 10.0, "orientation": "vertical"},
    fringedic.measure_displacement: {
        "reference": speckle(0),
        "deformed": speckle(1),
        "window": 16,
        "spacing": 8,
        "mask": MASK,
        "initial": (np.ones((6, 6)), np.zeros((6, 6))),
        "method": "dense",
    },
    fringedic.Reference: {"image": speckle(0), "window": 16, "spacing": 8, "mask": MASK},
    fringedic.accumulate: {"increments": [in_plane(), in_plane()], "method": "spline", "element": 8.0},
    fringedic.advise_settings: {
        "reference": speckle(0),
        "static_1": speckle(0),
        "static_2": speckle(1),
        "wanted_noise": 0.05,
        "wanted_period": 40.0,
        "strain_window": 5,
        "pixel_size": 1e-4,
        "full_scale": 255.0,
        "mask": MASK,
    },
    fringedic.calibrate_rig: {
        "phases": [plane(angle) for angle in ANGLES],
        "angles": ANGLES,
        "pixel_size": 6e-4,
        "pitch": PITCH,
        "projector_size": (80, 60),
        "sigma": [SIGMA] * 5,
        "heights": [0.0] * 5,
        "held_out": [1],
        "pixel_aspect": 1.0,
        "principal_point": (11.5, 9.5),
        "sigma_angle": 0.0,
        "sigma_pixel_size": 0.0,
        "camera_distance": 0.4,
        "model": "six_parameter",
    },
    fringedic.check_rig: {
        "rig": RIG,
        "phase": plane(),
        "sigma": SIGMA,
        "pitch": PITCH,
        "marks": ((2.0, 2.0), (20.0, 15.0)),
        "distance": 0.01,
        "earlier": plane(),
    },
    fringedic.couple: {
        "reference_shape": SURFACE,
        "deformed_shape": SURFACE,
        "displacement": in_plane(),
        "calibration": RIG,
        "z_filter": 1.0,
    },
    fringedic.PreparedShape: {"shape": SURFACE, "z_filter": 1.0, "calibration": RIG},
    fringedic.to_local_frame: {"displacement_3d": CLOUD, "window": 5},
    fringedic.surface_strain: {"displacement_3d": CLOUD, "window": 5, "measures": ("von_mises",)},
    fringedic.evaluation.extensometer: {
        "dataset": EXPERIMENT,
        "first": (3.0, 5.0),
        "second": (20.0, 5.0),
        "subset": 3.0,
    },
    fringedic.evaluation.profile: {
        "dataset": EXPERIMENT,
        "names": ["u"],
        "start": (3.0, 5.0),
        "end": (20.0, 5.0),
        "points": 5,
    },
    fringedic.evaluation.region_statistics: {"dataset": EXPERIMENT, "names": ["u"], "region": REGION},
    fringedic.evaluation.strain_of_step: {"dataset": EXPERIMENT, "window": 9, "step": 1, "measures": ["von_mises"]},
    fringedic.evaluation.strain_curve: {"dataset": STRAINED, "region": REGION},
    fringedic.evaluation.elastic_constants: {
        "dataset": STRAINED,
        "region": REGION,
        "strain": (-1.0, 1.0),
        "sigma_force": 1.0,
    },
    fringedic.evaluation.remove_rigid_motion: {"dataset": EXPERIMENT, "region": REGION},
    fringedic.evaluation.force_curve: {
        "dataset": EXPERIMENT,
        "strain": [0.0, 0.01],
        "section": 1e-5,
        "tare": 0.0,
        "sign": 1,
    },
    fringedic.measure_distortion: {"grid_image": GRID, "pitch": 5e-4, "order": 1, "mask": np.ones(GRID.shape, bool)},
    fringedic.measure_response: {
        "frames": np.stack([20 + ALBEDO * (pattern.shift / 255) ** 2 for pattern in GREYS]),
        "patterns": GREYS,
        "saturation": 400.0,
    },
    fringedic.ResponseCurve: {"brightness": tuple(np.linspace(0, 1, 256)), "sigma": 0.01},
    fringedic.DistortionMap: {"width": 24, "height": 20, "columns": np.zeros((4, 4)), "rows": np.zeros((4, 4))},
    fringedic.Region.rectangle: {"first": (2, 2), "last": (15, 15)},
    fringedic.RigModel: {
        each.name: getattr(RIG, each.name) for each in dataclasses.fields(RIG) if each.name != "camera_distortion"
    },
    RIG.reconstruct: {"phase": plane(), "pitch": PITCH, "sigma_phase": SIGMA},
    fringedic.figures.save_pictures: {"dataset": EXPERIMENT.isel(step=[0], row=slice(0, 3)), "folder": NOWHERE},
    fringedic.export.export_dataset: {"dataset": EXPERIMENT, "folder": NOWHERE, "formats": ["csv"], "steps": [1]},
    fringedic.evaluation.compare_with_truth: {"dataset": EXPERIMENT, "truth_path": NOWHERE},
    fringedic.compare_model: {
        "experiment": MEASURED,
        "model": MODEL,
        "steps": [1],
        "by": "force",
        "load_table": {1: 2.0},
    },
    fringedic.compare_shape: {"experiment": SHAPED, "model": NOMINAL, "step": 0},
    fringedic.read_model: {
        "file": NOWHERE,
        "unit": "mm",
        "displacement": "u",
        "strain": "e",
        "results": [NOWHERE],
        "loads": [1.0],
    },
    fringedic.compare_experiments: {"one": MEASURED, "other": MEASURED},
    fringedic.evaluation.compare_specimens: {"experiments": [MEASURED, MEASURED]},
    fringedic.open_campaign: {"place": NOWHERE},
    fringedic.open_experiment: {"path": NOWHERE},
    fringedic.measure_images: {
        "images": [NOWHERE, NOWHERE],
        "output": NOWHERE,
        "window": 16,
        "spacing": 4,
        "strain_window": 21,
        "pixel_size": 1e-4,
    },
    fringedic.process_bag: {"path": NOWHERE, "output": NOWHERE},
    fringedic.write_report: {"source": NOWHERE, "output": NOWHERE, "static_steps": [0]},
    fringedic.load_rig_file: {"path": NOWHERE},
    fringedic.load_programme: {"path": NOWHERE},
}
FILES = {  # their call does not work, because there is no such file
    fringedic.evaluation.compare_with_truth,
    fringedic.open_campaign,
    fringedic.open_experiment,
    fringedic.read_model,
    fringedic.measure_images,
    fringedic.process_bag,
    fringedic.write_report,
    fringedic.load_rig_file,
    fringedic.load_programme,
}
# results and enumerations, which are not made by users; tests of the functions that return them check them
RETURNED = {
    "Advice",
    "CylinderFrame",
    "ExperimentAccessor",
    "FringedicError",
    "ImageMotion",
    "RigCalibration",
    "RigCheck",
    "SpecimenFrame",
}
NUMBERS = [
    None,
    math.nan,
    math.inf,
    -math.inf,
    -1,
    0,
    1.5,
    1e308,
    2**70,
    "text",
    [],
    1j,
    np.array([1.0, 2.0]),
    object(),
]
PATHS = [None, "", "nowhere", Path("/proc/nowhere"), Path("x" * 300), "a\0b", 3.5]


def bad_arrays(array):
    numbers = array.astype(float)
    shapes = [(), (3,), (0, 0), (4, 0, 0), (2, 3, 4), (8, 0), (1, 1), (2, 2, 2, 2)]
    contents = [math.nan, math.inf, 5.0, 1e38, 1e300]
    types = [complex, str, object, bool, np.int64, np.float16, np.int32]
    return [
        *(None, 3.0, "text", []),
        *(np.zeros(shape) for shape in shapes),
        *(np.full(array.shape, content) for content in contents),
        *(numbers.astype(kind) for kind in types),
        *(numbers[..., :-1], -numbers, np.where(np.arange(array.size).reshape(array.shape) % 2, numbers, np.nan)),
    ]


def bad_datasets(dataset):
    first, *_, last = dataset.data_vars

    def times(factor, offset=0.0):
        return dataset.map(lambda each: offset + each * factor if each.dtype.kind == "f" else each)

    return [
        *(None, 3.0, np.zeros((3, 3)), xr.Dataset()),
        *(dataset.drop_vars(first), dataset[[last]], dataset.astype(str), dataset.rename(row="line")),
        *(times(math.nan), times(math.inf), times(0.0), times(0.0, 1.0)),
        *(dataset.isel(row=slice(0, count)) for count in (0, 1, 2)),
        *(dataset.isel(column=slice(0, 0)), dataset.isel(row=0), dataset.transpose(..., "column", "row")),
        dataset.isel(row=slice(0, 1), column=slice(0, 1)),
    ]


def bad_sequences(sequence):
    count = len(sequence)
    members = [math.nan, math.inf, -1, 0, 1e308, "a", None, object()]
    if isinstance(sequence[0], np.ndarray):
        members = bad_arrays(sequence[0])
    if isinstance(sequence[0], xr.Dataset):
        members = bad_datasets(sequence[0])
    return [
        *(None, [], 3.0, "text", list(sequence)[:-1], [*sequence, *sequence], list(sequence)[::-1], [sequence]),
        *([member] * count for member in members),
        *([*sequence[:-1], member] for member in members),
    ]


def bad_values(value):
    """Return the values of the table for the kind of an argument."""
    if isinstance(value, xr.Dataset):
        return bad_datasets(value)
    if isinstance(value, np.ndarray):
        return bad_arrays(value)
    if isinstance(value, Path):
        return PATHS
    if isinstance(value, (list, tuple)) and len(value):
        return bad_sequences(value)
    if isinstance(value, str):
        return [None, "", "text", 3, b"x", ["a"]]
    return NUMBERS if isinstance(value, (int, float)) else [None, 3.0, "text", object()]


def made_up(value):
    """Return the strategy of values for the kind of an argument."""
    numbers = st.one_of(st.floats(), st.integers(), st.floats(-100, 100), st.integers(-5, 50))
    if isinstance(value, np.ndarray):
        shape = st.one_of(st.just(value.shape), arrays.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=8))
        kinds = st.sampled_from([np.uint8, np.uint16, np.float32, np.float64, np.int64, bool])
        return kinds.flatmap(lambda kind: arrays.arrays(kind, shape))
    if isinstance(value, (list, tuple)):
        return st.lists(numbers, max_size=6)
    return numbers if isinstance(value, (int, float)) else st.text(max_size=8)


def name_of(function):
    return getattr(function, "__qualname__", str(function))


def answers(function, arguments):
    """Call a function and check its answer; errors that are not named ones are errors of the test."""
    try:
        result = function(**arguments)
    except FringedicError as error:
        named = error
    else:
        check_result(result)
        return
    assert 10 < len(str(named)) <= 500, named
    assert "\n" not in str(named), named


def check_result(result):
    """Check that what is valid is finite, and what is not valid is NaN."""
    if isinstance(result, xr.Dataset) and "valid" in result:
        valid = result.valid.values
        for name, each in result.data_vars.items():
            if each.shape == valid.shape and each.dtype.kind == "f" and name not in ("modulation", "texture"):
                assert not np.isinf(each.values[valid]).any(), name
                if name not in ("sigma", "sigma_x", "sigma_y"):
                    assert np.isfinite(each.values[valid]).all(), name
                assert np.isnan(each.values[~valid]).all(), name


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_every_public_function_is_here():
    names = {name_of(function).partition(".")[0] for function in CALLS}
    public = {name for name in fringedic.__all__ if callable(getattr(fringedic, name))}
    assert public - names - RETURNED == set()


@pytest.mark.parametrize("function", [each for each in CALLS if each not in FILES], ids=name_of)
def test_the_call_works(function):
    assert function(**CALLS[function]) is not None


@pytest.mark.parametrize("function", CALLS, ids=name_of)
def test_values_of_the_table(function):
    arguments = CALLS[function]
    optional = {name for name, each in inspect.signature(function).parameters.items() if each.default is None}
    every = 10 if function is fringedic.calibrate_rig else 1  # each of its fits takes a second
    for name, value in arguments.items():
        for bad in bad_values(value)[::every]:
            if bad is not None or name not in optional:
                answers(function, {**arguments, name: bad})


KINDS = (int, float, str, np.ndarray, list, tuple)
MADE_UP = {
    function: [name for name, value in arguments.items() if isinstance(value, KINDS)]
    for function, arguments in CALLS.items()
    if function
    not in FILES
    | {
        fringedic.calibrate_rig,
        fringedic.compare_experiments,
        fringedic.evaluation.compare_specimens,
        fringedic.figures.save_pictures,
        fringedic.evaluation.remove_rigid_motion,
        fringedic.evaluation.strain_curve,
    }
}


@pytest.mark.parametrize("function", MADE_UP, ids=name_of)
@settings(max_examples=25, derandomize=True, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_values_that_are_made_up(function, data):
    arguments = CALLS[function]
    name = data.draw(st.sampled_from(MADE_UP[function]))
    answers(function, {**arguments, name: data.draw(made_up(arguments[name]))})
