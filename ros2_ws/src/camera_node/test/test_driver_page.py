"""The page about drivers, word by word: its package is installed, and the camera node takes frames with it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest

from camera_node.testing import Studio
from fringedic_msgs.srv import CaptureFrame
from fringedic_ros.images import image_array
from fringedic_ros.testing import NodeProcess

PAGE = Path(__file__).parents[4] / "docs" / "drivers.md"
IMAGE = np.random.default_rng(5).integers(0, 255, (24, 32), np.uint8)


class Snapshots(BaseHTTPRequestHandler):
    """A network camera."""

    def do_GET(self) -> None:
        data = cv2.imencode(".png", IMAGE)[1].tobytes() if self.path == "/image.png" else b"no image"
        self.send_response(200)
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, *_: object) -> None:
        pass


def test_the_package_of_the_page_is_a_camera(studio: Studio, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, site = tmp_path / "source", tmp_path / "site"
    source.mkdir()
    text = PAGE.read_text()
    for name, kind in (("pyproject.toml", "toml"), ("snapshot_camera.py", "python")):
        (source / name).write_text(re.search(rf"`{name}`.*?```{kind}\n(.*?)```", text, re.DOTALL)[1])
    install = re.search(r"^pip (install .*) \.$", text, re.MULTILINE)[1].split()
    command = [sys.executable, "-m", "pip", *install, "--quiet", "--no-index", "--target", str(site), str(source)]
    subprocess.run(command, check=True)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")]))
    server = HTTPServer(("127.0.0.1", 0), Snapshots)
    serving = threading.Thread(target=server.serve_forever)
    serving.start()
    try:
        address = f"http://127.0.0.1:{server.server_port}/image.png"
        with NodeProcess("camera_node.camera_node", tmp_path, {"source": "snapshot", "url": address}):
            response = studio.capture()
            assert response.error_code == CaptureFrame.Request.NONE, response.error_message
            np.testing.assert_array_equal(image_array(studio.frame(response.stamp)[0]), IMAGE)
    finally:
        server.shutdown()
        serving.join()
        server.server_close()
