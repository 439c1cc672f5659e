"""What is done for one middleware alone, and that nothing of it is done for others."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest
from rclpy.node import Node
from rclpy.utilities import get_rmw_implementation_identifier
from std_srvs.srv import Trigger

from fringedic.errors import ProcessError
from fringedic_ros import middleware, rmw
from fringedic_ros.middleware import endpoints, fast_dds, processes
from fringedic_ros.rmw import rmw_implementation
from fringedic_ros.spinning import Spinning
from fringedic_ros.waiting import until

PROFILES = Path(__file__).parents[2] / "fringedic_bringup" / "config"
ENVIRONMENT = Path(__file__).parents[4] / "setup" / "environment.sh"
NAMESPACE = "{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}"
INSTALLED = ("rmw_cyclonedds_cpp", "rmw_fastrtps_cpp", "rmw_zenoh_cpp")


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return a function that replaces the list of what is installed; it can have a selected one."""

    def install(*names: str, selected: str = "") -> None:
        found = dict.fromkeys([*names, "rmw_implementation"], "/opt/ros")
        monkeypatch.setattr(rmw, "get_resources", lambda _: found)
        monkeypatch.setenv("RMW_IMPLEMENTATION", selected)
        if selected:
            monkeypatch.setattr(endpoints, "get_rmw_implementation_identifier", lambda: selected)

    return install


def test_the_one_that_is_loaded_is_stated() -> None:
    assert rmw_implementation() == get_rmw_implementation_identifier()


@pytest.mark.parametrize(
    ("names", "requested", "loaded"),
    [
        (INSTALLED, "", "rmw_fastrtps_cpp"),
        (INSTALLED, "rmw_zenoh_cpp", "rmw_zenoh_cpp"),
        (INSTALLED[::2], "", "rmw_cyclonedds_cpp"),
    ],
)
def test_the_order_of_choice_is_that_of_ros(
    names: tuple[str, ...], requested: str, loaded: str, installed: Callable[..., None]
) -> None:
    installed(*names)
    assert rmw_implementation({"RMW_IMPLEMENTATION": requested}) == loaded


def test_one_that_is_not_installed_is_refused_by_name(installed: Callable[..., None]) -> None:
    with pytest.raises(ProcessError, match=r"RMW_IMPLEMENTATION=rmw_none is not installed, but .*rmw_fastrtps_cpp"):
        rmw_implementation({"RMW_IMPLEMENTATION": "rmw_none"})
    installed()
    with pytest.raises(ProcessError, match="no RMW implementation"):
        rmw_implementation({})


def test_a_command_with_one_that_is_not_installed_ends_with_one_sentence() -> None:
    """The import of rclpy would end its process."""
    command = [sys.executable, "-m", "fringedic"]
    environment = {**os.environ, "RMW_IMPLEMENTATION": "rmw_none"}
    subprocess.run([*command, "run", "--help"], env=environment, stdout=subprocess.DEVNULL, check=True)
    ended = subprocess.run([*command, "run", "tiny"], env=environment, capture_output=True, text=True, check=False)
    assert ended.returncode == 1, ended.stderr
    assert "RMW_IMPLEMENTATION=rmw_none is not installed, but rmw_fastrtps_cpp" in " ".join(ended.stderr.split())


