"""Messages of recordings of earlier versions have the fields of the present one."""

from __future__ import annotations

from math import isnan
from pathlib import Path
from typing import Any

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fringedic.recording import BagWriter, Topic
from fringedic.recording.reader import BagReader
from fringedic.steps.remarks import Correction, CorrectionKind, Remark
from fringedic.steps.sentences import remark_sentence

STATUS = "fringedic_msgs/msg/NodeStatus"
DEFINITION = f"""
std_msgs/Header header
string node
string experiment
uint32 step
uint16 error_code
string error_message
float64 valid_fraction
bool relative
uint32 reference_step
uint32 correlated_step
uint32 window
string method
float64 rms
uint32 frames
float64 duration
{"=" * 80}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{"=" * 80}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def recorded(bag: Path, **fields: Any) -> Any:
    """Return a status that version 0.1 recorded, as it is read."""
    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_msg(DEFINITION, STATUS))
    time = types.types["builtin_interfaces/msg/Time"](sec=1, nanosec=2)
    values: dict[str, Any] = {"error_code": 0, "error_message": "", "valid_fraction": 0.5, "relative": False}
    values |= {"reference_step": 0, "correlated_step": 3, "window": 0, "method": "", "rms": 0.25, "frames": 8}
    values |= {"node": "phase", "experiment": "plate", "step": 4, "duration": 0.1, **fields}
    header = types.types["std_msgs/msg/Header"](stamp=time, frame_id="")
    message = types.types[STATUS](header=header, **values)
    with BagWriter(bag) as writer:
        writer.add_recorded_topic(Topic("/phase/status", STATUS, DEFINITION, "ros2msg", "", ""))
        writer.write("/phase/status", bytes(types.serialize_cdr(message, STATUS)), log_time=1, publish_time=1)
    [(_, read, _)] = BagReader(bag).messages()
    return read


def test_corrections_of_the_phase_were_its_method(tmp_path: Path) -> None:
    status = recorded(tmp_path / "bag", method="lens blur 0.8 px, harmonics")
    expected = [Correction(CorrectionKind.LENS_BLUR, 0.8), Correction(CorrectionKind.HARMONICS)]
    assert [Correction.of_message(each) for each in status.corrections] == expected
    assert (status.method, status.phase_sigma, status.skipped) == ("", 0.25, False)
    assert isnan(status.rms_displacement)


def test_remarks_on_a_success_were_its_error_message(tmp_path: Path) -> None:
    words = "the phase of one image is relative: true up to the same number of whole fringes everywhere"
    status = recorded(tmp_path / "bag", error_message=words)
    assert [remark_sentence(Remark.of_message(each)) for each in status.remarks] == [words]
    assert status.error_message == ""


@pytest.mark.parametrize(("node", "field"), [("dic", "rms_displacement_px"), ("coupling", "rms_displacement")])
def test_the_method_of_the_correlation_stays_and_its_unit_is_in_the_name(tmp_path: Path, node: str, field: str) -> None:
    status = recorded(tmp_path / "bag", node=node, method="zoi", window=24)
    assert (status.method, status.window, status.correlated_step, getattr(status, field)) == ("zoi", 24, 3, 0.25)
    assert (status.corrections, isnan(status.phase_sigma)) == ([], True)


def test_a_failure_named_its_step_and_a_white_step_had_no_figures(tmp_path: Path) -> None:
    words = "experiment 'plate', step 4: frame 3 arrived twice"
    failed = recorded(tmp_path / "failed", error_code=2, error_message=words, valid_fraction=float("nan"))
    assert (failed.error_message, failed.skipped, failed.remarks) == ("frame 3 arrived twice", False, [])
    assert recorded(tmp_path / "white", valid_fraction=float("nan")).skipped
