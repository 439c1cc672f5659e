"""Named evaluations: the recording of a run processed with other settings, beside the results, which are kept."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import yaml
from pydantic import BaseModel, ConfigDict, Field

from fringedic.configuration.yaml_section import load_sections
from fringedic.datasets.opening import RESULTS, open_experiment
from fringedic.datasets.processing import process_bag
from fringedic.errors import DatasetError
from fringedic.evaluation.probes import surface_means
from fringedic.evidence.changes import noted
from fringedic.frames.region import Region
from fringedic.metadata import Gauge
from fringedic.provenance import git_commit, software
from fringedic.recording.bag_files import BAG, recording_of
from fringedic.wording.arguments import check_arguments, path, text
from fringedic.wording.causes import cause_of

EVALUATIONS = "evaluations"
"""Folder in that of a run with one folder for each named evaluation."""
SETTINGS = "evaluation.yaml"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,59}")
_REGIONS = ("dic.region", "phase.region")
_COMPARED = ("u", "v", "w", "displacement_x", "displacement_y", "e_11", "e_22", "e_12")


class EvaluationSettings(BaseModel):
    """What an evaluation changes; everything else is as recorded."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    overrides: dict[str, bool | int | float | str | list[float]] = Field(
        {}, max_length=50, description="Parameters of the nodes, such as dic.window: 24."
    )
    reference: int | None = Field(None, ge=0, description="Step that all others are measured against.")
    region: str = Field("", max_length=200_000, description="Region: the polygons that `fringedic region` writes.")
    gauges: list[Gauge] | None = Field(
        None, max_length=50, description="Virtual extensometers in place of those recorded."
    )
    sensor: str = Field("", max_length=60, description="Name of the sensor, if there are several.")
    note: str = Field("", max_length=2000, description="Why it was made.")
    created: str = Field("", description="When it was made; entered by the program.")
    software: str = Field("", description="With what it was made; entered by the program.")

    def processing(self) -> dict[str, Any]:
        """Return the arguments of `process_bag`.

        Raises
        ------
        ImageError
            The text of the region describes none.
        """
        overrides: dict[str, Any] = dict(self.overrides)
        if self.region:
            overrides |= dict.fromkeys(_REGIONS, Region.from_text(self.region).to_text())
        if self.gauges is not None:
            overrides["specimen.gauges_px"] = [gauge.model_dump() for gauge in self.gauges]
        return {"overrides": overrides, "reference": self.reference, "sensor": self.sensor or None}


@dataclass(frozen=True)
class NamedEvaluation:
    """An evaluation that is complete.

    Attributes
    ----------
    name
        Its name.
    dataset
        Its results, for `fringedic.open_experiment`.
    settings
        What it changed.
    """

    name: str
    dataset: Path
    settings: EvaluationSettings

    @property
    def report(self) -> Path:
        """The file of its report, which may not be there."""
        return self.dataset.with_name("report.html")


