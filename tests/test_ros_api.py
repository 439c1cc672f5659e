"""Every name of ROS 2 that the code uses is in the table of docs/ros_api.md, and the installed distribution has it."""

from __future__ import annotations

import ast
import importlib
import os
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from rclpy.action.client import ActionClient, ClientGoalHandle
from rclpy.action.server import ActionServer, ServerGoalHandle
from rclpy.client import Client
from rclpy.clock import Clock
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.timer import Timer

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "ros_api.md"
FOLDERS = ("ros2_ws/src", "tests", "benchmarks")
PACKAGES = re.compile(
    r"(rclpy|launch|launch_ros|ament_index_python|rosidl\w*|rosbag2\w*|rpyutils|\w+_(msgs|interfaces))$"
)
OWN = "fringedic_msgs"
# the class that a member is listed with is the first that has it
CLASSES = (
    *(Node, LifecycleNode, Publisher, Subscription, Client, Service, ActionClient, ClientGoalHandle, ActionServer),
    *(ServerGoalHandle, Future, SingleThreadedExecutor, Timer, Clock, Context, Parameter),
)
ROW = re.compile(r"\| `(?P<name>[\w.]+)` \| (?P<jazzy>[^|]*) \| (?P<kilted>[^|]*) \| (?P<lyrical>[^|]*) \|")
ABSENT = "no"


def sources() -> Iterator[ast.AST]:
    """Yield the syntax trees of all modules except those of the library, which imports no ROS."""
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            if not path.is_relative_to(ROOT / "ros2_ws/src/fringedic"):
                yield ast.parse(path.read_text())


def imported(tree: ast.AST) -> Iterator[str]:
    """Yield the full name of each import from a package of ROS 2."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        else:
            continue
        yield from (name for name in names if PACKAGES.match(package := name.split(".")[0]) and package != OWN)


def members(tree: ast.AST) -> Iterator[str]:
    """Yield attributes that are members of classes or of the module of rclpy; their names contain an underscore."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Attribute) or node.attr.startswith("_"):
            continue
        if isinstance(node.value, ast.Name) and node.value.id == "rclpy" and node.attr.islower():
            yield f"rclpy.{node.attr}"
        elif "_" in node.attr and (owner := next((each for each in CLASSES if hasattr(each, node.attr)), None)):
            yield f"{owner.__name__}.{node.attr}"


@cache
def used() -> frozenset[str]:
    return frozenset(name for tree in sources() for name in (*imported(tree), *members(tree)))


@pytest.fixture(scope="module")
def table() -> dict[str, dict[str, str]]:
    return {row["name"]: row.groupdict() for row in ROW.finditer(PAGE.read_text())}


def test_every_used_name_is_in_the_table(table: dict[str, dict[str, str]]) -> None:
    assert sorted(used() - table.keys()) == [], "look it up for each distribution, and add it to docs/ros_api.md"


def test_the_table_has_no_name_that_is_not_used(table: dict[str, dict[str, str]]) -> None:
    """Members that the installed distribution does not have cannot be found in the code."""
    assert sorted(name for name in table.keys() - used() if is_installed(name)) == []


def test_the_installed_distribution_has_what_the_table_states(table: dict[str, dict[str, str]]) -> None:
    distribution = os.environ["ROS_DISTRO"]
    stated = {name for name, row in table.items() if row[distribution].strip() != ABSENT}
    assert {name for name in table if is_installed(name)} == {name for name in stated if has_package(name)}


def has_package(name: str) -> bool:
    """Return whether the package of a name is installed: the Python package index has not all of them."""
    package = name.split(".")[0]
    if package in {each.__name__ for each in CLASSES}:
        return True
    try:
        get_package_prefix(package)
    except PackageNotFoundError:
        return False
    return True


def is_installed(name: str) -> bool:
    """Return whether a name can be imported, or is a member of its class."""
    first, *rest = name.split(".")
    found: object = next((each for each in CLASSES if each.__name__ == first), None)
    if found is None:
        try:
            found = importlib.import_module(first)
        except ImportError:
            return False
    path = first
    for part in rest:
        path += f".{part}"
        if not hasattr(found, part):
            try:
                importlib.import_module(path)
            except ImportError:
                return False
        found = getattr(found, part)
    return True
