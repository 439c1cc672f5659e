"""From what the nodes published to steps, without measuring anything again."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

import numpy as np

from fringedic.results.messages import cloud_arrays, image_array
from fringedic.results.quantities import PHASE_TOPICS
from fringedic.results.recorded_parameters import RecordedParameters
from fringedic.results.rows import Row, Settings, displacement_maps
from fringedic.rig import RigModel
from fringedic.sequence import stamp_of


class Collected:
    """Joins what the nodes published of each step."""

    def __init__(self, topics: set[str]) -> None:
        self._topics = topics
        self._parameters = RecordedParameters({})
        self._calibration: RigModel | None = None
        self._steps: OrderedDict[int, dict[str, Any]] = OrderedDict()
        self._reference: int | None = None
        self._reference_of: dict[int, int | None] = {}

    def settings(self) -> Settings:
        return self._parameters.settings(self._calibration)

    def take(self, topic: str, message: Any) -> list[Row]:
        if topic == "node_parameters":
            self._parameters.take(message)
            return []
        if topic == "calibration":
            self._calibration = RigModel.from_message(message)
            return []
        if topic == "experiment/reference":
            self._reference = message.step
            return []
        stamp = stamp_of(message)
        if stamp not in self._steps:
            # a late answer may come when the next reference is announced already
            self._steps[stamp], self._reference_of[stamp] = {}, self._reference
        parts = self._steps[stamp]
        parts[topic] = message
        if self._expected(parts) <= parts.keys():
            return [self._row(self._steps.pop(stamp), stamp)]
        return []

    def finish(self) -> list[Row]:
        """Return the steps of which messages are missing; they cannot be told from each other without a status."""
        return [
            self._row(parts, stamp)
            for stamp, parts in self._steps.items()
            if any(topic.endswith("/status") for topic in parts)
        ]

    def _expected(self, parts: Mapping[str, Any]) -> set[str]:
        """Topics that a step has, so far as the statuses tell: a node that failed or skipped publishes no maps."""
        expected = set()
        for topic in self._topics:
            node, name = topic.split("/")
            status = parts.get(f"{node}/status")
            white = node != "dic" and status is not None and not _has_maps(status)
            failed = status is not None and status.error_code != 0
            if name == "status" or not (white or failed):
                expected.add(topic)
        return expected

    def _row(self, parts: Mapping[str, Any], stamp: int) -> Row:
        statuses = [parts[f"{node}/status"] for node in ("phase", "dic", "coupling") if f"{node}/status" in parts]
        row = Row(statuses[0].step, stamp)
        for status in statuses:
            if status.error_code:
                row.error = row.error or status.error_message
            elif not np.isnan(status.valid_fraction):
                row.valid_fraction = status.valid_fraction
        for topic, name in PHASE_TOPICS.items():
            if f"phase/{topic}" in parts:
                row.maps[name] = image_array(parts[f"phase/{topic}"])
        if "dic/displacement" in parts and "dic/sigma" in parts:
            row.maps |= displacement_maps(image_array(parts["dic/displacement"]), image_array(parts["dic/sigma"]))
            self._reference = row.step if self._reference is None else self._reference
            announced = self._reference_of[stamp]
            row.reference_step = self._reference if announced is None else announced
            # recordings of older versions do not tell
            row.correlated_step = getattr(parts.get("dic/status"), "correlated_step", None)
        if "coupling/shape" in parts:
            row.maps |= {f"shape_{name}": values for name, values in cloud_arrays(parts["coupling/shape"]).items()}
        if "coupling/displacement" in parts:
            row.maps |= cloud_arrays(parts["coupling/displacement"])
            row.rms_displacement = parts["coupling/status"].rms if "coupling/status" in parts else float("nan")
        return row


def _has_maps(status: Any) -> bool:
    """Whether a processing node had anything to do for a step: not for a white one."""
    return not (np.isnan(status.valid_fraction) and status.error_code == 0)
