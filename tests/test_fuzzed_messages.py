"""Short forms of the fuzzers of messages; their long forms are in `fuzzed_messages`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy
from fuzzed_messages import fuzz, fuzz_decoding, fuzz_processing, recorded_messages
from running_system import RecordedExperiment


@pytest.fixture(scope="module", autouse=True)
def ros(domain: str) -> Iterator[None]:
    """ROS in the domain of this module."""
    rclpy.init(domain_id=int(domain))
    yield
    rclpy.shutdown()


@pytest.mark.parametrize("node", ["phase", "coupling", "recorder", "experiment"])
def test_node_lives_on_after_damaged_messages(recorded: RecordedExperiment, node: str, tmp_path: Path) -> None:
    fuzz(node, 500, recorded_messages(recorded.report.folder / "bag"), tmp_path)


def test_damaged_messages_are_refused_by_name(recorded: RecordedExperiment, tmp_path: Path) -> None:
    bag = recorded.report.folder / "bag"
    assert set(fuzz_decoding(bag, 5000)) == {"read", "refused"}
    assert set(fuzz_processing(bag, 3, tmp_path)) <= {"processed", "refused"}
