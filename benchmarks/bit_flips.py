"""Single flipped bits in a recording: each is reported or harmless, and none ends in a traceback.

A part of a real recording is copied, uncompressed and compressed, with and without its index. After each flip it is
read twice: as every reader does, and with a check of all chunks as `fringedic recover` does.
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
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from rich.console import Console
from rich.table import Table

from fringedic.errors import RecordingError
from fringedic.recording import BagReader, BagWriter, RawMessage

RECORDING = Path(__file__).parents[1] / "ros2_ws/src/fringedic/test/recordings/version_0_1/bag"
FLIPS = 10_000
MESSAGES = 300  # of the copied recording: ten thousand flips take some minutes then
Outcome = Literal["harmless", "reported, nothing lost", "reported", "silent", "traceback"]
COMPRESSIONS: tuple[Literal["none", "zstd"], ...] = ("none", "zstd")
OUTCOMES: tuple[Outcome, ...] = ("harmless", "reported, nothing lost", "reported", "silent", "traceback")


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

    def flip(self, file: Path) -> None:
        """Flip one bit of a file, read the recording, and restore the file."""
        place, bit = self._random.randrange(file.stat().st_size), self._random.randrange(8)
        with file.open("r+b", buffering=0) as stream:
            stream.seek(place)
            before = stream.read(1)
            stream.seek(place)
            stream.write(bytes([before[0] ^ 1 << bit]))
            for check in (False, True):
                outcome = self._outcome(check=check)
                self.outcomes[outcome] += 1
                if outcome in ("silent", "traceback"):
                    print(f"{file.name}, byte {place}, bit {bit}: {outcome}", file=sys.stderr)
            stream.seek(place)
            stream.write(before)

    def _outcome(self, *, check: bool) -> Outcome:
        try:
            reader = BagReader(self._bag, check=check)
            complete = list(reader.raw()) == self._whole
        except RecordingError:
            return "reported"
        except Exception:
            traceback.print_exc()
            return "traceback"
        if reader.lost:
            return "reported, nothing lost" if complete else "reported"
        return "harmless" if complete else "silent"


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
    (bag / "metadata.yaml").unlink()


def main() -> int:
    """Flip, print the table, and return 1 if a flip was silent or a traceback."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flips", type=int, default=FLIPS, help="flips of each kind of recording")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    messages = list(BagReader(RECORDING).raw())[:MESSAGES]
    table = Table(title=f"{options.flips} flipped bits in each recording, each read twice", title_justify="left")
    table.add_column("recording")
    for column in OUTCOMES:
        table.add_column(column, justify="right")
    failures = 0
    memory = Path("/dev/shm")
    with tempfile.TemporaryDirectory(prefix="fringedic-bench-", dir=memory if memory.is_dir() else None) as name:
        for compression, closed in itertools.product(COMPRESSIONS, (True, False)):
            bag = copy_recording(Path(name) / "bag", compression, messages)
            if not closed:
                remove_index(bag)
            campaign = Campaign(bag, options.seed)
            files = sorted(bag.iterdir())
            for number in range(options.flips):
                campaign.flip(files[0] if number % 10 else files[-1])
            counts = [campaign.outcomes[outcome] for outcome in OUTCOMES]
            table.add_row(f"{compression}, {'closed' if closed else 'not closed'}", *map(str, counts))
            failures += sum(counts[-2:])
            shutil.rmtree(bag)
    Console(markup=False).print(table)
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
