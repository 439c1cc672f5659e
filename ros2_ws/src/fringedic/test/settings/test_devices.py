"""Kinds of a device: those of the project, and those of installed packages."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from pydantic import ValidationError

from fringedic.configuration.rig_file import load_rig_file
from fringedic.errors import ConfigurationError
from fringedic.settings import devices
from fringedic.settings.camera import CAMERAS, AravisCamera, CameraNodeSettings, FilesCamera
from fringedic.settings.parameters import from_parameters, parameter_fields, to_parameters

MODEL = """
from typing import ClassVar, Literal
from pydantic import Field
from fringedic.settings import CameraSettings

class LabCamera(CameraSettings):
    driver: ClassVar[str] = "{module}:Driver"
    source: Literal["{source}"] = "{source}"
    files: int = Field(3, ge=1, description="A name that a source of the project uses for something else.")

class Driver:
    def __init__(self, settings, node):
        self.opened = settings, node
"""
Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Install packages of drivers as pip does it: a module, and the metadata with its entry point."""
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(str(site))
    devices.installed_sources.cache_clear()

    def installed(module: str, source: str, *, text: str = MODEL, entry: str = "LabCamera", name: str = "") -> None:
        (site / f"{module}.py").write_text(text.replace("{source}", source).replace("{module}", module))
        metadata = site / f"{module}-1.0.dist-info"
        metadata.mkdir()
        (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module.replace('_', '-')}\nVersion: 1.0\n")
        entries = f"[fringedic.cameras]\n{name or source} = {module}:{entry}\n"
        (metadata / "entry_points.txt").write_text(entries)

    yield installed
    devices.installed_sources.cache_clear()


def rig_file(folder: Path, camera: dict) -> Path:
    file = folder / "rig.yaml"
    file.write_text(yaml.safe_dump({"camera": camera}))
    return file


def test_aninstalled_sources_driver_is_a_source_like_the_others(install: Install, tmp_path: Path) -> None:
    install(
        "first_lab",
        "first",
    )
    rig = load_rig_file(rig_file(tmp_path, {"source": "first", "files": 5, "width": 640, "height": 480}))
    assert (rig.camera.files, rig.camera_size(), CAMERAS.sources[-1]) == (5, (640, 480), "first")
    node = CameraNodeSettings(device=rig.camera, frame_rate_hz=4.0)
    again = from_parameters(CameraNodeSettings, to_parameters(node))
    assert again == node
    assert type(again.device) is type(rig.camera)
    driver = again.device.open("node")
    assert driver.opened == (again.device, "node")
    with pytest.raises(ConfigurationError, match=r"camera\.files: Input should be greater than or equal to 1"):
        load_rig_file(rig_file(tmp_path, {"source": "first", "files": 0, "width": 640, "height": 480}))
    with pytest.raises(ConfigurationError, match=r"camera: source: first needs width and height"):
        load_rig_file(rig_file(tmp_path, {"source": "first"}))


def test_packages_that_cannot_be_used_are_named_with_the_cure(install: Install, tmp_path: Path) -> None:
    install("no_sdk", "broken", text="import vendor_sdk\n")
    install("second_aravis", "aravis")
    install("one_lab", "twice")
    install("other_lab", "twice")
    install("no_model", "plain", text="class LabCamera: ...\n")
    install("no_class", "gone", entry="NoSuchClass")
    install("renamed", "inner", name="outer")
    for source, sentence in (
        (
            "broken",
            "source broken: the package no-sdk cannot be imported (ModuleNotFoundError: No module named 'vendor_sdk'); "
            "repair or reinstall it, or use another source",
        ),
        (
            "aravis",
            "source aravis is that of the packages fringedic and second-aravis; rename it in second-aravis, or "
            "uninstall this package",
        ),
        ("twice", "is that of the packages"),
        ("plain", "no_model:LabCamera of the package no-model is no CameraSettings; let its entry point name the"),
        ("gone", "source gone: the package no-class cannot be imported (AttributeError"),
        ("outer", "renamed:LabCamera of the package renamed has the source 'inner'; give its entry point the same"),
        ("unknown", "source 'unknown' is unknown; known are virtual, files, video, aravis, v4l2, topic, "),
    ):
        with pytest.raises(ConfigurationError, match=re.escape(sentence)):
            load_rig_file(rig_file(tmp_path, {"source": source, "width": 640, "height": 480}))
    # they are in the way of no other source
    assert load_rig_file(rig_file(tmp_path, {"source": "files", "files": "a"})).camera.source == "files"


