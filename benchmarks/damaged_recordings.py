"""Damaged recordings: every damage is reported or harmless, gives no wrong message, and none ends in a traceback.

A part of a real recording is copied, uncompressed and compressed, with and without its index. After each flipped bit it
is read twice: as every reader does, and with a check of all chunks as `fringedic recover` does. The closed recordings
are damaged in larger pieces as well: erased, replaced, cut off, inserted, removed, exchanged.
"""

from __future__ import annotations

import argparse
import itertools
import os
import random
import shutil
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

from rich.console import Console
from rich.table import Table

from fringedic.errors import RecordingError
from fringedic.recording import BagReader, BagWriter, RawMessage

RECORDING = Path(__file__).parents[1] / "ros2_ws/src/fringedic/test/recordings/version_0_1/bag"
FLIPS = 10_000
MESSAGES = 300  # of the copied recording: ten thousand flips take some minutes then
Outcome = Literal["harmless", "reported, nothing lost", "reported", "silent or wrong", "traceback"]
COMPRESSIONS: tuple[Literal["none", "zstd"], ...] = ("none", "zstd")
OUTCOMES: tuple[Outcome, ...] = ("harmless", "reported, nothing lost", "reported", "silent or wrong", "traceback")
SIZES = (1, 8, 100, 5000, 60_000)  # bytes of a larger damage


def _erase(data: bytearray, first: slice, _: slice) -> None:
    data[first] = bytes(len(data[first]))


def _replace(data: bytearray, first: slice, _: slice) -> None:
    data[first] = random.Random(first.start).randbytes(len(data[first]))


def _cut_off(data: bytearray, first: slice, _: slice) -> None:
    del data[first.start :]


def _insert(data: bytearray, first: slice, _: slice) -> None:
    data[first.start : first.start] = random.Random(first.start).randbytes(first.stop - first.start)


def _remove(data: bytearray, first: slice, _: slice) -> None:
    del data[first]


def _exchange(data: bytearray, first: slice, second: slice) -> None:
    data[first], data[second] = data[second], data[first]


KINDS: dict[str, Callable[[bytearray, slice, slice], None]] = {
    "erased": _erase,
    "replaced": _replace,
    "cut off": _cut_off,
    "inserted": _insert,
    "removed": _remove,
    "exchanged": _exchange,
}


class Campaign:
    """Flips bits of one recording and counts the outcomes.

    Parameters
    ----------
    bag
        The recording, which is changed.
    seed
        Of the random places.
    """

    def __init__(self, bag: Path, seed: int) -> None:
        self.outcomes: Counter[Outcome] = Counter()
        self._bag = bag
        self._random = random.Random(seed)
        self._whole = list(BagReader(bag).raw())
        self._known = set(self._whole)

    def flip(self, file: Path) -> None:
        """Flip one bit of a file, read the recording, and restore the file."""
        data = bytearray(file.read_bytes())
        place = self._random.randrange(len(data))
        data[place] ^= 1 << self._random.randrange(8)
        self._read(file, data, f"bit of byte {place}")

    def damage(self, file: Path, kind: str) -> None:
        """Damage a file by one of `KINDS`, read the recording, and restore the file."""
        data = bytearray(file.read_bytes())
        size = self._random.choice(SIZES)
        first, second = (self._random.randrange(max(1, len(data) - size)) for _ in range(2))
        KINDS[kind](data, slice(first, first + size), slice(second, second + size))
        self._read(file, data, f"{kind} {size} bytes at {first}")

    def _read(self, file: Path, damaged: bytes, description: str) -> None:
        whole = file.read_bytes()
        file.write_bytes(damaged)
        for check in (False, True):
            outcome = self._outcome(check=check)
            self.outcomes[outcome] += 1
            if outcome in OUTCOMES[-2:]:
                print(f"{file.name}, {description}: {outcome}", file=sys.stderr)
        file.write_bytes(whole)

    def _outcome(self, *, check: bool) -> Outcome:
        try:
            reader = BagReader(self._bag, check=check)
            messages = list(reader.raw())
        except RecordingError:
            return "reported"
        except Exception:
            traceback.print_exc()
            return "traceback"
        complete = messages == self._whole
        if not self._known.issuperset(messages):
            return "silent or wrong"
        if reader.lost:
            return "reported, nothing lost" if complete else "reported"
        return "harmless" if complete else "silent or wrong"


def copy_recording(target: Path, compression: Literal["none", "zstd"], messages: Sequence[RawMessage]) -> Path:
    """Write some messages of the recording into a new one."""
    reader = BagReader(RECORDING)
    with BagWriter(target, compression=compression) as writer:
        for topic in reader.topics.values():
            writer.add_recorded_topic(topic)
        for number, message in enumerate(messages):
            writer.write(*message)
            if number % 60 == 0:
                writer.flush()
    return target


def remove_index(bag: Path) -> None:
    """Leave a recording as a recorder leaves it that is killed."""
    [file] = bag.glob("*.mcap")
    size = file.stat().st_size
    with file.open("rb") as stream:
        stream.seek(size - 28)
        summary = int.from_bytes(stream.read(8), "little")
    os.truncate(file, summary)
    for name in ("metadata.yaml", "manifest.sha256"):
        (bag / name).unlink()


def add_row(table: Table, title: str, campaign: Campaign) -> int:
    """Add the outcomes of a campaign; return how many are not acceptable."""
    counts = [campaign.outcomes[outcome] for outcome in OUTCOMES]
    table.add_row(title, *map(str, counts))
    return sum(counts[-2:])


def main() -> int:
    """Damage, print the table, and return 1 if an outcome was silent, wrong or a traceback."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--flips",
        type=int,
        default=FLIPS,
        help="flipped bits in each recording; a fourth of it of larger damage",
    )
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    messages = list(BagReader(RECORDING).raw())[:MESSAGES]
    table = Table(title="Damaged recordings, each read twice", title_justify="left")
    table.add_column("recording and damage")
    for column in OUTCOMES:
        table.add_column(column, justify="right")
    failures = 0
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(prefix="fringedic-bench-", dir=memory if memory.is_dir() else None) as name:
        for compression, closed in itertools.product(COMPRESSIONS, (True, False)):
            bag = copy_recording(Path(name) / "bag", compression, messages)
            if not closed:
                remove_index(bag)
            title = f"{compression}, {'closed' if closed else 'not closed'}"
            files = sorted(bag.iterdir())
            campaign = Campaign(bag, options.seed)
            for number in range(options.flips):
                campaign.flip(files[0] if number % 10 else files[-1])
            failures += add_row(table, f"{title}: flipped bits", campaign)
            if closed:
                campaign = Campaign(bag, options.seed)
                for _, kind in zip(range(options.flips // 4), itertools.cycle(KINDS), strict=False):
                    campaign.damage(files[0], kind)
                failures += add_row(table, f"{title}: larger damage", campaign)
            shutil.rmtree(bag)
    Console(markup=False).print(table)
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
