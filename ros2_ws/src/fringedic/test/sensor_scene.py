"""Sensors of the virtual rig on one specimen: their phases with noise, and recordings of them made without nodes."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.polynomial import chebyshev
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fringedic.camera import DistortionMap
from fringedic.patterns.sequences import PatternSequence, fringe_sequence
from fringedic.recording import BagReader, BagWriter, Topic
from fringedic.rig.geometry import parameter_values, with_parameters
from fringedic.rig.model import RigModel
from fringedic.virtual_rig import VirtualRig, virtual_sensors

NOISE = 0.0021 * 2 * math.pi  # [rad]
PITCH = 10.0
UNCERTAINTIES = {
    "camera_distance": 3e-5,
    "camera_tilt_x": 3e-5,
    "camera_tilt_y": 3e-5,
    "projector_x": 2e-5,
    "projector_z": 2e-5,
    "projector_yaw": 2e-5,
    "projector_focal_length": 0.03,
}
"""Standard uncertainties [m, rad, px] of the calibration of a sensor."""
BALLS = {"kind": "spheres", "radius_mm": 7.5}
PLACES = (
    ((-16.0, -9.0, 0.0), (15.0, -11.0, 3.0), (-2.0, 12.0, -4.0)),
    ((-12.0, -9.0, 8.0), (13.0, -11.0, -3.0), (-1.0, 11.0, 4.0)),
    ((-3.0, -9.0, -8.0), (17.0, -7.0, 3.0), (-5.0, 13.0, -9.0)),
)
"""Centres of three balls [mm] in three places."""
RECORDED = Path(__file__).parent / "recordings" / "version_0_1" / "bag"
MESSAGES = Path(__file__).parents[2] / "fringedic_msgs" / "msg"
_ORDER = 7


def lens_of(twin: VirtualRig) -> DistortionMap:
    """Return the distortion of a camera without any measurement."""
    rows, columns = twin.shape
    column, row = twin.straight_pixels()
    a, b = np.meshgrid(np.linspace(-1, 1, columns), np.linspace(-1, 1, rows))
    design = chebyshev.chebvander2d(b.ravel(), a.ravel(), [_ORDER, _ORDER])
    own_row, own_column = np.indices(twin.shape)
    fields = [
        np.linalg.lstsq(design, (each - at).ravel(), rcond=None)[0]
        for each, at in ((column, own_column), (row, own_row))
    ]
    return DistortionMap(columns, rows, *(each.reshape(_ORDER + 1, _ORDER + 1) for each in fields))


def drawn_model(twin: VirtualRig, sensor: str, generator: np.random.Generator) -> RigModel:
    """Return a calibration of a sensor whose errors are drawn from the covariance that it states."""
    names, sigma = tuple(UNCERTAINTIES), np.array(list(UNCERTAINTIES.values()))
    exact = RigModel(
        **twin.optics(),
        camera_distortion=lens_of(twin),
        sensor=sensor,
        identifier=f"{sensor} {generator.integers(1 << 30)}",
        parameter_names=names,
        covariance=tuple(np.diag(sigma**2).ravel().tolist()),
    )
    values = parameter_values(exact, names) + sigma * generator.standard_normal(len(names))
    return with_parameters(exact, names, values.tolist())


def phase_of(twin: VirtualRig, position: float, generator: np.random.Generator) -> np.ndarray:
    """Return the phase at a crosshead position [m] with noise [rad], NaN where not lit."""
    view = twin.view(position)
    phase = 2 * math.pi / PITCH * (view.projector_column - (twin.projector_shape[1] - 1) / 2)
    phase = np.where(view.lit, phase, np.nan) + NOISE * generator.standard_normal(twin.shape)
    return np.asarray(phase)


def shape_of(twin: VirtualRig, model: RigModel, position: float, generator: np.random.Generator) -> xr.Dataset:
    """Return the surface that a calibrated sensor measures."""
    return model.reconstruct(phase_of(twin, position, generator), PITCH, np.full(twin.shape, NOISE))


def sequence_of(twin: VirtualRig) -> PatternSequence:
    """Return the fringes of a step."""
    height, width = twin.projector_shape
    return fringe_sequence(width, height, [float(width), width / 5, PITCH], [4, 4, 8])


def record(
    target: Path,
    rigs: Mapping[str, VirtualRig],
    models: Mapping[str, RigModel],
    steps: Sequence[tuple[dict[str, Any] | None, float]],
    *,
    crosstalk: bool = False,
    dark: Mapping[str, Sequence[int]] | None = None,
) -> Path:
    """Write a recording of several sensors that light up one after the other.

    Parameters
    ----------
    target
        The recording.
    rigs, models
        Sensors and their calibrations by name.
    steps
        Specimen (None: that of the rigs) and crosshead position [m] of each step.
    crosstalk
        All projectors are lit at once.
    dark
        Steps in which the projector of a sensor stays dark.
    """
    known = BagReader(RECORDED).topics
    types = get_typestore(Stores.EMPTY)
    with BagWriter(target) as writer:
        for sensor in rigs:
            for name in ("camera/image_raw", "camera/exposure", "calibration", "experiment/reference"):
                topic = known[f"/rig/{name}"]
                text = _present(topic)
                types.register(get_types_from_msg(text, topic.type_name))
                own = Topic(f"/rig/{sensor}/{name}", topic.type_name, text, topic.encoding, "", topic.qos)
                writer.add_recorded_topic(own)
        clock = iter(range(1, 1 << 30))
        header = types.types["std_msgs/msg/Header"]
        time = types.types["builtin_interfaces/msg/Time"]

        def stamped() -> tuple[Any, int]:
            seconds = 1_700_000_000 + next(clock)
            return header(stamp=time(sec=seconds, nanosec=0), frame_id=""), seconds * 1_000_000_000

        def write(topic: str, type_name: str, stamp: int, **fields: Any) -> None:
            message = types.types[type_name](**fields)
            writer.write(topic, bytes(types.serialize_cdr(message, type_name)), stamp, stamp)

        for sensor, model in models.items():
            head, stamp = stamped()
            kind = "fringedic_msgs/msg/RigCalibration"
            empty = {"distortion_order": 0, "distortion_columns": [], "distortion_rows": []}
            fields = {"header": head} | empty | model.message_fields()
            arrays = {
                name: np.asarray(value, float) if isinstance(value, list) and name != "parameter_names" else value
                for name, value in fields.items()
            }
            write(f"/rig/{sensor}/calibration", kind, stamp, **arrays)
            head, stamp = stamped()
            kind = "fringedic_msgs/msg/Reference"
            of_step_0 = {"experiment": "several", "step": 0, "previous_lost": False}
            write(f"/rig/{sensor}/experiment/reference", kind, stamp, header=head, **of_step_0)
        number = 0
        for step, (specimen, position) in enumerate(steps):
            seen = {name: rig if specimen is None else rig.with_specimen(specimen) for name, rig in rigs.items()}
            for sensor, twin in seen.items():
                sequence = sequence_of(twin)
                others = [each for name, each in seen.items() if name != sensor]
                for index, (image, pattern) in enumerate(zip(sequence, sequence.patterns, strict=True)):
                    number += 1
                    shown = np.zeros_like(image) if step in (dark or {}).get(sensor, ()) else image
                    if crosstalk:
                        grey = twin.expose_beside(shown, position, number, [(each, image) for each in others])
                    else:
                        grey = twin.expose(shown, position, number)
                    head, stamp = stamped()
                    rows, columns = grey.shape
                    write(
                        f"/rig/{sensor}/camera/image_raw",
                        "sensor_msgs/msg/Image",
                        stamp,
                        header=head,
                        height=rows,
                        width=columns,
                        encoding="mono8",
                        is_bigendian=0,
                        step=columns,
                        data=grey.ravel(),
                    )
                    kind = "fringedic_msgs/msg/Exposure"
                    values: dict[str, Any] = {
                        "header": head,
                        "sensor": sensor,
                        "experiment": "several",
                        "step": step,
                        "index": index,
                        "count": len(sequence),
                        "kind": int(pattern.kind),
                        "orientation": int(pattern.orientation),
                        "pitch": pattern.pitch,
                        "shift": pattern.shift,
                        "shifts": pattern.shifts,
                        "exposure_time": 0.01,
                        "dropped": 0,
                        "image_crc": zlib.crc32(grey.tobytes()),
                    }
                    write(f"/rig/{sensor}/camera/exposure", kind, stamp, **values)
    return target


def _present(topic: Topic) -> str:
    """Return the definition of a message type as it is now; the nested types have not changed."""
    package, _, name = topic.type_name.split("/")
    file = MESSAGES / f"{name}.msg"
    if package != "fringedic_msgs":
        return topic.definition
    nested = topic.definition.partition("=" * 80)
    return f"{file.read_text('utf-8')}\n{nested[1]}{nested[2]}"


def recorded_balls(bag: Path) -> tuple[dict[str, VirtualRig], dict[str, RigModel], Path]:
    """Return two sensors at a plate, their calibrations, and their recording of three balls in two places."""
    generator = np.random.default_rng(3)
    rigs = virtual_sensors("plate", size="tiny")
    models = {name: drawn_model(rig, name, generator) for name, rig in rigs.items()}
    return rigs, models, record(bag, rigs, models, [({**BALLS, "centres_mm": each}, 0.0) for each in PLACES[:2]])