@check_arguments(DatasetError, source=path, name=text)
def evaluate(
    source: Path,
    name: str,
    settings: EvaluationSettings,
    progress: Callable[[int, str], None] | None = None,
) -> NamedEvaluation:
    """Process the recording of a run with other settings into ``evaluations/NAME`` of its folder.

    Parameters
    ----------
    source
        Folder of a run, or its recording.
    name
        Letters, digits, ``-`` and ``_``.
    settings
        What is changed.
    progress
        Called after each step with its number and its error message, empty when it succeeded.

    Raises
    ------
    DatasetError
        The name has another form or is in use, or the evaluation cannot be written.
    FringedicError
        As of `fringedic.process_bag`.

    Examples
    --------
    >>> settings = EvaluationSettings(overrides={"dic.window": 24})
    >>> evaluate(Path("recordings/plate-7"), "fine", settings).dataset  # doctest: +SKIP
    PosixPath('recordings/plate-7/evaluations/fine/fine.nc')
    """
    if not _NAME.fullmatch(name) or name in (RESULTS, BAG):
        raise DatasetError(
            f"name is {name[:60]!r}: give letters, digits, - and _, at most 60, and neither {RESULTS} nor {BAG}"
        )
    recording = recording_of(source)
    folder = recording.parent / EVALUATIONS / name
    made = settings.model_copy(
        update={"created": datetime.now(UTC).isoformat(timespec="seconds"), "software": f"{software()}, {git_commit()}"}
    )
    with noted(folder, "evaluation", details={"evaluation": {name: made.model_dump(exclude_defaults=True)}}):
        try:
            folder.mkdir(parents=True)
        except FileExistsError as error:
            raise DatasetError(f"{folder} exists already: evaluations are not replaced, choose another name") from error
        except OSError as error:
            raise DatasetError(f"{folder}: cannot be made: {cause_of(error)}") from error
        try:
            written = process_bag(recording, output=folder / f"{name}.nc", progress=progress, **made.processing())
            text_of = yaml.safe_dump(made.model_dump(exclude_defaults=True), allow_unicode=True, sort_keys=False)
            (folder / SETTINGS).write_text(text_of, "utf-8")  # last: an evaluation with it is complete
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
    return NamedEvaluation(name, written, made)


def load_settings(file: Path) -> EvaluationSettings:
    """Read the settings of an evaluation, for another one with the same.

    Raises
    ------
    ConfigurationError
        The file cannot be read, or a key is unknown or has another form.
    """
    return load_sections(file, EvaluationSettings).model_copy(update={"created": "", "software": ""})


def evaluations(source: Path) -> list[NamedEvaluation]:
    """Return the complete evaluations of a run by their names.

    Parameters
    ----------
    source
        Folder of a run, or a file or folder in it.

    Raises
    ------
    ConfigurationError
        The settings of one are damaged.
    """
    run = source if (source / BAG).is_dir() or (source / EVALUATIONS).is_dir() else source.parent
    return [
        NamedEvaluation(
            file.parent.name, file.parent / f"{file.parent.name}.nc", load_sections(file, EvaluationSettings)
        )
        for file in sorted((run / EVALUATIONS).glob(f"*/{SETTINGS}"))
    ]


def run_of_evaluation(folder: Path) -> Path | None:
    """Return the folder of the run that a folder is an evaluation of, None if it is none."""
    return folder.parent.parent if folder.parent.name == EVALUATIONS else None


def preview(source: Path, settings: EvaluationSettings, step: int) -> tuple[xr.Dataset, xr.Dataset]:
    """Measure one step with other settings, without keeping it.

    Parameters
    ----------
    source
        Folder of a run, or its recording.
    settings
        What is changed.
    step
        Number of the step.

    Returns
    -------
    tuple of Dataset
        The step as it was measured, and with the settings.

    Raises
    ------
    DatasetError
        There is no such step.
    FringedicError
        As of `fringedic.process_bag`.
    """
    recording = recording_of(source)
    with open_experiment(source, sensor=settings.sensor or None) as dataset:
        if step not in dataset["step"].values:
            raise DatasetError(f"there is no step {step}: choose one of {dataset['step'].values.tolist()}")
        before = dataset.sel(step=step).load()
    with tempfile.TemporaryDirectory(prefix="fringedic-preview-") as folder:
        written = process_bag(recording, output=Path(folder) / "preview.nc", steps=[step], **settings.processing())
        with open_experiment(written) as dataset:
            after = dataset.sel(step=step).load()
    if str(after["error"].item()):
        raise DatasetError(f"step {step} is not measured with these settings: {after['error'].item()}")
    return before, after


def compared_means(before: xr.Dataset, after: xr.Dataset) -> dict[str, list[tuple[float, float]]]:
    """Return mean and standard uncertainty of the maps of a step over all points, of both evaluations [SI]."""
    names = [name for name in _COMPARED if name in before and name in after]
    both = [surface_means(step, names) for step in (before, after)]
    return {
        name: [means[name] for means in both] for name in names if all(np.isfinite(means[name][0]) for means in both)
    }
