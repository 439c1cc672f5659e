"""The clocks of devices in a recording, and the sentences about them."""

from __future__ import annotations

from math import nan
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from fringedic.errors import RecordingError
from fringedic.frames.clocks import ClockEstimate
from fringedic.recording.sentences import clock_sentences
from fringedic.recording.topics import Topic
from fringedic.recording.writer import BagWriter
from fringedic.signals.clocks import recorded_clocks

DRIFT = "fringedic_msgs/msg/ClockDrift"
STAMP, HEADER = "builtin_interfaces/msg/Time", "std_msgs/msg/Header"
SEPARATOR = f"\n{'=' * 80}\n"
DEFINITION = SEPARATOR.join(
    [
        "std_msgs/Header header\nstring clock\nfloat64 offset\nfloat64 drift\nfloat64 drift_sigma\nuint32 samples",
        "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id",
        "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec",
    ]
)


def write(path: Path, clocks: dict[str, list[ClockEstimate]]) -> Path:
    """Write a recording with these estimates by topic."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(DEFINITION, DRIFT))
    with BagWriter(path) as writer:
        for topic, estimates in clocks.items():
            writer.add_recorded_topic(Topic(topic, DRIFT, DEFINITION, "ros2msg", "", ""))
            for each in estimates:
                stamp = store.types[STAMP](*divmod(each.stamp_ns, 1_000_000_000))
                header = store.types[HEADER](stamp, "")
                message = store.types[DRIFT](header, topic, each.offset, each.drift, each.drift_sigma, each.samples)
                writer.write(topic, bytes(store.serialize_cdr(message, DRIFT)), each.stamp_ns, each.stamp_ns)
    return path


def test_the_last_estimate_of_each_device_is_read(tmp_path: Path) -> None:
    estimates = [ClockEstimate(3 * 10**9 + step, 1e-3 * step, 2e-5, 3e-7, 10 + step) for step in range(4)]
    bag = write(tmp_path / "bag", {"/rig/camera/clock": estimates, "/rig/load_frame/clock": estimates[:1]})
    assert recorded_clocks(bag) == {"camera": estimates[-1], "load frame": estimates[0]}


def test_a_recording_without_device_clocks_has_none(tmp_path: Path) -> None:
    assert recorded_clocks(write(tmp_path / "bag", {"/rig/other/clock": [ClockEstimate(0, 0, 0, 0, 0)]})) == {}


def test_a_missing_recording_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="nowhere"):
        recorded_clocks(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("drift", "sigma", "end"),
    [
        (nan, nan, "since the first comparison."),
        (2e-5, nan, "comparison; drift +20.0 ppm."),
        (-2e-5, 3e-7, "comparison; drift -20.0 ppm (standard uncertainty 0.3 ppm)."),
    ],
)
def test_sentence_of_a_clock(drift: float, sigma: float, end: str) -> None:
    (sentence,) = clock_sentences({"load frame": ClockEstimate(0, -2.5e-3, drift, sigma, 3)})
    assert sentence.startswith("Clock of the load frame: -2.500 ms relative to this computer ")
    assert sentence.endswith(end)
