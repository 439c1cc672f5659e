"""Parameters come from one model: types, defaults, ranges, refusals and the documentation."""

from __future__ import annotations

import time
from enum import StrEnum
from typing import Literal

import pytest
from pydantic import BaseModel, Field, model_validator
from rclpy.node import Node
from rclpy.parameter import Parameter

from fringedic.errors import ConfigurationError
from fringedic.settings.camera import CameraNodeSettings, FilesCamera
from fringedic_msgs.msg import NodeParameters
from fringedic_ros.parameter_docs import documented
from fringedic_ros.parameters import declare, parameter_table
from fringedic_ros.qos import LATCHED_BY_MANY


class Method(StrEnum):
    DENSE = "dense"
    ZOI = "zoi"


class FilterParameters(BaseModel):
    window: int = Field(32, ge=8, le=128, description="Width of the window [px].")
    rate_hz: float = Field(10.0, gt=0.0, description="Rate [Hz].")
    pitches: list[float] = Field([800.0, 40.0], description="Pitches, coarse to fine [px].")
    method: Method = Field(Method.DENSE, description="Estimator.")
    source: Literal["virtual", "files"] = Field("virtual", description="Where images come from.")
    enabled: bool = Field(True, description="Whether it works at all.")
    low: float = Field(0.0, description="Lower end [px].")
    high: float = Field(1.0, description="Upper end [px].")

    @model_validator(mode="after")
    def _ordered(self) -> FilterParameters:
        if self.low >= self.high:
            raise ValueError("low must be below high")
        return self


def node_with(**overrides: object) -> Node:
    return Node("filter", parameter_overrides=[Parameter(name, value=value) for name, value in overrides.items()])


@pytest.mark.usefixtures("ros")
def test_values_come_from_overrides_and_defaults() -> None:
    node = node_with(rate_hz=30, pitches=[100, 10], method="zoi")
    value = declare(node, FilterParameters).value
    assert value == FilterParameters(rate_hz=30.0, pitches=[100.0, 10.0], method=Method.ZOI)
    # a whole number is stored as the float that it stands for
    assert node.get_parameter("rate_hz").type_ is Parameter.Type.DOUBLE
    assert node.describe_parameter("window").integer_range[0].to_value == 128
    assert node.describe_parameter("window").description == "Width of the window [px]."
    node.destroy_node()


@pytest.mark.usefixtures("ros")
@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("rate_hz", float("nan"), "filter.rate_hz = nan: must be a finite number"),
        ("rate_hz", float("inf"), "filter.rate_hz = inf: must be a finite number"),
        ("rate_hz", 0.0, "filter.rate_hz = 0.0: input should be greater than 0"),
        ("window", 7, "filter.window = 7: input should be greater than or equal to 8"),
        ("window", 9.5, "filter.window = 9.5: needs a value of type integer"),
        ("window", True, "filter.window = True: needs a value of type integer"),
        ("rate_hz", "30", "filter.rate_hz = '30': needs a value of type double"),
        ("pitches", [40.0, float("nan")], "must be a finite number"),
        ("pitches", 40.0, "needs a value of type double array"),
        ("source", "web", "input should be 'virtual' or 'files'"),
        ("low", 2.0, "low must be below high"),
    ],
)
def test_bad_value_is_refused_in_words(name: str, value: object, words: str) -> None:
    node = node_with(**{name: value})
    with pytest.raises(ConfigurationError, match=r"^filter") as caught:
        declare(node, FilterParameters)
    assert words in str(caught.value)
    node.destroy_node()

    node = node_with()
    parameters = declare(node, FilterParameters)
    before = parameters.value
    result = node.set_parameters([Parameter(name, value=value)])[0]
    assert not result.successful
    assert name in result.reason or "Wrong parameter type" in result.reason
    assert parameters.value == before
    assert node.get_parameter(name).value == (before.model_dump(mode="json")[name])
    node.destroy_node()


@pytest.mark.usefixtures("ros")
def test_changes_are_taken_published_and_told() -> None:
    node, reader = node_with(), Node("reader")
    told: list[FilterParameters] = []
    parameters = declare(node, FilterParameters, told.append)
    published: list[NodeParameters] = []
    reader.create_subscription(NodeParameters, "node_parameters", published.append, LATCHED_BY_MANY)

    def read(count: int) -> NodeParameters:
        import rclpy

        deadline = time.monotonic() + 180
        while len(published) < count and time.monotonic() < deadline:
            rclpy.spin_once(reader, timeout_sec=0.1)
        assert len(published) == count
        return published[-1]

    late = read(1)
    assert late.node == "filter"
    assert [parameter.name for parameter in late.parameters] == list(FilterParameters.model_fields)
    assert node.set_parameters([Parameter("rate_hz", value=25)])[0].successful
    assert parameters.value.rate_hz == 25.0
    assert told == [FilterParameters(rate_hz=25.0)]
    changed = {parameter.name: parameter.value.double_value for parameter in read(2).parameters}
    assert changed["rate_hz"] == 25.0
    # two values that only make sense together
    both = [Parameter("low", value=3.0), Parameter("high", value=4.0)]
    assert node.set_parameters_atomically(both).successful
    assert (parameters.value.low, parameters.value.high) == (3.0, 4.0)
    for each in (node, reader):
        each.destroy_node()


@pytest.mark.usefixtures("ros")
def test_a_node_has_the_parameters_of_the_source_of_its_device() -> None:
    node = node_with(source="files", files="images", exposure_ms=4, virtual_rig="{preset: skin}")
    parameters = declare(node, CameraNodeSettings)
    assert parameters.value == CameraNodeSettings(
        device=FilesCamera(files="images", exposure_ms=4.0), virtual_rig={"preset": "skin"}
    )
    assert not node.has_parameter("gain_db")
    assert node.describe_parameter("exposure_ms").floating_point_range[0].to_value == 60e3
    assert node.set_parameters([Parameter("exposure_ms", value=8)])[0].successful
    assert parameters.value.device.exposure_time == 0.008
    for name, value, words in (
        ("source", "virtual", "read-only"),
        ("exposure_ms", -1.0, "out of range"),
        ("files", "", "needs the key files"),
        ("virtual_rig", "{preset", "filter: virtual_rig is not valid YAML"),
        ("virtual_rig", "{preset: tent}", "preset 'tent' is unknown"),
    ):
        result = node.set_parameters([Parameter(name, value=value)])[0]
        assert (result.successful, words in result.reason) == (False, True), result.reason
    node.destroy_node()
    node = node_with(source="webcam")
    with pytest.raises(ConfigurationError, match="filter: source 'webcam' is unknown; known are virtual, files"):
        declare(node, CameraNodeSettings)
    node.destroy_node()


def test_table_says_what_the_model_declares() -> None:
    table = parameter_table(FilterParameters).splitlines()
    assert table[2] == "| `window` | integer | `32` | from 8 to 128 | Width of the window [px]. |"
    assert table[3] == "| `rate_hz` | double | `10.0` | over 0 | Rate [Hz]. |"
    assert "| `dense`, `zoi` |" in table[5]
    marks = "<!-- parameters: fringedic.settings.base:HardwareNodeSettings -->", "<!-- end of parameters -->"
    page = f"before\n{marks[0]}\nold\n{marks[1]}\nafter"
    new = documented(page)
    assert "old" not in new
    assert "`autostart`" in new
    assert new.startswith("before\n")
    assert new.endswith("\nafter")
    assert documented(new) == new
