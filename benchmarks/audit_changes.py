"""Audit of a run: every one of a thousand random changes has to be found, and its time is compared with `process`.

Changes of people without the key of the laboratory: bits, digits, removed, added, cut off and exchanged files, edited,
removed and exchanged lines of the log, also with correct digests in all lines and with the signature of another key.
They are looked for by the parts that need no computing. A few more are signed with the key of the laboratory: values of
the results, which only the computation from the raw data finds.

    python benchmarks/audit_changes.py [RUN] [--changes 1000] [--signed 5] [--seed 1]

RUN is the folder of a signed run with a dataset, which is copied; by default a small recording is processed and signed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from rich.console import Console
from rich.table import Table

from fringedic.audit import Result, audit_run
from fringedic.audit.parts import check_files, check_log, check_signature
from fringedic.datasets import process_bag
from fringedic.datasets.checksums import CONTENT, sum_of
from fringedic.errors import FringedicError
from fringedic.evidence import begin_log, read_log
from fringedic.evidence.keys import laboratory_key, pem_of, raw_public
from fringedic.evidence.log import LOG, OF_THE_LOG, PUBLIC_KEY, SIGNATURE

RECORDING = Path(__file__).parents[1] / "ros2_ws/src/fringedic/test/recordings/version_0_1/bag"
Made = dict[Path, bytes | None]
"""New content of files, None for one that is removed."""


def files_of(run: Path) -> list[Path]:
    """Return all files of a run, also those of its log."""
    return sorted(path for path in run.rglob("*") if path.is_file())


def _filled(run: Path, chance: random.Random) -> tuple[Path, bytearray]:
    file = chance.choice([path for path in files_of(run) if path.stat().st_size])
    return file, bytearray(file.read_bytes())


def bit(run: Path, chance: random.Random) -> Made:
    """Flip a bit of a file."""
    file, data = _filled(run, chance)
    data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    return {file: bytes(data)}


def digit(run: Path, chance: random.Random) -> Made:
    """Change a digit in a file with digits."""
    while True:
        file, data = _filled(run, chance)
        places = np.flatnonzero((np.frombuffer(data, np.uint8) - ord("0")) < 10)  # wraps around below "0"
        if places.size:
            place = int(places[chance.randrange(places.size)])
            data[place] = ord("0") + (data[place] - ord("0") + chance.randrange(1, 10)) % 10
            return {file: bytes(data)}


def removed(run: Path, chance: random.Random) -> Made:
    """Remove a file."""
    return {chance.choice(files_of(run)): None}


def added(run: Path, chance: random.Random) -> Made:
    """Add a copy of a file under another name."""
    file = chance.choice(files_of(run))
    return {file.with_name(f"{file.stem}-{chance.randrange(100)}{file.suffix}"): file.read_bytes()}


def cut_off(run: Path, chance: random.Random) -> Made:
    """Remove the end of a file."""
    file, data = _filled(run, chance)
    return {file: bytes(data[: chance.randrange(len(data))])}


def exchanged(run: Path, chance: random.Random) -> Made:
    """Exchange two files with different content."""
    while True:
        one, other = chance.sample(files_of(run), 2)
        if one.read_bytes() != other.read_bytes():
            return {one: other.read_bytes(), other: one.read_bytes()}


def line(run: Path, chance: random.Random) -> Made:
    """Remove, repeat or exchange lines of the log."""
    lines = (run / LOG).read_bytes().splitlines(keepends=True)
    first, second = chance.randrange(len(lines)), chance.randrange(len(lines))
    if first == second:
        lines = lines[:first] + (lines[first + 1 :] if chance.random() < 0.5 else lines[first:] * 2)
    else:
        lines[first], lines[second] = lines[second], lines[first]
    return {run / LOG: b"".join(lines)}


def entry(run: Path, chance: random.Random) -> Made:
    """Change a field of an entry, with correct digests in all later entries."""
    entries = _entries(run)
    name = chance.choice(["time", "login", "name", "computer", "action", "why"])
    changed = chance.choice(entries)
    changed[name] = f"{changed[name]}{chance.randrange(10)}"
    return {run / LOG: _chained(entries)}


def forged(run: Path, chance: random.Random) -> Made:
    """Flip a bit of a file, and write its new digest into the log, with correct digests in all entries."""
    listed = _entries(run)
    file = chance.choice([each for each in files_of(run) if each.name not in OF_THE_LOG and each.stat().st_size])
    data = bytearray(file.read_bytes())
    data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
    name, old = file.relative_to(run).as_posix(), hashlib.sha256(file.read_bytes()).hexdigest()
    text = json.dumps(listed).replace(old, hashlib.sha256(data).hexdigest())
    assert name in text
    return {file: bytes(data), run / LOG: _chained(json.loads(text))}


def other_key(run: Path, chance: random.Random) -> Made:
    """Forge, and sign with another key."""
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    made, key = forged(run, chance), Ed25519PrivateKey.generate()
    text = made[run / LOG]
    assert text is not None
    entries = [json.loads(each) for each in text.splitlines()]
    signed = _chained([each | {"signed": None} for each in entries])
    return made | {run / LOG: signed, run / SIGNATURE: key.sign(signed), run / PUBLIC_KEY: pem_of(raw_public(key))}


KINDS: tuple[Callable[[Path, random.Random], Made], ...] = (
    bit, digit, removed, added, cut_off, exchanged, line, entry, forged, other_key,
)  # fmt: skip


def _entries(run: Path) -> list[dict[str, Any]]:
    return [json.loads(each) for each in (run / LOG).read_bytes().splitlines()]


def _chained(entries: list[dict[str, Any]]) -> bytes:
    """Return the lines of entries with the digest of the line before in each."""
    lines: list[bytes] = []
    for each in entries:
        each["previous"] = hashlib.sha256(lines[-1]).hexdigest() if lines else ""
        lines.append(json.dumps(each, separators=(",", ":")).encode() + b"\n")
    return b"".join(lines)


def is_found(run: Path, keys: list[bytes]) -> bool:
    """Return whether signature, log or files fail."""
    if not (run / LOG).exists():
        return True  # the audit fails without one
    log = read_log(run)
    parts = [check_signature(log, keys), check_log(log), check_files(run, log)]
    return any(part.result is Result.FAILS for part in parts)


def try_changes(run: Path, number: int, seed: int, keys: list[bytes]) -> Counter[tuple[str, bool]]:
    """Apply changes one after the other, each undone before the next; return how often each kind was found."""
    counts: Counter[tuple[str, bool]] = Counter()
    for each in range(number):
        chance = random.Random(f"{seed}-{each}")
        kind = KINDS[each % len(KINDS)]
        made = kind(run, chance)
        before = {file: file.read_bytes() if file.exists() else None for file in made}
        _write(made)
        counts[kind.__name__, is_found(run, keys)] += 1
        _write(before)
    return counts


def _write(contents: Made) -> None:
    for file, data in contents.items():
        if data is None:
            file.unlink(missing_ok=True)
        else:
            file.write_bytes(data)


def change_a_value(dataset: Path, chance: random.Random) -> str:
    """Change the last bit of one measured number of a dataset, and its checksums; return the name of its variable."""
    with h5py.File(dataset, "r+") as content:
        while True:
            name = chance.choice([name for name, each in content.items() if each.ndim and each.dtype.kind == "f"])
            values = content[name]
            measured = np.argwhere(np.isfinite(values[...]))
            if "row" in name or not len(measured):
                continue
            place = tuple(measured[chance.randrange(len(measured))])
            values[place] = np.nextafter(values[place], np.inf, dtype=values.dtype)
            break
        changed = values[...]
        sums = json.loads(content.attrs[CONTENT])
        sums["variables"][name]["values"] = "".join(map(sum_of, changed)) if changed.ndim > 2 else sum_of(changed)
        content.attrs[CONTENT] = json.dumps(sums, sort_keys=True)
    return str(name)


def sign_again(run: Path) -> None:
    """Begin the log anew with the first entry's details, as somebody with the key of the laboratory can."""
    first = read_log(run).entries[0]
    for name in OF_THE_LOG:
        (run / name).unlink()
    begin_log(run, first.action, details=first.details)


