"""The audit of a run: all parts, and whether everything holds."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from cryptography.x509 import Certificate

from fringedic.audit.parts import (
    CALIBRATION,
    Part,
    Result,
    check_changes,
    check_end,
    check_files,
    check_log,
    check_recording,
    check_signature,
    check_time_stamps,
)
from fringedic.audit.results import check_calibration, check_calibration_file, check_dataset, datasets_of, sensors_of
from fringedic.errors import EvidenceError
from fringedic.evidence.log import LOG, Entry, SignedLog, has_log, read_log
from fringedic.recording.bag_files import BAG

MODEL_FILE = "calibration.yaml"


@dataclass(frozen=True)
class Audit:
    """Result of an audit.

    Attributes
    ----------
    run
        Folder of the run.
    time
        When it was audited.
    parts
        All parts.
    entries
        The log.
    """

    run: Path
    time: datetime
    parts: tuple[Part, ...]
    entries: tuple[Entry, ...]

    @property
    def holds(self) -> bool:
        """Whether no part fails, and none is not proven."""
        return not any(part.result in (Result.OPEN, Result.FAILS) for part in self.parts)


def audit_run(
    run: Path,
    *,
    keys: Collection[bytes] = (),
    authorities: Collection[Certificate] = (),
    recompute: bool = True,
    progress: Callable[[str], None] = lambda _: None,
) -> Audit:
    """Check everything that supports the results of a run; nothing in its folder is changed.

    Parameters
    ----------
    run
        Folder of a run, or of a calibration.
    keys
        Public keys of the laboratory, 32 bytes each, from `fringedic.evidence.keys.read_public_key`; by default the one
        of this computer.
    authorities
        Root certificates of time-stamp authorities.
    recompute
        Compute results and calibration again from their recordings; otherwise these parts are not proven.
    progress
        Called with what is being done.

    Raises
    ------
    EvidenceError
        The folder is that of no run, or a file cannot be read.

    Examples
    --------
    >>> audit_run(Path("recordings/plate-7")).holds  # doctest: +SKIP
    True
    """
    run = run.absolute()
    bag = run / BAG
    if not has_log(run) and not bag.is_dir():
        raise EvidenceError(f"{run}: has neither {LOG} nor a recording {BAG}; give the folder of a run")
    log = read_log(run) if has_log(run) else None
    progress("log, signature and files")
    parts = _of_the_log(run, log, keys)
    progress("raw data")
    parts.append(check_recording(bag))
    entries = tuple(log.entries) if log is not None else ()
    if entries:
        parts.append(check_end(entries))
    if entries and entries[0].action == CALIBRATION:
        parts.append(_calibration(run / MODEL_FILE, entries, recompute, progress))
    else:
        parts += _results(run, bag, entries, recompute, progress)
        parts += _calibration_of_run(run, entries, keys, recompute, progress)
    if log is not None and entries:
        parts += [check_time_stamps(log, list(authorities)), check_changes(log)]
    return Audit(run, datetime.now(UTC), tuple(parts), entries)


def _of_the_log(
    run: Path, log: SignedLog | None, keys: Collection[bytes], without: Result = Result.FAILS
) -> list[Part]:
    """Check a log; without one the only part has the result `without`."""
    if log is None:
        return [
            Part(
                "signature",
                without,
                f"there is no {LOG}: the run was killed before its end, an earlier version made it, or the log is gone",
                f"fringedic run --continue goes on with an interrupted run; fringedic note {run} WHY signs it as it is",
            )
        ]
    return [check_signature(log, keys), check_log(log), check_files(run, log)]


def _results(
    run: Path, bag: Path, entries: tuple[Entry, ...], recompute: bool, progress: Callable[[str], None]
) -> list[Part]:
    datasets = list(datasets_of(run, bag))
    if not datasets:
        return [Part("results", Result.OPEN, "the run contains no dataset", f"fringedic process {bag} makes it")]
    if not recompute:
        return [Part(f"results {path.name}", Result.OPEN, "not computed again, as asked") for path in datasets]
    return [check_dataset(path, bag, entries, progress) for path in datasets]


def _calibration_of_run(
    run: Path, entries: tuple[Entry, ...], keys: Collection[bytes], recompute: bool, progress: Callable[[str], None]
) -> list[Part]:
    """Check the calibration of a run, and the folder that it comes from, with its log and recording; of each sensor."""
    parts = []
    for sensor in sensors_of(entries) or [""]:
        parts += _calibration_of_sensor(run, entries, sensor, keys, recompute, progress)
    return parts


def _calibration_of_sensor(
    run: Path,
    entries: tuple[Entry, ...],
    sensor: str,
    keys: Collection[bytes],
    recompute: bool,
    progress: Callable[[str], None],
) -> list[Part]:
    part, file = check_calibration_file(run, entries, sensor)
    if file is None:
        return [part]
    progress(f"calibration {file.parent}")
    log = read_log(file.parent) if has_log(file.parent) else None
    own = _of_the_log(file.parent, log, keys, without=Result.OPEN)
    if file.with_name(BAG).is_dir():
        own.append(check_recording(file.with_name(BAG)))
    own = [Part(f"calibration: {each.name}", each.result, each.found, each.action) for each in own]
    return [part, *own, _calibration(file, () if log is None else log.entries, recompute, progress)]


def _calibration(file: Path, entries: Sequence[Entry], recompute: bool, progress: Callable[[str], None]) -> Part:
    if not recompute:
        return Part("calibration from its recording", Result.OPEN, "not computed again, as asked")
    progress(f"{file}: computing again")
    return check_calibration(file, entries)
