"""A dataset larger than memory allows: time to open it and to read one map, and the memory that both take.

A dataset of 10 GB (1280x960, all maps) is really written in both formats, measured by fresh processes with a cold page
cache where the system allows to drop it, and removed.
"""

from __future__ import annotations

import argparse
import json
import shutil
import statistics
import subprocess
import sys
import tempfile
import textwrap
from pathlib import Path

import numpy as np

from fringedic.datasets.quantities import MAPS
from fringedic.datasets.rows import Row
from fringedic.datasets.writer import DatasetWriter
from fringedic.steps.parameters import CouplingParameters, DicParameters, PhaseParameters
from fringedic.steps.recorded_parameters import StepSettings

ROWS, COLUMNS = 960, 1280
TARGETS = {"open [s]": 1.0, "one map [s]": 0.2, "memory [MB]": 500.0}
REPEATS = 3
MEASURE = """
    import json, sys, time
    import fringedic
    from fringedic.datasets import open_experiment

    start = time.perf_counter()
    dataset = open_experiment(sys.argv[1])
    opened = time.perf_counter() - start
    middle = dataset.sizes["step"] // 2
    start = time.perf_counter()
    values = dataset["w"].isel(step=middle).values
    read = time.perf_counter() - start
    assert values.shape == (960, 1280)
    for step in range(dataset.sizes["step"]):
        dataset["u"].isel(step=step).values
    # not ru_maxrss, which begins with what the parent had before it became this program
    status = dict(line.split(":", 1) for line in open("/proc/self/status"))
    memory = int(status["VmHWM"].split()[0]) / 1024
    print(json.dumps({"open [s]": opened, "one map [s]": read, "memory [MB]": memory}))
"""


def write(target: Path, gigabytes: float) -> float:
    """Write noise as an experiment of some size; return what it takes on the disk [GB]."""
    generator = np.random.default_rng(1)
    maps = {name: generator.normal(size=(ROWS, COLUMNS)).astype(np.float32) for name in MAPS}
    steps = round(gigabytes * 1e9 / sum(values.nbytes for values in maps.values()))
    settings = StepSettings(
        {"phase": PhaseParameters(), "dic": DicParameters(), "coupling": CouplingParameters()}, None, {}, None
    )
    with DatasetWriter(target, {"experiment": "large", "source": "none"}) as writer:
        for step in range(steps):
            writer.add(Row(step, step, reference_step=0, maps=maps), settings)
    files = [target] if target.is_file() else [file for file in target.rglob("*") if file.is_file()]
    return sum(file.stat().st_size for file in files) / 1e9


def drop_cache() -> bool:
    """Make the next reading come from the disk, where this process may ask for it."""
    subprocess.run(["sync"], check=True)
    try:
        Path("/proc/sys/vm/drop_caches").write_text("1")
    except OSError:
        return False
    return True


def measure(target: Path) -> dict[str, float]:
    """Medians over fresh processes."""
    runs = []
    for _ in range(REPEATS):
        drop_cache()
        done = subprocess.run(
            [sys.executable, "-c", textwrap.dedent(MEASURE), str(target)], check=True, capture_output=True, text=True
        )
        runs.append(json.loads(done.stdout))
    return {name: statistics.median(run[name] for run in runs) for name in TARGETS}


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--gigabytes", type=float, default=10.0)
    arguments.add_argument("--folder", type=Path, default=None, help="where there is room; removed afterwards")
    chosen = arguments.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="fringedic-large-", dir=chosen.folder))
    try:
        if shutil.disk_usage(folder).free < 1.5e9 * chosen.gigabytes:
            raise SystemExit(f"{folder}: less than {1.5 * chosen.gigabytes:g} GB free; name another --folder")
        print(f"| format | on disk | {' | '.join(TARGETS)} |\n|---|---:|---:|---:|---:|")
        for suffix in (".nc", ".zarr"):
            target = folder / f"large{suffix}"
            size = write(target, chosen.gigabytes)
            figures = measure(target)
            cells = " | ".join(f"{figures[name]:.2f} (target {limit:g})" for name, limit in TARGETS.items())
            print(f"| {suffix} | {size:.1f} GB | {cells} |", flush=True)
            shutil.rmtree(target) if target.is_dir() else target.unlink()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