def sign_small_run(run: Path) -> None:
    """Process a small recording, and sign recording and results as the end of a run does."""
    shutil.copytree(RECORDING, run / "bag")
    process_bag(run / "bag", output=run / "results.nc")
    begin_log(run, "run", details={"interrupted": False, "datasets": {"results.nc": {}}})


def main() -> int:
    """Print what was found and the times; return how many changes were not found."""
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("run", type=Path, nargs="?")
    arguments.add_argument("--changes", type=int, default=1000)
    arguments.add_argument("--signed", type=int, default=5)
    arguments.add_argument("--seed", type=int, default=1)
    options = arguments.parse_args()
    console = Console()
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        if options.run is None:
            os.environ["XDG_CONFIG_HOME"] = folder  # a key of its own
            sign_small_run(run)
        else:
            shutil.copytree(options.run, run)
        keys = [raw_public(laboratory_key())]
        size = sum(file.stat().st_size for file in files_of(run))
        console.print(f"{len(files_of(run))} files, {size / 1e6:.0f} MB, {os.cpu_count()} processors")
        if is_found(run, keys):
            console.print("the run is not as its log says; give a signed one")
            return 1
        counts = try_changes(run, options.changes, options.seed, keys)
        table = Table("change", "found", "not found")
        for kind in KINDS:
            table.add_row(
                kind.__name__.replace("_", " "), *(str(counts[kind.__name__, each]) for each in (True, False))
            )
        console.print(table)
        begun = time.process_time(), time.perf_counter()
        process_bag(run / "bag", output=Path(folder) / "again.nc")
        console.print(f"process: {_since(begun)}")
        begun = time.process_time(), time.perf_counter()
        audit = audit_run(run, keys=keys)
        console.print(f"audit: {_since(begun)}")
        for part in audit.parts:
            console.print(f"  {part.result}: {part.name}", markup=False)
        dataset, silent = run / "results.nc", 0
        whole = dataset.read_bytes()
        for each in range(options.signed):
            name = change_a_value(dataset, random.Random(f"{options.seed} {each}"))
            sign_again(run)
            part = next(part for part in audit_run(run, keys=keys).parts if part.name.startswith("results"))
            silent += part.result is not Result.FAILS
            console.print(f"signed with the key, last bit of {name}: {part.result}, {part.found}", markup=False)
            dataset.write_bytes(whole)
    return silent + sum(count for (_, found), count in counts.items() if not found)


def _since(begun: tuple[float, float]) -> str:
    return f"{time.process_time() - begun[0]:.1f} s of processor time, {time.perf_counter() - begun[1]:.1f} s"


if __name__ == "__main__":
    try:
        sys.exit(main())
    except FringedicError as error:
        sys.exit(str(error))
