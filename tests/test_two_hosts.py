"""Camera side and processing side on two hosts: steps, lost packets, a link that is cut, and a host that is gone."""

from __future__ import annotations

import time
from collections import defaultdict
from pathlib import Path

import pytest
from running_system import CONFIG
from two_hosts import Side, two_hosts, why_not

from fringedic.frames.records import frame_record, stamp_of
from fringedic.recording.reader import BagReader

RIG_SIDE = ("camera", "projector", "load_frame", "stage")
PROCESSING_SIDE = ("recorder", "phase", "dic", "coupling", "experiment")
STEPS = 5
LOSS = 0.01
CUT_S = 8.0  # longer than the lease of a participant, 6 s in config/fastdds.xml: both sides forget each other
LEASE_S = 20.0  # of a participant and of an action, with some room


def lost_images(bag: Path, steps: set[int]) -> int:
    """Return the exposures of steps whose image is not in a recording."""
    reader = BagReader(bag)
    names = reader.find("camera/image_raw", "camera/exposure")
    images, exposures = set(), defaultdict(set)
    for topic, message, _ in reader.messages(names.values()):
        if topic == names["camera/image_raw"]:
            images.add(stamp_of(message))
        else:
            record = frame_record(message)
            exposures[record.step].add(record.stamp)
    assert steps <= exposures.keys()
    return sum(len(exposures[step] - images) for step in steps)


@pytest.mark.slow
def test_two_hosts_lose_no_frame_of_a_finished_step(domain: str, tmp_path: Path) -> None:
    reason = why_not()
    if reason:
        pytest.skip(reason)
    rig = CONFIG / "tiny.yaml"
    finished: set[int] = set()
    with (
        two_hosts() as (there, here),
        Side(here, rig, tmp_path / "here", PROCESSING_SIDE, domain) as processing,
        Side(there, rig, tmp_path / "there", RIG_SIDE, domain) as camera,
    ):

        def measure(number: int) -> None:
            answer = processing.ask("step", 0.01 * number)
            assert not answer["error"]
            assert answer["frames"] == 12
            finished.add(answer["step"])

        assert not processing.ask("ready")["error"]
        for number in range(STEPS):
            measure(number)
        for host in (there, here):
            host.lose(LOSS)
        for number in range(STEPS):
            measure(number)
        assert there.lost() > 0
        assert here.lost() > 0
        for host in (there, here):
            host.lose(0.0)
        there.plug("down")
        time.sleep(CUT_S)
        there.plug("up")
        measure(STEPS)  # begins with a move, which is requested before the load frame node is found again
        assert not processing.ask("ready")["error"]
        camera.crash()
        answer = processing.ask("step", 0.0)
        assert "the node load_frame is missing: start it, or connect its computer" in answer["error"]
        assert answer["duration"] < LEASE_S
        assert "camera" in processing.ask("measure")["error"]
    bag = tmp_path / "here" / "run" / "bag"
    assert not BagReader(bag).lost
    assert lost_images(bag, finished) == 0
