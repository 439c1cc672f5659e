"""Damaged results: each change of a dataset, a store or a calibration is reported or harmless, and never silent.

A recording is processed as NetCDF, as Zarr and by a campaign, and a calibration is copied. The datasets contain only
VARIABLES, at least one of each kind, because opening takes a time proportional to their number. After each change
everything is opened and read, in another process that may end or stand still, and compared with what was written. Half
of the changes of a folder are in objects drawn by their size, half in objects drawn with equal probability, so that the
few bytes of metadata are damaged as well. With --overhead, times of writing and reading are measured instead.
"""

from __future__ import annotations

import argparse
import hashlib
import logging
import multiprocessing
import random
import re
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import median

import numpy as np
import xarray as xr
import yaml
from rich.console import Console
from rich.table import Table

import fringedic
from fringedic.calibration import RigCalibration
from fringedic.calibration.history import recorded_checks
from fringedic.camera import DistortionMap
from fringedic.campaign import CampaignStore, Serial, load_campaign, status_of, update_plan
from fringedic.campaign.group_store import GroupStore
from fringedic.datasets import checked_store, checksums, quantities, stores
from fringedic.errors import FringedicError

RECORDED = Path(__file__).parents[1] / "ros2_ws/src/fringedic/test/recordings/version_0_1"
OUTCOMES = ("told", "no effect", "silent", "traceback", "ended or still")
LIMIT_S = 60.0
SETTINGS = {"dic.spacing": 8}  # small maps, so that metadata are a large part of the files
VARIABLES = (
    *("step", "time", "reference_step", "error", "valid_fraction", "force", "force_sigma", "row", "column"),
    *("force_time", "force_series", "displacement_x", "w", "sigma_w"),
)
READS = 25  # of a process; a new one after each took as long as reading
DIGIT = re.compile(rb"[0-9]")


def digest_of_dataset(dataset: xr.Dataset) -> str:
    """Return a hash of everything that a reader of a dataset gets."""
    found = hashlib.sha256(repr(sorted((k, v) for k, v in dataset.attrs.items() if k != checksums.CHECKED)).encode())
    for name in sorted(map(str, dataset.variables)):
        variable = dataset.variables[name]
        values = variable.values
        found.update(repr((name, variable.dims, values.dtype, values.shape, sorted(variable.attrs.items()))).encode())
        found.update(repr(values.tolist()).encode() if values.dtype.kind in "OTU" else values.tobytes())
    return found.hexdigest()


def read_dataset(file: Path) -> str:
    """Open and read a dataset."""
    with fringedic.open_experiment(file) as dataset:
        return digest_of_dataset(dataset)


def read_campaign(store: Path) -> str:
    """Open and read a campaign with all its datasets."""
    tree, catalogue = fringedic.open_campaign(store)
    return repr((catalogue.to_json(), [digest_of_dataset(tree[name].to_dataset()) for name in catalogue.index]))


def read_calibration(folder: Path) -> str:
    """Read everything that a calibration has written."""
    found = RigCalibration.load(folder)
    residuals = digest_of_dataset(found.residual_map)
    lens = DistortionMap.load(folder / "distortion.yaml").to_dict()
    parts = {name: value for name, value in vars(found).items() if name != "residual_map"}
    return repr((parts, residuals, lens, recorded_checks(folder)))


