"""The Foxglove layout names topics and fields that the nodes publish, and every panel has its place."""

from __future__ import annotations

import importlib
import json
import re
from pathlib import Path
from typing import Any

import pytest
from viewer import LAYOUT, drawn

DOCS = Path(__file__).parents[4] / "docs"
NAMESPACE = "/rig/"


@pytest.fixture(scope="module")
def layout() -> dict[str, Any]:
    return json.loads(LAYOUT.read_text())


@pytest.fixture(scope="module")
def published() -> dict[str, str]:
    """Type of every topic in the tables 'Published topics' of the nodes' pages."""
    found: dict[str, str] = {}
    for page in (DOCS / "nodes").glob("*.md"):
        section = page.read_text().partition("## Published topics")[2].partition("\n## ")[0]
        for topics, types in re.findall(r"^\| (`[^|]+) \| ([^|]+) \|", section, re.MULTILINE):
            names, kinds = re.findall(r"`([^`]+)`", topics), [each.split()[0] for each in types.split(",")]
            found |= {name: kinds[min(k, len(kinds) - 1)] for k, name in enumerate(names)}
    return found


def message(kind: str) -> Any:
    package, name = kind.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)()


def test_every_topic_and_field_exists(layout: dict[str, Any], published: dict[str, str]) -> None:
    topics = list(drawn(layout))
    assert len(topics) > 12
    for topic, field in topics:
        name = topic if topic == "/diagnostics" else topic.removeprefix(NAMESPACE)
        assert name in published, f"no node publishes {topic}"
        if field:
            value = getattr(message(published[name]), field)
            assert isinstance(value, float), f"{topic}.{field} is no number"


def test_images_are_images_and_clouds_are_clouds(layout: dict[str, Any], published: dict[str, str]) -> None:
    for name, panel in layout["configById"].items():
        kind = name.partition("!")[0]
        if kind == "Image":
            topic = panel["imageMode"]["imageTopic"].removeprefix(NAMESPACE)
            assert published[topic] == "sensor_msgs/Image"
        if kind == "3D":
            assert [published[topic.removeprefix(NAMESPACE)] for topic in panel["topics"]] == [
                "sensor_msgs/PointCloud2"
            ]
            assert panel["followTf"] == "rig/reference_plane"  # with the prefix of the namespace


def places(node: str | dict[str, Any]) -> list[str]:
    """Panels of a layout, each split in two."""
    if isinstance(node, str):
        return [node]
    assert node["direction"] in ("row", "column")
    assert 0 < node["splitPercentage"] < 100
    return places(node["first"]) + places(node["second"])


def test_every_panel_has_one_place(layout: dict[str, Any]) -> None:
    assert {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"} == set(layout)
    panels = layout["configById"]
    shown = places(layout["layout"])
    for name in list(shown):
        shown += [each for tab in panels[name].get("tabs", ()) for each in places(tab["layout"])]
    assert sorted(shown) == sorted(panels)
