"""Calibration with an operator instead of a stage, and rigs that are refused before any node starts."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import rclpy
from rcl_interfaces.srv import GetParameters

from fringedic.configuration.changes import with_angles
from fringedic.configuration.rig_file import load_rig_file
from fringedic.errors import ConfigurationError
from fringedic_bringup.client import RigClient
from fringedic_bringup.launch.rig_files import configuration
from fringedic_bringup.procedures.calibrate import calibrate, placing_by
from fringedic_msgs.srv import PlaceReferencePlane
from fringedic_ros.testing import Peer
from fringedic_ros.waiting import RepeatedRequest

Request = PlaceReferencePlane.Request


class Quiet:
    """Progress that is not shown."""

    def stage(self, text: str) -> None:
        pass

    def step(self, number: int, last: int, text: str, frame: int = 0, frames: int = 0) -> None:
        pass

    def part(self, number: int, parts: int, text: str, frame: int = 0, frames: int = 0) -> None:
        pass

    def note(self, text: str) -> None:
        pass


def test_operator_places_the_plane_until_one_stops() -> None:
    asked: list[str] = []

    def ask(words: str) -> bool:
        asked.append(words)
        return "-10.00" not in words

    rclpy.init()
    peer = Peer()
    place = peer.create_client(PlaceReferencePlane, "rig/reference_plane/place")
    try:
        with RigClient("rig", domain=int(os.environ["ROS_DOMAIN_ID"])) as client:
            client.serve_placing(placing_by(ask))

            def answer(**request: float) -> PlaceReferencePlane.Response:
                future = place.call_async(Request(**request))
                peer.wait(lambda: client.sleep(0.05) or future.done(), "the answer")
                return future.result()

            peer.wait(lambda: client.sleep(0.05) or place.service_is_ready(), "the service")
            parameters = peer.create_client(GetParameters, "rig/client/get_parameters")
            with RepeatedRequest(parameters, GetParameters.Request()) as met:  # a response may be lost before
                peer.wait(lambda: client.sleep(0.05) or met.is_answered(), "the client to know the peer")
            assert answer(kind=Request.GRID).success
            turned = answer(kind=Request.PLANE, angle=0.25)
            assert (turned.success, turned.angle) == (True, 0.25)
            stopped = answer(kind=Request.PLANE, angle=-0.17453292519943295)
            assert not stopped.success
            assert "operator" in stopped.message
            assert answer(kind=Request.SPECIMEN).success  # without a question to the operator
    finally:
        peer.destroy_node()
        rclpy.try_shutdown()
    assert len(asked) == 3
    assert asked[0].startswith("Lay the printed grid")
    assert asked[1] == "Turn the plain reference plane to +14.32 degree (right side towards the camera)"


def test_a_place_that_is_requested_again_has_the_reason_in_its_question() -> None:
    asked: list[str] = []

    def ask(words: str) -> bool:
        asked.append(words)
        return True

    place = placing_by(ask, lambda _: "plane 2 was not moved")
    for angle in (0.0, 0.25, 0.25, 0.1):
        assert place(Request.PLANE, angle, 0.0) == ""
    assert [each.startswith("This place was not measured (plane 2 was not moved). Once more: ") for each in asked] == [
        False,
        False,
        True,
        False,
    ]


def test_other_angles() -> None:
    rig = with_angles(load_rig_file(configuration("tiny.yaml")), "0,-10,-5,5,10")
    assert (rig.reference_plane.angles_degree, rig.reference_plane.held_out) == ([0, -10, -5, 5, 10], [4])
    for wrong in ("0,ten", "0,95", ""):
        with pytest.raises(ConfigurationError, match=f"^angles {wrong}: "):
            with_angles(rig, wrong)


def test_the_grid_is_seen_on_both_sides_by_default() -> None:
    rig = load_rig_file(configuration("tiny.yaml"))
    assert np.degrees(rig.reference_plane.grid_angles) == pytest.approx([-12, 12])
    assert np.degrees(with_angles(rig, "0,-20,-5,8,25").reference_plane.grid_angles) == pytest.approx([-5, 8])
    assert with_angles(rig, "0,5,10,15").reference_plane.grid_angles == []
    plane = rig.reference_plane.model_dump()
    assert type(rig.reference_plane).model_validate(plane | {"grid_angles_degree": []}).grid_angles == []
    with pytest.raises(ValueError, match="both sides"):
        type(rig.reference_plane).model_validate(plane | {"grid_angles_degree": [5.0, 10.0]})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "camera: {source: files, files: images}\nprojector: {source: display, width: 80, height: 60}",
            "grid_pitch_mm",
        ),
        ("camera: {source: files, files: images}\nreference_plane: {grid_pitch_mm: 0.5}", "no projector"),
    ],
)
def test_rigs_that_cannot_be_calibrated(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    rig = load_rig_file(path)
    with pytest.raises(ConfigurationError, match=words):
        calibrate(rig, path, tmp_path / "out", Quiet(), ask=lambda _: False)
    assert not (tmp_path / "out").exists()