class Damage:
    """Changes a file or folder, reads it in another process, restores it, and counts the outcomes.

    Each state of a file is a new file, so that no library of the process finds an earlier one that it still holds.

    Parameters
    ----------
    place
        The file or folder.
    read
        Returns its content as a text.
    seed
        Of the random places.
    """

    def __init__(self, place: Path, read: Callable[[Path], str], seed: int = 1) -> None:
        self.outcomes: Counter[str] = Counter()
        self._place, self._read = place, read
        self._random = random.Random(seed)
        self._whole = read(place)
        found = [place] if place.is_file() else sorted(place.rglob("*"))
        self._files = [each for each in found if each.is_file() and each.stat().st_size]
        self._fork = multiprocessing.get_context("fork")
        self._process: multiprocessing.process.BaseProcess | None = None
        self._answers: Connection
        self._reads = 0

    def flip(self) -> None:
        """Flip one bit."""
        file, data = self._chosen()
        place = self._random.randrange(len(data))
        data[place] ^= 1 << self._random.randrange(8)
        self._try(file, bytes(data), f"bit of byte {place}")

    def change_digit(self) -> None:
        """Replace one digit of a text by another one."""
        file = self._random.choice([each for each in self._files if each.suffix == ".yaml"])
        data = bytearray(file.read_bytes())
        place = self._random.choice([each.start() for each in DIGIT.finditer(data)])
        data[place] = self._random.choice([each for each in b"0123456789" if each != data[place]])
        self._try(file, bytes(data), f"digit {place}")

    def shorten(self) -> None:
        """Remove the end of a file."""
        file, data = self._chosen()
        self._try(file, bytes(data[: self._random.randrange(len(data))]), "shortened")

    def remove(self) -> None:
        """Remove a file of a folder."""
        self._try(self._chosen()[0], None, "removed")

    def _chosen(self) -> tuple[Path, bytearray]:
        weights = [file.stat().st_size for file in self._files] if self._random.random() < 0.5 else None
        [file] = self._random.choices(self._files, weights)
        return file, bytearray(file.read_bytes())

    def _try(self, file: Path, damaged: bytes | None, description: str) -> None:
        whole = file.read_bytes()
        file.unlink()
        if damaged is not None:
            file.write_bytes(damaged)
        outcome, words = self._outcome()
        file.unlink(missing_ok=True)
        file.write_bytes(whole)
        self.outcomes[outcome] += 1
        if outcome in OUTCOMES[2:]:
            print(f"{file}, {description}: {outcome}: {words}", file=sys.stderr)

    def _outcome(self) -> tuple[str, str]:
        if self._process is None:
            self._answers, other_end = self._fork.Pipe()
            self._process, self._reads = self._fork.Process(target=self._answer, args=(other_end,)), 0
            self._process.start()
            other_end.close()
        self._reads += 1
        found = None
        try:
            self._answers.send(None)
            if self._answers.poll(LIMIT_S):
                found = self._answers.recv()
        except (EOFError, OSError):
            pass  # it has ended without an answer
        if found is None or self._reads == READS:
            self.close()
        return found or ("ended or still", "")

    def close(self) -> None:
        """End the process that reads."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._answers.close()
            self._process = None

    def _answer(self, questions: Connection) -> None:
        logging.disable()
        self._answers.close()  # so that it ends with the benchmark
        while True:
            questions.recv()
            questions.send(self._result())

    def _result(self) -> tuple[str, str]:
        try:
            return ("no effect", "") if self._read(self._place) == self._whole else ("silent", "")
        except FringedicError as error:
            return "told", str(error)
        except Exception:
            return "traceback", traceback.format_exc()


def keep_variables(file: Path, store: stores.Store) -> None:
    """Write a processed dataset again with the chosen variables alone."""
    target = checked_store.ChecksummedStore(store)
    with xr.open_dataset(file, engine="h5netcdf", decode_cf=False) as raw:
        for name in VARIABLES:
            found = raw.variables[name]
            dtype = quantities.TEXT if found.dtype.kind in "OTU" else found.dtype.str
            about = {key: value for key, value in found.attrs.items() if key != "_FillValue"}
            dimensions = tuple(map(str, found.dims))
            target.add_variable(stores.Variable(name, dimensions, dtype, about), {**raw.sizes, "step": 0})
            if "step" not in dimensions:
                target.put(name, slice(None), found.values)
        for step in range(raw.sizes["step"]):
            target.grow(step + 1)
            for name in VARIABLES:
                if "step" in raw.variables[name].dims:
                    target.put(name, step, raw.variables[name].values[step])
        target.finish({key: value for key, value in raw.attrs.items() if key != checksums.CONTENT})


def campaign_in(folder: Path) -> Path:
    """Process a recording by a campaign and return its store."""
    folder.mkdir()
    shutil.copytree(RECORDED / "bag", folder / "recordings" / "plate" / "bag")
    content = {"recordings": [{"path": "recordings"}], "settings": SETTINGS}
    (folder / "campaign.yaml").write_text(yaml.safe_dump(content))
    campaign = load_campaign(folder)
    plan = update_plan(campaign)
    store = CampaignStore(campaign.store)
    list(Serial().outcomes(status_of(store, plan).waiting))
    [name] = store.documents("receipts")
    keep_variables(processed_whole(folder / "whole.nc"), GroupStore(store, name))
    return Path(campaign.store)


def calibration_in(folder: Path) -> Path:
    """Write a calibration as this version writes it."""
    folder.mkdir()
    recorded = RECORDED / "calibration"
    RigCalibration.load(recorded).save(folder)
    DistortionMap.load(recorded / "distortion.yaml").save(folder / "distortion.yaml")
    return folder


def processed_whole(file: Path) -> Path:
    """Process a recording into a dataset with all variables."""
    return fringedic.process_bag(RECORDED / "bag", output=file, overrides=SETTINGS)


def processed(file: Path) -> Path:
    """Process a recording into a dataset with the chosen variables."""
    whole = processed_whole(file.with_name(f"whole of {file.name}.nc"))
    keep_variables(whole, stores.create_store(file))
    whole.unlink()
    return file


def exported(folder: Path) -> Path:
    """Export a dataset as NetCDF."""
    folder.mkdir()
    with fringedic.open_experiment(processed(folder / "processed.nc")) as dataset:
        return Path(dataset.fringedic.export(folder / "exported", ["netcdf"])[0].path)


SUBJECTS: dict[str, tuple[Callable[[Path], Path], Callable[[Path], str]]] = {
    "results.nc": (processed, read_dataset),
    "results.zarr": (processed, read_dataset),
    "exported": (exported, read_dataset),
    "store": (campaign_in, read_campaign),
    "calibration": (calibration_in, read_calibration),
}
"""What is damaged: how it is written, and how it is read."""


def damage(folder: Path, flips: int, seed: int, only: str) -> int:
    """Damage everything, print the table, and return how many outcomes are not acceptable."""
    table = Table(title="Damaged results", title_justify="left")
    for column in ("what and damage", *OUTCOMES):
        table.add_column(column, justify="left" if column.startswith("what") else "right")
    failures = 0
    for title, (write, read) in SUBJECTS.items():
        if only not in ("", title):
            continue
        place = write(folder / title)
        files = [place] if place.is_file() else [each for each in place.rglob("*") if each.is_file()]
        print(f"{title}: {len(files)} files, {sum(each.stat().st_size for each in files)} bytes", flush=True)
        kinds: dict[str, Callable[[Damage], None]] = {"flipped bits": Damage.flip, "shortened": Damage.shorten}
        if place.is_dir():
            kinds["removed files"] = Damage.remove
        if title == "calibration":
            kinds["changed digits"] = Damage.change_digit
        for kind, change in kinds.items():
            begin, tried = time.perf_counter(), Damage(place, read, seed)
            for _ in range(flips if kind in ("flipped bits", "changed digits") else flips // 10):
                change(tried)
            tried.close()
            counts = [tried.outcomes[outcome] for outcome in OUTCOMES]
            print(f"{title}: {kind}: {counts}, {time.perf_counter() - begin:.0f} s", flush=True)
            table.add_row(f"{title}: {kind}", *map(str, counts))
            failures += sum(counts[2:])
    Console(markup=False).print(table)
    return failures


def overhead(folder: Path, rounds: int) -> None:
    """Print the processor time of writing and reading with checksums over that without them."""
    values = np.random.default_rng(1).standard_normal((960, 1280)).astype(np.float32)
    names, steps = [f"map_{number}" for number in range(10)], 6

    def write(file: Path, summed: bool) -> None:
        plain = stores.create_store(file)
        store = checked_store.ChecksummedStore(plain) if summed else plain
        for name, size in (("row", 960), ("column", 1280)):
            store.add_variable(stores.Variable(name, (name,), "i8", {}), {"row": 960, "column": 1280})
            store.put(name, slice(None), np.arange(size))
        store.add_variable(stores.Variable("step", ("step",), "i8", {}), {"step": 0})
        store.add_variable(stores.Variable("error", ("step",), "text", {}), {"step": 0})
        for name in names:
            variable = stores.Variable(name, ("step", "row", "column"), "f4", {})
            store.add_variable(variable, {"step": 0, "row": 960, "column": 1280})
        for step in range(steps):
            store.grow(step + 1)
            store.put("step", step, step)
            store.put("error", step, "")
            for name in names:
                store.put(name, step, values)
        store.finish({})

    def read(file: Path) -> None:
        with fringedic.open_experiment(file) as dataset:
            for step in range(steps):
                for name in names:
                    dataset[name][step].values  # noqa: B018

    for suffix in (".nc", ".zarr"):
        times: dict[str, list[float]] = {}
        for _ in range(rounds):
            for label, summed in (("without", False), ("with", True)):
                file = folder / f"{label}{suffix}"
                if file.is_dir():
                    shutil.rmtree(file)
                else:
                    file.unlink(missing_ok=True)
                times.setdefault(f"write {label}", []).append(_seconds(lambda: write(file, summed)))  # noqa: B023
                times.setdefault(f"read {label}", []).append(_seconds(lambda: read(file)))  # noqa: B023
        for what in ("write", "read"):
            ratio = median(times[f"{what} with"]) / median(times[f"{what} without"])
            print(f"{suffix} {what}: {median(times[f'{what} with']):.2f} s, ratio {ratio:.2f}")


def _seconds(action: Callable[[], None]) -> float:
    begin = time.process_time()
    action()
    return time.process_time() - begin


def main() -> int:
    """Damage or measure; return 1 if an outcome was silent, a traceback or the end of the process."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flips", type=int, default=1000, help="flipped bits of each; a tenth of it of other damage")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=list(SUBJECTS), default="", help="damage this alone")
    parser.add_argument("--overhead", action="store_true", help="measure times instead")
    parser.add_argument("--rounds", type=int, default=15, help="of --overhead")
    options = parser.parse_args()
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(prefix="fringedic-bench-", dir=memory if memory.is_dir() else None) as name:
        if options.overhead:
            overhead(Path(name), options.rounds)
            return 0
        return int(damage(Path(name), options.flips, options.seed, options.only) > 0)


if __name__ == "__main__":
    sys.exit(main())
