"""What a reader of a report must be warned of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from fringedic.provenance import UNKNOWN
from fringedic.report.items import Known
from fringedic.report.static import NoiseFloor
from fringedic.watch import watched_steps

FEW_POINTS = 0.5
_EXPLAINED = (0.8, 1.25)  # measured noise over stated one


def warnings(known: Known, static: Sequence[int], floors: Sequence[NoiseFloor]) -> list[str]:
    """Return one sentence per warning."""
    dataset = known.dataset
    found = [error if f"step {step}" in error else f"step {step}: {error}" for step, error in _errors(known)]
    if "damage" in dataset.attrs:
        found.append(f"the recording is damaged: {dataset.attrs['damage']}")
    if known.exposures is not None and known.exposures.dropped:
        found.append(f"the camera lost {known.exposures.dropped} frames")
    for step, fraction in zip(dataset["step"].values, dataset["valid_fraction"].values, strict=True):
        if fraction < FEW_POINTS:
            found.append(f"step {int(step)}: only {fraction:.0%} of the points are measured")
    summed = [int(step) for step, flag in zip(dataset["step"].values, _summed(dataset), strict=True) if flag == 1]
    if summed:
        found.append(
            f"the texture changed: step{'s' if len(summed) > 1 else ''} {', '.join(map(str, summed))} could not be "
            "compared with the reference step; increments were summed, whose errors add up, as the stated standard "
            "deviations say"
        )
    if not static and not known.noise.spatial:
        found.append(
            "the noise floor is not measured: no step repeats the reference step at rest; measure the specimen at "
            "least twice more before it is loaded, or name such steps with --static; or measure it before the test by "
            "'fringedic noise'"
        )
    elif not static:
        window = known.parameters.get("dic", {}).get("window")
        if known.noise.window_px not in (None, window):
            found.append(
                f"the noise floor was measured before the test with a window of {known.noise.window_px} px, "
                f"the test with {window} px"
            )
    elif len(static) == 1:
        found.append("only one step at rest: no noise over time can be told")
    for floor in floors:
        ratio = floor.spatial / floor.predicted if floor.predicted else np.nan
        if np.isfinite(ratio) and not _EXPLAINED[0] <= ratio <= _EXPLAINED[1]:
            found.append(f"the noise of {floor.name} at rest is {ratio:.2f} times the one that its uncertainty states")
    if known.parameters.get("phase", {}).get("relative_phase") == "accept":
        found.append("relative phases were accepted: heights may be wrong by an unknown, constant number of fringes")
    watched = known.parameters.get("coupling", {}).get("watch_region_px", [0, 0, 0, 0])
    if watched[2]:
        motions = watched_steps(dataset, watched)
        found += [f"step {step}: {motion.words}" for step, motion in motions.items() if motion.words]
    if known.advice is not None:
        found += known.advice.warnings
    commit = str(dataset.attrs.get("commit", UNKNOWN))
    if commit == UNKNOWN or "changes" in commit:
        found.append(f"the software cannot be traced to one version of its source: commit {commit}")
    return found


def _summed(dataset: xr.Dataset) -> np.ndarray:
    """Whether each step's displacement is a sum of increments: 1, 0, or -1 where older datasets do not tell."""
    name = "increments_summed"
    return dataset[name].values if name in dataset else np.full(dataset.sizes["step"], -1)


def _errors(known: Known) -> list[tuple[int, str]]:
    dataset = known.dataset
    return [
        (int(step), str(error))
        for step, error in zip(dataset["step"].values, dataset["error"].values, strict=True)
        if error
    ]