@pytest.mark.parametrize("name", INSTALLED)
def test_only_processes_of_fast_dds_get_its_settings_ports_and_shared_memory(
    name: str, installed: Callable[..., None], monkeypatch: pytest.MonkeyPatch, domain: int
) -> None:
    installed(*INSTALLED, selected=name)
    monkeypatch.setenv(fast_dds.VARIABLE, "unchanged")
    left = fast_dds.SHARED_MEMORY / "fastrtps_00000000000000cc"
    left.write_bytes(b"segment")
    try:
        variables = middleware.settings({**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, PROFILES)
        middleware.enter(domain)
        middleware.remove_leftovers()
        done = bool(variables), os.environ[fast_dds.VARIABLE] != "unchanged", not left.exists()
    finally:
        left.unlink(missing_ok=True)
    assert done == (name == "rmw_fastrtps_cpp",) * 3


@pytest.mark.skipif(not Path(sys.prefix, "lib", "private_memory.so").exists(), reason="set-up made no environment")
@pytest.mark.parametrize("name", ["", *INSTALLED])
def test_the_libraries_that_correct_fast_dds_are_loaded_with_it_alone(name: str) -> None:
    environment = {**os.environ, "RMW_IMPLEMENTATION": name, "LD_PRELOAD": ""}
    command = ["bash", "-c", f'. "{ENVIRONMENT}" && . "{ENVIRONMENT}" && printf "$LD_PRELOAD"']
    loaded = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    assert loaded.count("private_memory.so") == (name in ("", "rmw_fastrtps_cpp"))


@pytest.mark.parametrize(
    ("distribution", "variable"),
    [("jazzy", "FASTRTPS_DEFAULT_PROFILES_FILE"), ("kilted", "FASTDDS_DEFAULT_PROFILES_FILE")],
)
def test_the_profile_has_the_variable_of_its_version(distribution: str, variable: str) -> None:
    environment = {"ROS_DISTRO": distribution, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    profile = fast_dds.settings(environment, PROFILES)[variable]
    assert Path(profile).is_file()
    assert variable not in fast_dds.settings({**environment, variable: "mine.xml"}, PROFILES)


def test_the_profiles_of_both_versions_are_the_same() -> None:
    old, new = (ElementTree.parse(PROFILES / f"{version}.xml").getroot() for version in ("fastrtps", "fastdds"))
    for renamed in old.iter(f"{NAMESPACE}heartbeatPeriod"):
        renamed.tag = f"{NAMESPACE}heartbeat_period"
    assert ElementTree.canonicalize(ElementTree.tostring(old), strip_text=True) == ElementTree.canonicalize(
        ElementTree.tostring(new), strip_text=True
    )


def test_the_profile_is_accepted_by_the_version_that_is_installed(domain: int) -> None:
    """It is rejected as a whole when a version does not know an element of it: its nodes then have no setting."""
    program = "import rclpy\nrclpy.init()\nrclpy.create_node('a').destroy_node()\nrclpy.shutdown()"
    ended = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "ROS_DOMAIN_ID": str(domain)},
        capture_output=True,
        check=True,
    )
    assert b"XMLPARSER" not in ended.stdout + ended.stderr


def test_an_address_that_is_set_is_not_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a computer with several addresses and no default route the choice is refused."""

    def refuse(_: str) -> str:
        raise ProcessError("this computer has several addresses")

    monkeypatch.setattr(fast_dds, "own_address", refuse)
    environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    with pytest.raises(ProcessError):
        processes.settings(environment, PROFILES)
    assert "FRINGEDIC_ADDRESS" not in processes.settings({**environment, "FRINGEDIC_ADDRESS": "10.0.0.2"}, PROFILES)


def test_processes_are_told_apart_by_identifiers_or_by_names(installed: Callable[..., None]) -> None:
    listed = [
        SimpleNamespace(node_name=name, node_namespace="/rig", endpoint_gid=[process] * 12 + [0, 0, number, 0])
        for name, process, number in [("phase", 1, 1), ("dic", 1, 2), ("phase", 2, 1)]
    ]
    for name, distinct in [("rmw_cyclonedds_cpp", [0, 0, 2]), ("rmw_zenoh_cpp", [0, 1, 0])]:
        installed(*INSTALLED, selected=name)
        found = [middleware.process_of(each) for each in listed]
        assert [found.index(each) for each in found] == distinct


@pytest.mark.parametrize("name", ["", "rmw_zenoh_cpp"])
def test_servers_of_a_service_are_listed(name: str, spinning: Spinning, installed: Callable[..., None]) -> None:
    asker, server = spinning.add(Node("asker")), Node("server")
    installed(*INSTALLED, selected=name)
    assert not middleware.servers_of(asker, "serve")
    server.create_service(Trigger, "serve", lambda _, response: response)

    async def listed(count: int) -> None:
        await until(asker, lambda: len(middleware.servers_of(asker, "serve")) == count, 30.0)

    spinning.run(listed, 1, timeout_s=60.0)
    server.destroy_node()
    spinning.run(listed, 0, timeout_s=60.0)
