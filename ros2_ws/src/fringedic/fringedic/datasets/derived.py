"""Steps from the messages that the nodes published, without measuring anything again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fringedic.datasets.confirmation import confirmed_fraction
from fringedic.datasets.quantities import PHASE_TOPICS
from fringedic.datasets.rows import Row, displacement_maps
from fringedic.frames.messages import cloud_arrays, image_array
from fringedic.frames.records import stamp_of
from fringedic.rig.model import RigModel
from fringedic.steps.closures import ClosureChecks
from fringedic.steps.recorded_parameters import RecordedParameters, StepSettings
from fringedic.steps.step_results import DicResult, displacement_field


class Collected:
    """Joins the messages that the nodes published about each step.

    Parameters
    ----------
    topics
        Relative names of the topics in the recording that belong to steps.
    """

    def __init__(self, topics: set[str]) -> None:
        self._topics = topics
        self._parameters = RecordedParameters({})
        self._calibration: RigModel | None = None
        self._steps: dict[int, dict[str, Any]] = {}  # by stamp, of the steps that are not complete yet
        self._done: set[int] = set()  # stamps of the rows so far
        self._numbers: set[int] = set()  # steps of the rows so far
        self._reference: int | None = None
        self._reference_of: dict[int, int | None] = {}
        self._checks = ClosureChecks()

    def settings(self) -> StepSettings:
        """Return the parameters and the calibration of the next step."""
        return self._parameters.settings(self._calibration)

    def take(self, topic: str, message: Any) -> list[Row]:
        """Take one message; return the step that it completes, if any, after those before it.

        Nodes work on one step after the other: when a later one is complete, what is missing of an earlier one is lost.
        """
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
        if stamp in self._done:
            return []  # too late
        if stamp not in self._steps:
            # a late message may arrive after the next reference was announced
            self._steps[stamp], self._reference_of[stamp] = {}, self._reference
        parts = self._steps[stamp]
        parts[topic] = message
        return self._rows(last=stamp) if self._expected(parts) <= parts.keys() else []

    def finish(self) -> list[Row]:
        """Return the last steps of which messages are missing."""
        return self._rows(last=None)

    def _rows(self, last: int | None) -> list[Row]:
        """Return the steps in the order of their first messages; without a status the number of one is not known."""
        rows = []
        while self._steps and last not in self._done:
            stamp = next(iter(self._steps))
            parts = self._steps.pop(stamp)
            self._done.add(stamp)
            if any(topic.endswith("/status") for topic in parts):
                row = self._row(parts, stamp)
                # a step that failed early ends for each node with the latest stamp that it knows
                if row.step not in self._numbers:
                    rows.append(row)
                    self._numbers.add(row.step)
        return rows

    def _expected(self, parts: Mapping[str, Any]) -> set[str]:
        """Return the topics of a step according to its statuses: a node that failed or skipped it publishes no maps."""
        expected = set()
        for topic in self._topics:
            node, name = topic.split("/")
            status = parts.get(f"{node}/status")
            without_maps = status is not None and (status.skipped or status.error_code)
            if name == "status" or not without_maps:
                expected.add(topic)
        return expected

    def _row(self, parts: Mapping[str, Any], stamp: int) -> Row:
        statuses = [parts[f"{node}/status"] for node in ("phase", "dic", "coupling") if f"{node}/status" in parts]
        row = Row(statuses[0].step, stamp, settings=self.settings())
        for status in statuses:
            if status.error_code:
                row.error = row.error or status.error_message
            elif not np.isnan(status.valid_fraction):
                row.valid_fraction = status.valid_fraction
        missing = sorted(self._expected(parts) - parts.keys())
        if missing and not row.error:
            row.error = f"the recording lacks {', '.join(missing)} of this step; measure it with fringedic process"
        for topic, name in PHASE_TOPICS.items():
            if f"phase/{topic}" in parts:
                row.maps[name] = image_array(parts[f"phase/{topic}"])
        if "dic/displacement" in parts and "dic/sigma" in parts:
            row.maps |= _displacement_maps(parts)
            self._reference = row.step if self._reference is None else self._reference
            announced = self._reference_of[stamp]
            row.reference_step = self._reference if announced is None else announced
            row.correlated_step = parts["dic/status"].correlated_step if "dic/status" in parts else None
            self._check(row, parts)
        if "coupling/shape" in parts:
            row.maps |= {f"shape_{name}": values for name, values in cloud_arrays(parts["coupling/shape"]).items()}
        if "coupling/displacement" in parts:
            row.maps |= cloud_arrays(parts["coupling/displacement"])
            row.rms_displacement = getattr(parts.get("coupling/status"), "rms_displacement", row.rms_displacement)
        return row

    def _check(self, row: Row, parts: Mapping[str, Any]) -> None:
        """Add the independent check of the displacement, if the recording contains all that it needs."""
        status, dic = parts.get("dic/status"), self._parameters.dic
        if row.stamp is None or row.reference_step is None or row.correlated_step is None:
            return
        if status is None or not status.window or "texture" not in row.maps:
            return
        field = displacement_field(
            image_array(parts["dic/displacement"]),
            image_array(parts["dic/sigma"]),
            origin=(0, 0),
            spacing=dic.spacing,
            window=status.window,
            method=status.method,
        )
        result = DicResult(status.experiment, row.step, row.stamp, row.reference_step, row.correlated_step, field)
        closures = self._checks.displacement(result, row.maps["texture"], dic.kept_steps)
        row.maps |= closures
        row.confirmed_fraction = confirmed_fraction(closures, dic.spacing)


def _displacement_maps(parts: Mapping[str, Any]) -> dict[str, np.ndarray]:
    images = (image_array(parts[topic]) for topic in ("dic/displacement", "dic/sigma"))
    return displacement_maps(displacement_field(*images, origin=(0, 0), spacing=1, window=0, method=""))
