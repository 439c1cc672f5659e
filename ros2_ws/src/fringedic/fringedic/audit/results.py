"""Results of a run computed again from its recording, and its calibration from its own."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from fringedic.audit.comparison import Difference, compare_bits
from fringedic.audit.parts import CALIBRATION_OF_RUN, Part, Result
from fringedic.calibration.recorded import calibrate_recording
from fringedic.configuration.sections import VIRTUAL_RIG
from fringedic.datasets.attributes import recorded_calibration, sensor_of
from fringedic.datasets.confirmation import confirmed_fraction
from fringedic.datasets.opening import RESULTS, open_experiment
from fringedic.datasets.processing import DATASETS, process_bag
from fringedic.datasets.quantities import ATTACHMENTS, CLOSURES
from fringedic.datasets.stores import SUFFIXES
from fringedic.errors import FringedicError
from fringedic.evidence.log import CALIBRATION_SOURCE, CALIBRATION_SOURCES, Entry
from fringedic.frames.sensor import JOINED
from fringedic.provenance import differences, processor, software_identity
from fringedic.recording.bag_files import BAG
from fringedic.rig.model import RigModel
from fringedic.sensors.recorded import join_recording, registration_of
from fringedic.signals import attachment_digests
from fringedic.wording.numbers import counted, number_text

_SHOWN = 5  # differences in a sentence
_CHANGED = "the results were changed; or the software was, without its commit saying so"
PHASE_CHECK = "phase_closure"


def datasets_of(run: Path, bag: Path) -> Iterator[Path]:
    """Yield the datasets in the folder of a run, and its named evaluations, that were made from its recording."""
    for path in [*sorted(run.iterdir()), *sorted((run / "evaluations").glob("*/*"))]:
        if path.suffix in SUFFIXES and not path.name.startswith("."):
            source = None
            with suppress(FringedicError), open_experiment(path) as dataset:
                source = dataset.attrs.get("source")
            if source == bag.name or path.name.startswith((RESULTS, bag.name)):
                yield path


def check_dataset(path: Path, bag: Path, entries: Sequence[Entry], tell: Callable[[str], None]) -> Part:
    """Compute a dataset again with the settings that the log contains, and compare it bit by bit."""
    name = f"results {path.name}"
    noted = [entry for entry in entries if path.name in entry.details.get(DATASETS, {})]
    settings: Mapping[str, Any] = noted[-1].details[DATASETS][path.name] if noted else {}
    try:
        with tempfile.TemporaryDirectory(prefix="fringedic-audit-") as folder, open_experiment(path) as stored:
            is_joined = sensor_of(stored) == JOINED
            poses = registration_of(bag) if is_joined else None
            if is_joined and poses is None:
                return Part(
                    name,
                    Result.OPEN,
                    "there is no registration.yaml beside the recording, so that the sensors cannot be joined again",
                    "copy the registration with which they were joined into the folder, and repeat the audit",
                )
            if json.loads(stored.attrs.get(ATTACHMENTS, "{}")) != attachment_digests(bag):
                return Part(
                    name,
                    Result.OPEN,
                    "made with other attached files than those of now",
                    f"'fringedic process {bag} --overwrite' makes results with those of now",
                )
            target = Path(folder) / path.name
            if poses is not None:  # from the datasets of the sensors, which are parts of their own
                tell(f"{path.name}: joining the sensors again")
                join_recording(bag, poses, output=target, strain_window=int(stored.attrs["strain_window"]))
            else:
                _process_again(bag, stored, settings, target, tell)
            with open_experiment(target) as computed:
                if PHASE_CHECK in stored and bool(np.isnan(stored[PHASE_CHECK]).all()):
                    found = compare_bits(stored.drop_vars(PHASE_CHECK), _as_of_the_nodes(computed))
                else:
                    found = compare_bits(stored, computed)
                size = sum(int(each.size) for each in computed.variables.values())
    except FringedicError as error:
        return Part(name, Result.FAILS, f"cannot be computed again: {error}", "use a copy of recording and dataset")
    if not found:
        source = "the raw data" if poses is None else f"the results of its sensors and {poses.name}"
        return Part(name, Result.HOLDS, f"computed again from {source}, equal bit by bit ({size:.3g} values)")
    words = differences_words(found)
    other = other_software(noted[-1].software) if noted else "with what software and settings is not in the log"
    if other:
        return Part(
            name,
            Result.OPEN,
            f"computed again with other software ({other}): {words}",
            "repeat the audit with the software of the log, or judge the differences",
        )
    return Part(name, Result.FAILS, f"computed again with the same software: {words}", _CHANGED)


def _process_again(
    bag: Path, stored: xr.Dataset, settings: Mapping[str, Any], target: Path, tell: Callable[[str], None]
) -> None:
    """Compute a dataset again with the settings that the log contains."""
    process_bag(
        bag,
        output=target,
        overrides=settings.get("overrides"),
        steps=settings.get("steps"),
        reference=settings.get("reference") or None,
        calibration=recorded_calibration(stored) if settings.get("calibration") is not None else None,
        experiment=settings.get("experiment") or stored.attrs.get("experiment"),
        sensor=settings.get("sensor") or sensor_of(stored),
        every_frame=settings.get("every_frame", False),
        progress=lambda step, error: tell(f"{target.name}: step {step} {error or 'computed again'}"),
    )


def _as_of_the_nodes(computed: xr.Dataset) -> xr.Dataset:
    """Return a dataset without the check of the phase, which needs the frames, so that the nodes do not make it."""
    names = [name for name in CLOSURES if name in computed and name != PHASE_CHECK]
    steps = range(computed.sizes["step"])
    confirmed = [confirmed_fraction({name: computed[name][step].values for name in names}, 1) for step in steps]
    attributes = computed["confirmed_fraction"].attrs
    return computed.drop_vars(PHASE_CHECK).assign(confirmed_fraction=("step", np.array(confirmed), attributes))


def other_software(noted: Mapping[str, str]) -> str:
    """Return how the software here differs from that of an entry; empty if it does not."""
    return differences({**software_identity(), "processor": processor()}, noted)


def differences_words(found: Sequence[Difference]) -> str:
    """Return the differences as a sentence."""
    words = [
        f"{each.name} in {each.values} of {counted(each.of, 'value')}"
        + ("" if math.isnan(each.largest) else f", by {number_text(each.largest, 3)} {each.unit} at most")
        for each in found[:_SHOWN]
    ]
    more = [f"{len(found) - _SHOWN} more"] if len(found) > _SHOWN else []
    return f"differ: {'; '.join(words + more)}"


def sensors_of(entries: Sequence[Entry]) -> list[str]:
    """Return the names of the sensors of a run that had several."""
    return list(dict.fromkeys(name for entry in entries for name in entry.details.get(CALIBRATION_SOURCES, {})))


def check_calibration_file(run: Path, entries: Sequence[Entry], sensor: str = "") -> tuple[Part, Path | None]:
    """Compare the calibration of a run, or of one of its sensors, with the file that its rig file named.

    Return that file as well if it is equal.
    """
    part = CALIBRATION_OF_RUN
    pattern = f"calibration.{sensor}.yaml" if sensor else "calibration*.yaml"
    files = sorted(path for path in run.glob(pattern) if path.is_file())
    if not files:
        return Part(part, Result.NOTE, "the run has none; displacements are in pixels"), None
    given = [
        entry.details.get(CALIBRATION_SOURCES, {}).get(sensor) if sensor else entry.details.get(CALIBRATION_SOURCE)
        for entry in entries
    ]
    named = [file for file in given if file]
    if not named:
        return _given_geometry(files), None
    source = Path(named[-1])
    if not source.is_file():
        return Part(
            part, Result.OPEN, f"{source} is not here", "repeat the audit on the computer with the calibration"
        ), None
    try:
        same = [_text(RigModel.from_yaml(file)) == _text(RigModel.from_yaml(source)) for file in files]
    except FringedicError as error:
        return Part(part, Result.FAILS, str(error), "restore the calibration from a copy"), None
    if not all(same):
        return Part(
            part,
            Result.FAILS,
            f"{source} is not the calibration of this run any more",
            "look for the calibration with the identifier that the report of the run names",
        ), None
    return Part(part, Result.HOLDS, f"equal to {source}"), source


def _given_geometry(files: Sequence[Path]) -> Part:
    """Tell what a geometry means that no calibration was made for."""
    part = CALIBRATION_OF_RUN
    try:
        simulated = all(RigModel.from_yaml(file).source == VIRTUAL_RIG for file in files)
    except FringedicError as error:
        return Part(part, Result.FAILS, str(error), "restore the calibration from a copy")
    if simulated:
        found = (
            "geometry given, not calibrated: that of the virtual rig, whose images are simulated with the same numbers"
        )
        return Part(part, Result.NOTE, found)
    return Part(
        part,
        Result.OPEN,
        "geometry given, not calibrated: its numbers were written into the rig file. The results follow from the "
        "images and these numbers; no measurement supports heights, displacements and their uncertainties",
        "measure the calibration, and name its file in the rig file",
    )


def check_calibration(file: Path, entries: Sequence[Entry]) -> Part:
    """Compute a calibration again from the recording beside it, and compare the numbers.

    Parameters
    ----------
    file
        The calibration.
    entries
        Log of its folder; empty if it has none.
    """
    part, bag = "calibration from its recording", file.with_name(BAG)
    if not bag.is_dir():
        return Part(part, Result.OPEN, f"{file.parent} contains no recording", "keep the recording of the calibration")
    try:
        result = calibrate_recording(bag).result
        assert result is not None, "it was computed"
        again, stored = _text(result.model), _text(RigModel.from_yaml(file))
    except (FringedicError, OSError) as error:
        return Part(part, Result.FAILS, f"cannot be computed again: {error}", "use a copy of the calibration")
    if again == stored:
        return Part(part, Result.HOLDS, f"{file} computed again from {bag}, equal in every digit")
    other = other_software(entries[0].software) if entries else "with what software is in no log"
    if other:
        return Part(
            part,
            Result.OPEN,
            f"computed again with other software ({other}), {file} has other numbers",
            "compare both with 'fringedic calibrate --from', with the software of the calibration",
        )
    return Part(
        part,
        Result.FAILS,
        f"computed again with the same software, {file} has other numbers",
        "use a copy of the calibration",
    )


def _text(model: RigModel) -> str:
    with tempfile.TemporaryDirectory() as folder:
        model.to_yaml(Path(folder) / "model.yaml")
        return (Path(folder) / "model.yaml").read_text("utf-8")
