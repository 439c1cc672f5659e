"""Named evaluations and exports of a run for the page: the command computes each in a process of its own."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal, get_args

import yaml
from pydantic import BaseModel, ConfigDict, Field

from fringedic.datasets.attributes import image_size
from fringedic.datasets.opening import open_experiment, sensors_of_results
from fringedic.errors import FringedicError, OperatorError
from fringedic.evaluation.named import SETTINGS, EvaluationSettings, NamedEvaluation, evaluations
from fringedic.report.previewed_evaluation import PREVIEW
from fringedic.report.processing_entries import changes_text
from fringedic.steps.recorded_parameters import present_parameters
from fringedic.wording.causes import cause_of
from fringedic.wording.translation import Sentence, translatable

ExportFormat = Literal["png", "csv", "gif", "vtk", "mat", "tiff"]
PREVIEWED_S = 600.0  # longest time of a preview
NICE = 15  # of a process beside a rig: what drives it has the processor first
_ENDING_S = 5.0  # of a process, which removes its files
_SHOWN_SETTINGS = {
    "window": ("dic", "window"),
    "spacing": ("dic", "spacing"),
    "strain_window": ("coupling", "strain_window_px"),
    "z_filter": ("coupling", "z_filter_px"),
}


class _Asked(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


class Preview(_Asked):
    """Asks how one step looks with other settings."""

    step: int = Field(ge=0)
    settings: EvaluationSettings


class Evaluate(_Asked):
    """Asks for a named evaluation of all steps."""

    name: str = Field(max_length=60)
    settings: EvaluationSettings


class Export(_Asked):
    """Asks for files of other programs, of the results (no evaluation) or of an evaluation."""

    format: ExportFormat
    evaluation: str = Field("", max_length=60)
    step: int | None = Field(None, ge=0)
    sensor: str = Field("", max_length=60, pattern=r"^\w*$")


class Evaluations:
    """Lists, previews, makes and exports evaluations of the folders that a page shows; one at a time.

    Parameters
    ----------
    busy
        Returns why nothing may be computed now, such as a test that runs; "" when it may.
    nice
        Niceness of the processes.
    """

    def __init__(self, busy: Callable[[], str], nice: int = NICE) -> None:
        self._busy, self._nice = busy, nice
        self._one = threading.Lock()
        self._running: subprocess.Popen[str] | None = None
        self._work = Path(tempfile.mkdtemp(prefix="fringedic-evaluations-"))
        self._job: dict[str, Any] = {}
        self._job_of: Path | None = None  # the run that it belongs to

    def listed(self, run: Path, sensor: str = "") -> dict[str, Any]:
        """Return the evaluations of a run, its sensors, steps and settings, and what is being made.

        Parameters
        ----------
        run
            Its folder.
        sensor
            Name of the sensor whose steps and settings are listed; by default the first one.

        Raises
        ------
        FringedicError
            The run has no results.
        """
        sensors = sensors_of_results(run)
        chosen = sensor or (sensors[0] if len(sensors) > 1 else "")
        with open_experiment(run, sensor=chosen or None) as dataset:
            steps = [
                int(step)
                for step, error in zip(dataset["step"].values, dataset["error"].values, strict=True)
                if not error
            ]
            recorded = json.loads(dataset.attrs.get("parameters", "[]"))
            size = image_size(dataset)
        parameters = recorded[-1]["parameters"] if recorded else {}
        settings = {
            name: present_parameters(node, parameters.get(node, {})).get(key)
            for name, (node, key) in _SHOWN_SETTINGS.items()
        }
        found = [
            {
                "name": each.name,
                "settings": each.settings.model_dump(exclude_defaults=True),
                "changes": changes_text(each.settings),
                "report": each.report.is_file(),
            }
            for each in evaluations(run)
        ]
        return {
            "evaluations": found,
            "sensors": sensors,
            "sensor": chosen,
            "steps": steps,
            "settings": settings,
            "size": size,
            "job": self._job if run == self._job_of else {},
            "formats": get_args(ExportFormat),
        }

    def preview(self, run: Path, asked: Preview) -> dict[str, Any]:
        """Return figures of a step before and with the settings; pictures as of `picture`."""
        with self._alone():
            folder = self._work / "preview"
            shutil.rmtree(folder, ignore_errors=True)
            words = ["--preview", str(asked.step), "--output", str(folder), *self._settings(asked.settings)]
            self._command(["evaluate", str(run), *words], PREVIEWED_S)
            content: dict[str, Any] = json.loads((folder / PREVIEW).read_text("utf-8"))
            return content | {"made": time.time()}

    def picture(self, name: str) -> Path:
        """Return the file of a picture of the last preview.

        Raises
        ------
        OperatorError
            There is none.
        """
        file = self._work / "preview" / f"{name}.png"
        if name not in ("before", "after") or not file.is_file():
            raise OperatorError(translatable("there is no preview: ask for one first"))
        return file

    def start(self, run: Path, asked: Evaluate) -> str:
        """Begin an evaluation, whose state is in `listed`."""
        if any(each.name == asked.name for each in evaluations(run)):
            raise OperatorError(
                Sentence("{name} exists already: evaluations are not replaced, choose another name", name=asked.name)
            )
        self._enter()
        self._job = {"name": asked.name, "state": "runs", "words": "", "since": time.time()}
        self._job_of = run
        why = ["--why", asked.settings.note] if asked.settings.note else []

        def work() -> None:
            try:
                self._command(["evaluate", str(run), "--name", asked.name, *self._settings(asked.settings), *why], None)
                self._job = self._job | {"state": "done", "words": Sentence("{name} is complete", name=asked.name)}
            except FringedicError as error:
                self._job = self._job | {"state": "failed", "words": str(error)}
            finally:
                self._one.release()

        threading.Thread(target=work, name="evaluation", daemon=True).start()
        return Sentence("{name} is computed; the results of the run stay as they are", name=asked.name)

    def export(self, run: Path, asked: Export) -> Path:
        """Return a ZIP file with exported files, which the caller removes."""
        source = self.of(run, asked.evaluation).dataset if asked.evaluation else run
        with self._alone():
            folder = Path(tempfile.mkdtemp(dir=self._work))
            words = ["--to", asked.format, "--output", str(folder / "files")]
            words += [] if asked.step is None else ["--step", str(asked.step)]
            words += ["--sensor", asked.sensor] if asked.sensor and not asked.evaluation else []
            try:
                self._command(["export", str(source), *words], None)
                packed = self._work / f"{folder.name}.zip"
                with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
                    for file in sorted((folder / "files").rglob("*")):
                        if file.is_file():
                            archive.write(file, file.relative_to(folder / "files"))
            finally:
                shutil.rmtree(folder, ignore_errors=True)
            return packed

    def of(self, run: Path, name: str) -> NamedEvaluation:
        """Return an evaluation by its name.

        Raises
        ------
        OperatorError
            There is none.
        """
        found = next((each for each in evaluations(run) if each.name == name), None)
        if found is None:
            raise OperatorError(Sentence("there is no evaluation {name}", name=name[:60]))
        return found

    def close(self) -> None:
        """End what is being computed; an evaluation that is not complete is removed by its process."""
        running = self._running
        if running is not None:
            with suppress(OSError):
                running.terminate()
            try:
                running.wait(_ENDING_S)
            except subprocess.TimeoutExpired:
                running.kill()
        shutil.rmtree(self._work, ignore_errors=True)

    def _enter(self) -> None:
        """Take the one place for work, until `_one` is released."""
        reason = self._busy()
        if reason:
            raise OperatorError(reason)
        if not self._one.acquire(blocking=False):
            raise OperatorError(translatable("another evaluation or export is being computed: wait until it has ended"))

    @contextmanager
    def _alone(self) -> Iterator[None]:
        self._enter()
        try:
            yield
        finally:
            self._one.release()

    def _settings(self, settings: EvaluationSettings) -> list[str]:
        """Return the option for settings, from a file: no text of a browser becomes a word of a command."""
        file = self._work / SETTINGS
        try:
            file.write_text(yaml.safe_dump(settings.model_dump(exclude_defaults=True)), "utf-8")
        except OSError as error:
            raise OperatorError(f"{file}: cannot be written: {cause_of(error)}") from error
        return ["--like", str(file)]

    def _command(self, words: Sequence[str], longest_s: float | None) -> None:
        """Run the command in a process, and raise its sentence when it fails."""
        command = ["nice", "-n", str(self._nice), sys.executable, "-m", "fringedic", *words]
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            )
        except (OSError, ValueError) as error:  # no memory for a process, or a text with a zero byte
            raise OperatorError(f"the command cannot be started: {cause_of(error)}") from error
        with process:
            self._running = process
            try:
                _, said = process.communicate(timeout=longest_s)
            except subprocess.TimeoutExpired as error:
                process.terminate()
                raise OperatorError(f"no result after {longest_s:g} s: use the command 'fringedic evaluate'") from error
            finally:
                self._running = None
        if process.returncode:
            lines = [line for line in said.splitlines() if line.strip()]
            raise OperatorError(lines[-1] if lines else f"the command ended with exit code {process.returncode}")
