"""Warnings of an experiment's report, one sentence each."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence

import numpy as np
import xarray as xr

from fringedic.datasets.checksums import has_checksums
from fringedic.datasets.quantities import MISSING_SETTINGS
from fringedic.datasets.sentences import missing_settings_sentence, references_sentence
from fringedic.evaluation.noise_floor import NoiseFloor
from fringedic.provenance import UNKNOWN
from fringedic.report.data import ReportData
from fringedic.rig_setup.settings_sentences import warning_sentence
from fringedic.steps.drift_marker import drift_of_steps
from fringedic.steps.sentences import drift_sentence
from fringedic.wording.sealed_yaml import EDITED_WORDS

FEW_POINTS = 0.5  # share of measured points below which a step is named
EXPLAINED = (0.8, 1.25)  # measured noise over the stated one: what the scatter of a few steps at rest explains


def warnings(data: ReportData, static: Sequence[int], floors: Sequence[NoiseFloor]) -> list[str]:
    """Return the warnings of a report.

    Parameters
    ----------
    data
        The experiment.
    static
        Numbers of the steps at rest, without their reference.
    floors
        Noise floors from these steps.
    """
    return [
        *_failed_steps(data.dataset),
        *_lost_data(data),
        *_few_points(data.dataset),
        *filter(None, [references_sentence(data.dataset)]),
        *_summed_increments(data.dataset),
        *_noise_floor_missing(data, static),
        *_unexplained_noise(floors),
        *_relative_phase(data),
        *_drift(data),
        *_texture(data),
        *_source(data.dataset),
        *_integrity(data),
    ]


def _failed_steps(dataset: xr.Dataset) -> Iterator[str]:
    for step, error in zip(dataset["step"].values, dataset["error"].values, strict=True):
        if error:
            yield f"step {int(step)}: {error}"


def _lost_data(data: ReportData) -> Iterator[str]:
    if "damage" in data.dataset.attrs:
        yield f"the recording is damaged: {data.dataset.attrs['damage']}"
    yield from filter(None, [missing_settings_sentence(json.loads(data.dataset.attrs.get(MISSING_SETTINGS, "[]")))])
    if data.exposures is not None and data.exposures.dropped:
        yield f"the camera lost {data.exposures.dropped} frames"


def _few_points(dataset: xr.Dataset) -> Iterator[str]:
    for step, fraction in zip(dataset["step"].values, dataset["valid_fraction"].values, strict=True):
        if fraction < FEW_POINTS:
            yield f"step {int(step)}: only {fraction:.0%} of the points are measured"


def _summed_increments(dataset: xr.Dataset) -> Iterator[str]:
    if "increments_summed" not in dataset:
        return  # a dataset of an earlier version
    summed = [str(int(step)) for step in dataset["step"].values[dataset["increments_summed"].values == 1]]
    if summed:
        yield (
            f"the texture changed: step{'s' if len(summed) > 1 else ''} {', '.join(summed)} could not be compared with "
            "the reference step; increments were summed, and the stated standard deviations include their added errors"
        )


def _noise_floor_missing(data: ReportData, static: Sequence[int]) -> Iterator[str]:
    before = data.metadata.noise
    window = data.parameters.get("dic", {}).get("window")
    if len(static) == 1:
        yield "only one step at rest: the noise over time is not known"
    elif not static and not before.spatial:
        yield (
            "the noise floor is not measured: no step repeats the reference step at rest; measure the specimen at "
            "least twice more before it is loaded, or name such steps with --static; or measure it before the test by "
            "'fringedic noise'"
        )
    elif not static and before.window_px not in (None, window):
        yield (
            f"the noise floor was measured before the test with a window of {before.window_px} px, "
            f"the test with {window} px"
        )


def _unexplained_noise(floors: Sequence[NoiseFloor]) -> Iterator[str]:
    for floor in floors:
        ratio = floor.spatial / floor.predicted if floor.predicted else np.nan
        if np.isfinite(ratio) and not EXPLAINED[0] <= ratio <= EXPLAINED[1]:
            yield f"the noise of {floor.name} at rest is {ratio:.2f} times its stated standard deviation"


def _relative_phase(data: ReportData) -> Iterator[str]:
    if data.parameters.get("phase", {}).get("relative_phase") == "accept":
        yield "relative phases were accepted: heights may be wrong by an unknown, constant number of fringes"


def _drift(data: ReportData) -> Iterator[str]:
    coupling = data.parameters.get("coupling", {})
    marker = coupling.get("drift_marker_px", coupling.get("watch_region_px", [0, 0, 0, 0]))  # the name before
    if marker[2]:
        for step, motion in drift_of_steps(data.dataset, marker).items():
            sentence = drift_sentence(motion)
            if sentence:
                yield f"step {step}: {sentence}"


def _texture(data: ReportData) -> Iterator[str]:
    if data.advice is not None:
        for warning in data.advice.warnings:
            yield warning_sentence(warning, data.advice)


def _integrity(data: ReportData) -> Iterator[str]:
    if not has_checksums(data.dataset):
        yield (
            "the dataset contains no checksums, as those of earlier versions, so that damage of its file is not "
            "noticed; 'fringedic process' makes it again with checksums"
        )
    identifier = str(data.calibration.get("identifier", ""))
    if EDITED_WORDS in identifier:
        yield f"the calibration is not as it was measured: {identifier}"


def _source(dataset: xr.Dataset) -> Iterator[str]:
    commit = str(dataset.attrs.get("commit", UNKNOWN))
    if commit == UNKNOWN or "changes" in commit:
        yield f"the software cannot be traced to one version of its source: commit {commit}"
