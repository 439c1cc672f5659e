"""A finished recording in the page, without ROS."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fringedic.datasets.quantities import ALL_MAPS
from fringedic.datasets.signals import signal_names
from fringedic.errors import OperatorError
from fringedic.report.page_server.maps import RecordedMaps, described, described_signal
from fringedic.report.page_server.marks import KeepMarks, shown_marks
from fringedic.wording.translation import translatable

NO_RIG = translatable("this is a recording: open a rig with 'fringedic operate' to measure")
KEPT = translatable("kept with the test")


class RecordedRig:
    """The steps and maps of a recorded experiment; it takes no commands but marks and notes.

    Parameters
    ----------
    path
        A recording or a dataset, as of `fringedic.open_experiment`.
    sensor
        Name of the sensor, if there are several.
    """

    def __init__(self, path: Path, sensor: str | None = None) -> None:
        self._maps = RecordedMaps(path, sensor)
        source = Path(self.maps.experiment.encoding.get("source", path))
        self._folder = source.absolute().parent
        names = self.maps.names()
        measured = {name for of_step in names.values() for name in of_step}
        self._snapshot: dict[str, Any] = {
            "rig": {
                "kind": "recording",
                "title": str(self.maps.experiment.attrs.get("experiment", path.stem)),
                "report": (self._folder / "report.html").exists(),
            },
            "steps": [self._step(index, 2 if names[step] else 0) for index, step in enumerate(names)],
            "signals": [self._signal(name) for name in signal_names(self.maps.experiment)],
            "quantities": [described(name) for name in ALL_MAPS if name in measured],
        }

    @property
    def maps(self) -> RecordedMaps:
        """The maps of the steps."""
        return self._maps

    def snapshot(self) -> dict[str, Any]:
        """Return title, steps, names of the maps, and the marks, which another page may have changed."""
        return {**self._snapshot, "marks": shown_marks(self._folder)}

    def folders(self) -> Mapping[str, Path]:
        """Return the folder of the dataset, which also contains the report of a run."""
        return {"run": self._folder}

    def busy(self) -> str:
        """Return nothing: no test runs."""
        return ""

    @property
    def folder(self) -> Path:
        """Folder of the dataset."""
        return self._folder

    def opened(self, test: str) -> RecordedRig:
        """Refuse other tests: this page shows one."""
        raise OperatorError(f"{test[:60]}: {NO_RIG}")

    async def do(self, command: Any) -> str:
        """Keep marks and notes beside the dataset; refuse everything else."""
        if not isinstance(command, KeepMarks) or command.test:
            raise OperatorError(NO_RIG)
        await asyncio.to_thread(command.save, self._folder)
        return KEPT

    async def check(self, text: str) -> dict[str, Any]:  # noqa: ARG002 (that of `Rig`)
        """Refuse every programme."""
        raise OperatorError(NO_RIG)

    def _step(self, index: int, mapped: int) -> dict[str, Any]:
        one = self.maps.experiment.isel(step=index)
        scalars = {name: float(one[name]) for name in ("valid_fraction", "rms_displacement") if name in one}
        signals = {name: float(one[name]) for name in signal_names(one)}
        reference = int(one["reference_step"]) if "reference_step" in one else -1
        return {
            "step": int(one.step),
            "mapped": mapped,
            "error": str(one.error.item()),
            "signals": signals,
            "reference_step": None if reference < 0 else reference,
            **scalars,
        }

    def _signal(self, name: str) -> dict[str, Any]:
        attributes = self.maps.experiment[name].attrs
        return described_signal(name, attributes["units"], attributes.get("source", ""))
