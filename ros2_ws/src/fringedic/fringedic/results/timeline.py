"""When each step was exposed, and what the load frame said meanwhile."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fringedic.errors import DatasetError
from fringedic.facts import FIRST_STEP
from fringedic.load_samples import samples_over
from fringedic.recording import BagReader
from fringedic.results.recorded_parameters import recorded_facts
from fringedic.results.rows import Row
from fringedic.sequence import PatternKind, frame_record, stamp_of


class Timeline:
    """When each step was exposed, and what the load frame said at that time."""

    def __init__(self, reader: BagReader, names: Mapping[str, str], experiment: str | None) -> None:
        exposures = [frame_record(message) for _, message, _ in reader.messages([names["camera/exposure"]])]
        exposures = [each for each in exposures if each.projection.kind != PatternKind.OTHER]
        present = list(dict.fromkeys(each.experiment for each in exposures))
        if experiment is None and len(present) > 1:
            raise DatasetError(f"{reader.path} holds the experiments {', '.join(present)}: say which one")
        if not present or (experiment is not None and experiment not in present):
            wanted = "any experiment" if experiment is None else f"experiment '{experiment}'"
            raise DatasetError(f"{reader.path} holds no frame of {wanted}; it has {', '.join(present) or 'none'}")
        self.experiment = present[0] if experiment is None else experiment
        self.source = reader.path.name
        self.damage = reader.lost
        self._exposed: dict[int, tuple[float, float]] = {}
        self.references: set[int] = set()
        for record in exposures:
            if record.experiment != self.experiment:
                continue
            begin, end = self._exposed.get(record.step, (np.inf, -np.inf))
            half = 0.5e9 * record.exposure_time
            self._exposed[record.step] = min(begin, record.stamp - half), max(end, record.stamp + half)
        if "experiment/reference" in names:
            messages = [message for _, message, _ in reader.messages([names["experiment/reference"]])]
            self.references = {message.step for message in messages if message.experiment == self.experiment}
        self.references |= {min(self._exposed)}
        states = []
        if "load_frame/state" in names:
            messages = [message for _, message, _ in reader.messages([names["load_frame/state"]])]
            states = [(stamp_of(message), message.force, message.position) for message in messages]
        self._stamps = np.array([state[0] for state in states], dtype=np.int64)
        self._states = np.array([state[1:] for state in states], dtype=float).reshape(-1, 2)

        topics = [names["node_parameters"]] if "node_parameters" in names else []
        specimen = recorded_facts(message for _, message, _ in reader.messages(topics)).specimen
        self._force_sign = specimen.force_sign
        if specimen.force_tare_newton == FIRST_STEP:
            self._force_tare = self._mean_load(min(self._exposed))[0]
        else:
            self._force_tare = float(specimen.force_tare_newton)

    def require_steps(self, steps: set[int]) -> None:
        """Raise DatasetError when no frame of one of these steps was exposed."""
        absent = sorted(steps - self._exposed.keys())
        if absent:
            present = ", ".join(map(str, sorted(self._exposed)))
            raise DatasetError(
                f"{self.source}: experiment '{self.experiment}' has no step {', '.join(map(str, absent))}; "
                f"it has {present}"
            )

    def complete(self, row: Row) -> None:
        """Average force and position over the exposures of a step; one that failed before its first has none."""
        if row.step not in self._exposed:
            return
        force, row.position = self._mean_load(row.step)
        row.force = self._force_sign * (force - self._force_tare)
        if row.stamp is None:
            row.stamp = int(self._exposed[row.step][1])

    def _mean_load(self, step: int) -> tuple[float, float]:
        """Mean (force, position) as read, between the begin of the first and the end of the last exposure."""
        within = samples_over(self._stamps, *self._exposed[step])
        if not within.any():
            return float("nan"), float("nan")
        force, position = self._states[within].mean(axis=0)
        return float(force), float(position)
