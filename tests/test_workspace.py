"""The workspace as ROS 2 tools see it: package types, declared dependencies, executables."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from configparser import ConfigParser
from pathlib import Path

import pytest
import yaml
from ament_index_python import get_package_prefix, get_package_share_directory

import fringedic

SOURCES = Path(__file__).resolve().parent.parent / "ros2_ws" / "src"
PACKAGES = sorted(path.parent.name for path in SOURCES.glob("*/package.xml"))
OWN_KEYS = set(yaml.safe_load((SOURCES.parent.parent / "setup" / "rosdep.yaml").read_text()))
# Modules whose key of the rosdep database is not python3-<module>
ROSDEP_KEYS = {
    "cv2": "python3-opencv",
    "PIL": "python3-pil",
    "pydantic_core": "python3-pydantic",  # which is in two parts
    "rosbags": "python3-rosbags-pip",
    "skimage": "python3-skimage",
}
ROS_MODULES = re.compile(r"rclpy|launch|launch_ros|ament_index_python|.*_(msgs|srvs|interfaces)")
EXECUTABLES = {
    "camera_node": ["camera", "live_view"],
    "coupling_node": ["coupling"],
    "dic_node": ["dic", "extensometer"],
    "experiment_node": ["experiment"],
    "fringe_projector_node": ["projector"],
    "fringedic_bringup": ["fringedic", "processing"],
    "load_frame_node": ["load_frame", "signals", "stage"],
    "operator_node": ["operator"],
    "phase_node": ["phase"],
    "player_node": ["player"],
    "recorder_node": ["recorder"],
}


def imported_by(folder: Path) -> set[str]:
    """Top-level modules, other than Python's own, that the files of a folder import."""
    modules = set()
    for file in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                modules |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                modules.add(node.module.split(".")[0])
    return modules - sys.stdlib_module_names


def key_of(module: str) -> str:
    """Return the rosdep key of a module: that of a ROS package, of the database, or of this repository."""
    if module in PACKAGES or ROS_MODULES.fullmatch(module):
        return module
    own = f"python3-{module.replace('_', '-')}-pip"
    return own if own in OWN_KEYS else ROSDEP_KEYS.get(module, f"python3-{module}")


def declared_by(package: str, kind: str) -> set[str | None]:
    """Keys that a package.xml names as `exec_depend` or `test_depend`."""
    return {element.text for element in ElementTree.parse(SOURCES / package / "package.xml").iter(kind)}


def test_every_package_has_its_ros_type() -> None:
    # an invalid package.xml would turn a package into a plain Python one without a word
    command = [sys.executable, "-m", "colcon", "--log-base", os.devnull, "list", "--base-paths", str(SOURCES)]
    listed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    types = {line.split("\t")[0]: line.split("\t")[2] for line in listed.splitlines()}
    expected = dict.fromkeys(PACKAGES, "(ros.ament_python)") | {"fringedic_msgs": "(ros.ament_cmake)"}
    assert types == expected
    assert len(types) == 14


@pytest.mark.parametrize("package", [package for package in PACKAGES if package != "fringedic_msgs"])
def test_declared_dependencies_are_the_imported_ones(package: str) -> None:
    declared = declared_by(package, "exec_depend")
    if "fringedic" in declared:
        declared |= declared_by("fringedic", "exec_depend")
    declared_for_tests = declared_by(package, "test_depend")

    def keys(folder: str) -> set[str]:
        beside = [*(SOURCES / package / folder).rglob("*.py"), *Path(__file__).parent.glob("*.py")]
        own = {package, "pytest"} | {path.stem for path in beside}
        return {key_of(module) for module in imported_by(SOURCES / package / folder) - own}

    missing = (keys(package) | keys("launch")) - declared
    missing_for_tests = keys("test") - declared - declared_for_tests
    assert not missing, f"{package}/package.xml lacks exec_depend {missing}"
    assert not missing_for_tests, f"{package}/package.xml lacks test_depend {missing_for_tests}"


def test_each_key_is_used() -> None:
    declared = set().union(*(declared_by(each, kind) for each in PACKAGES for kind in ("exec_depend", "test_depend")))
    assert declared >= OWN_KEYS


def test_every_field_of_a_message_states_its_unit() -> None:
    """A real number has a unit in brackets, or is a share."""
    for file in (SOURCES / "fringedic_msgs").glob("[msa]*/*.[msa]*"):
        for line in file.read_text().splitlines():
            if re.match(r"float(32|64)(\[.*?\])? ", line):
                assert re.search(r"#.*(\[[^\]]+\]|0 to 1|in the units of)", line), f"{file.name}: {line}"


def test_library_declares_what_it_imports() -> None:
    names = {
        "cv2": "opencv-python-headless",
        "PIL": "pillow",
        "markdown_it": "markdown-it-py",
        "pydantic_core": "pydantic",
        "pygame": "pygame-ce",
        "rfc3161_client": "rfc3161-client",
        "skimage": "scikit-image",
        "yaml": "pyyaml",
    }
    needed = {names.get(module, module) for module in imported_by(SOURCES / "fringedic" / "fringedic")} - {"fringedic"}
    needed |= {"dask", "s3fs"}  # distributed and fsspec load them
    settings = ConfigParser()
    settings.read(SOURCES / "fringedic" / "setup.cfg")
    extras = settings["options.extras_require"]
    declared = settings["options"]["install_requires"].split() + extras["all"].split()
    assert needed == {re.split("[<>=]", name)[0] for name in declared}
    assert set(extras["all"].split()) == {name for extra in extras for name in extras[extra].split()}


def test_all_packages_have_one_version_and_one_setup() -> None:
    versions = {name: ElementTree.parse(SOURCES / name / "package.xml").findtext("version") for name in PACKAGES}
    cited = yaml.safe_load((SOURCES.parent.parent / "CITATION.cff").read_text())["version"]
    assert set(versions.values()) == {fringedic.__version__, cited}, versions
    setups = {path.read_text() for path in SOURCES.glob("*/setup.py") if path.parent.name != "fringedic"}
    assert len(setups) == 1


def test_library_imports_no_ros() -> None:
    ros = {"rclpy", "ament_index_python", "launch", *(package for package in PACKAGES if package != "fringedic")}
    modules = imported_by(SOURCES / "fringedic" / "fringedic")
    assert not {module for module in modules if module in ros or module.endswith(("_msgs", "_srvs", "_interfaces"))}


@pytest.mark.parametrize(("package", "names"), EXECUTABLES.items())
def test_executables_stand_where_ros2_run_looks(package: str, names: list[str]) -> None:
    folder = Path(get_package_prefix(package), "lib", package)
    assert sorted(path.name for path in folder.iterdir()) == names
    assert all(os.access(folder / name, os.X_OK) for name in names)


def test_launch_and_rig_files_are_installed() -> None:
    share = Path(get_package_share_directory("fringedic_bringup"))
    for folder in ("launch", "config"):
        source = {path.name for path in (SOURCES / "fringedic_bringup" / folder).iterdir() if path.is_file()}
        assert {path.name for path in (share / folder).iterdir()} == source
