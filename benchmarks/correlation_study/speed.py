"""Time and memory of one new image against a known reference; every case in a process of its own.

    python speed.py ROWS COLUMNS WINDOW RUNS

prints the fields of `Speed` from `measure` on as JSON.
"""

from __future__ import annotations

import json
import multiprocessing
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
import scipy.fft


@dataclass(frozen=True)
class Speed:
    """Times [s] and peak memory [MB] of a process that measures one image; medians over the runs."""

    rows: int
    columns: int
    measure: float
    fastest: float
    prepare: float
    one_thread: float
    memory: float
    before: float

    @property
    def pixels(self) -> float:
        """Megapixels of the image."""
        return self.rows * self.columns / 1e6


def textured_pair(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Periodic speckle of 1.4 px and the same moved by (0.3, -0.2) px through its Fourier coefficients, 12 bits."""
    generator = np.random.default_rng(5)
    spectrum = scipy.fft.rfft2(generator.standard_normal((rows, columns), dtype=np.float32), workers=2)
    ky = 2 * np.pi * np.fft.fftfreq(rows).astype(np.float32)[:, None]
    kx = 2 * np.pi * np.fft.rfftfreq(columns).astype(np.float32)[None, :]
    spectrum *= np.exp(-0.5 * 1.4**2 * (kx**2 + ky**2))
    spectrum[0, 0] = 0

    def camera(moved: np.ndarray) -> np.ndarray:
        image = scipy.fft.irfft2(moved, (rows, columns), workers=2)
        image *= 0.15 * 4096 / image.std()
        image += 2048 + 10 * generator.standard_normal((rows, columns), dtype=np.float32)
        return np.clip(np.rint(image), 0, 4095).astype(np.uint16)

    return camera(spectrum), camera(spectrum * np.exp(-1j * (0.3 * kx - 0.2 * ky)).astype(np.complex64))


def speed(rows: int, columns: int, window: int, runs: int) -> Speed:
    """Start a process that measures an image of this size."""
    arguments = [str(value) for value in (rows, columns, window, runs)]
    done = subprocess.run([sys.executable, __file__, *arguments], check=True, capture_output=True, text=True)
    return Speed(rows, columns, **json.loads(done.stdout))


def _peak() -> float:
    """Peak memory [MB] of this program; that of getrusage would count the process it was started from as well."""
    status = Path("/proc/self/status")
    if not status.exists():
        return float("nan")
    line = next(line for line in status.read_text().splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) * 1024 / 1e6


def _images_of(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """The pair made in a child process, so that making it does not count in this one's peak memory."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "pair.npy"
        child = multiprocessing.get_context("fork").Process(target=_save_pair, args=(rows, columns, path))
        child.start()
        child.join()
        f, g = np.load(path)
    return f, g


def _save_pair(rows: int, columns: int, path: Path) -> None:
    np.save(path, np.stack(textured_pair(rows, columns)))


def main(rows: int, columns: int, window: int, runs: int) -> None:
    """Measure in this process and print the figures."""
    f, g = _images_of(rows, columns)
    from fringedic.correlation import Reference, measure_displacement

    # compiles or loads the kernels on a small image
    small = np.s_[:256, :256]
    measure_displacement(Reference(f[small], window=window), g[small])
    before = _peak()
    times: dict[str, list[float]] = {"measure": [], "prepare": [], "one_thread": []}
    threads = numba.get_num_threads()
    for k in range(runs + 1):
        begin = time.perf_counter()
        reference = Reference(f, window=window)
        middle = time.perf_counter()
        field = measure_displacement(reference, g)
        end = time.perf_counter()
        del field
        if k:
            times["prepare"].append(middle - begin)
            times["measure"].append(end - middle)
    memory = _peak()
    numba.set_num_threads(1)
    for _ in range(max(runs // 2, 1)):
        begin = time.perf_counter()
        measure_displacement(reference, g)
        times["one_thread"].append(time.perf_counter() - begin)
    numba.set_num_threads(threads)
    medians = {name: float(np.median(values)) for name, values in times.items()}
    print(json.dumps({**medians, "fastest": min(times["measure"]), "memory": memory, "before": before}))


if __name__ == "__main__":
    main(*(int(value) for value in sys.argv[1:]))