def test_a_setting_with_the_name_of_a_parameter_of_the_node_is_refused(install: Install, tmp_path: Path) -> None:
    install("eager_camera", "eager", text=MODEL.replace("files: int", "frame_rate_hz: int"))
    rig = load_rig_file(rig_file(tmp_path, {"source": "eager", "width": 640, "height": 480}))
    with pytest.raises(ConfigurationError, match="source eager: frame_rate_hz of eager_camera"):
        to_parameters(CameraNodeSettings(device=rig.camera))


def test_a_driver_that_cannot_be_imported_is_named(install: Install) -> None:
    install("half_lab", "half", text=MODEL.replace('"{module}:Driver"', '"{module}_driver:Driver"'))
    camera = CAMERAS.model("half")()
    with pytest.raises(ConfigurationError, match=r"source half: its driver half_lab_driver:Driver cannot be imported"):
        camera.open()


def test_paths_are_relative_to_the_file_that_names_them(tmp_path: Path) -> None:
    rig = load_rig_file(rig_file(tmp_path, {"source": "files", "files": "images/*.tif"}))
    assert rig.camera.files == str(tmp_path / "images" / "*.tif")
    assert FilesCamera(files="images").files == "images"


def test_a_node_has_the_parameters_of_its_source() -> None:
    settings = CameraNodeSettings(device=AravisCamera(trigger="external_edge"), virtual_rig={"preset": "skin"})
    parameters = to_parameters(settings)
    assert list(parameters) == [*parameter_fields(CameraNodeSettings, AravisCamera)]
    assert (parameters["trigger"], parameters["virtual_rig"]) == ("external_edge", "{preset: skin}")
    assert "repeat" not in parameters
    assert from_parameters(CameraNodeSettings, parameters) == settings


@pytest.mark.parametrize(
    ("parameters", "place", "words"),
    [
        ({"exposure_ms": -1.0}, ("exposure_ms",), "greater than 0"),
        ({"exposure_ms": math.nan}, ("exposure_ms",), "finite"),
        ({"source": "aravis", "trigger": "bell"}, ("trigger",), "'internal', 'software'"),
        ({"virtual_rig": "{preset: tent}"}, ("virtual_rig",), "preset 'tent' is unknown"),
        ({"source": "files"}, (), "source: files needs the key files"),
        ({"source": "v4l2"}, (), "source: v4l2 needs the key camera"),
        ({"source": "topic"}, (), "source: topic needs the key topic"),
        ({"source": "aravis", "first_row": 3}, (), "first_row need width and height"),
        ({"width": 3}, (), "width is 3; at least 16 px are needed"),
        ({"frame_rate_hz": 5000.0}, ("frame_rate_hz",), "less than or equal to 1000"),
    ],
)
def test_a_wrong_parameter_is_named(parameters: dict, place: tuple[str, ...], words: str) -> None:
    with pytest.raises(ValidationError) as refused:
        from_parameters(CameraNodeSettings, parameters)
    [problem] = refused.value.errors()
    assert problem["loc"] == place
    assert words in problem["msg"]


def test_a_text_that_is_no_yaml_is_named() -> None:
    with pytest.raises(ConfigurationError, match="virtual_rig is not valid YAML: line 1"):
        from_parameters(CameraNodeSettings, {"virtual_rig": "{preset"})
