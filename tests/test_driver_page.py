"""The page about drivers, word by word: its package is installed, and three nodes work with its devices."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest
import rclpy

from camera_node.testing import Studio
from fringedic.patterns.pattern import PatternKind, ProjectedPattern
from fringedic.patterns.render import render_pattern
from fringedic_msgs.msg import LoadState
from fringedic_msgs.srv import CaptureFrame, ShowPattern
from fringedic_ros.images import image_array
from fringedic_ros.qos import SAMPLES
from fringedic_ros.testing import NodeProcess

PAGE = Path(__file__).parents[1] / "docs" / "drivers.md"
IMAGE = np.random.default_rng(5).integers(0, 255, (24, 32), np.uint8)
ANSWERS = {"/image.png": cv2.imencode(".png", IMAGE)[1].tobytes(), "/reading": b"5200 1.25 hold"}


class Network(BaseHTTPRequestHandler):
    """A network camera and the display of a press."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.end_headers()
        self.wfile.write(ANSWERS.get(self.path, b"nothing"))

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def address() -> Iterator[str]:
    server = HTTPServer(("127.0.0.1", 0), Network)
    serving = threading.Thread(target=server.serve_forever)
    serving.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    serving.join()
    server.server_close()


@pytest.fixture
def studio() -> Iterator[Studio]:
    rclpy.init()
    studio = Studio()
    yield studio
    studio.destroy_node()
    rclpy.shutdown()


def test_devices_of_the_page(studio: Studio, address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, site, slides = tmp_path / "source", tmp_path / "site", tmp_path / "slides"
    source.mkdir()
    slides.mkdir()
    text = PAGE.read_text()
    for name, kind in (("pyproject.toml", "toml"), ("laboratory_devices.py", "python")):
        (source / name).write_text(re.search(rf"`{name}`.*?```{kind}\n(.*?)```", text, re.DOTALL)[1])
    install = re.search(r"^pip (install .*) \.$", text, re.MULTILINE)[1].split()
    command = [sys.executable, "-m", "pip", *install, "--quiet", "--no-index", "--target", str(site), str(source)]
    subprocess.run(command, check=True)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")]))
    states: list[LoadState] = studio.listen(LoadState, "load_frame/state", SAMPLES)
    show = studio.create_client(ShowPattern, "projector/show")
    camera = {"source": "snapshot", "url": f"{address}/image.png"}
    projector = {"source": "folder", "folder": str(slides), "width": 64, "height": 48}
    machine = {"source": "press", "url": f"{address}/reading", "rate_hz": 10.0}
    with (
        NodeProcess("camera_node.camera_node", tmp_path, camera),
        NodeProcess("fringe_projector_node.projector_node", tmp_path, projector),
        NodeProcess("load_frame_node.load_frame_node", tmp_path, machine) as load_frame,
    ):
        response = studio.capture()
        assert response.error_code == CaptureFrame.Request.NONE, response.error_message
        np.testing.assert_array_equal(image_array(studio.frame(response.stamp)[0]), IMAGE)
        shown = studio.ask(show, ShowPattern.Request(kind=int(PatternKind.WHITE)), "the projector").shown
        slide = slides / f"{shown.sec}{shown.nanosec:09d}.png"
        white = render_pattern(ProjectedPattern(PatternKind.WHITE), 64, 48)
        np.testing.assert_array_equal(cv2.imread(str(slide), cv2.IMREAD_GRAYSCALE), white)
        studio.wait(lambda: states, "a sample of the press")
        assert (states[0].mode, states[0].force, states[0].position) == (LoadState.HOLD, 5200.0, 1.25e-3)
    assert "no hold was accepted" not in load_frame.log, "this machine is held by hand"
