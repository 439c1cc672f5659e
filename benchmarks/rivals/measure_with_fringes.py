"""Patterns and decoding of the package `fringes`; runs in its environment alone.

    python measure_with_fringes.py FOLDER

FOLDER holds job.json: {"width", "height" of the projector, "frequencies", "shifts"}. Without frames.npy there, the
patterns are written to patterns.npy; with it, it is decoded several times: decoded.npz gets the projector's column and
the seconds, and the time that OpenCV's contributed spatial unwrapping (absent from the project's OpenCV) leaves wrong.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import cv2
import numpy as np
from fringes import Fringes

RUNS = 5


def main(folder: Path) -> None:
    """Do the next part of the job."""
    job = json.loads((folder / "job.json").read_text())
    program = Fringes()
    program.X, program.Y = job["width"], job["height"]
    program.axes = 1  # patterns that change along the columns
    program.v, program.N = job["frequencies"], job["shifts"]
    if not (folder / "frames.npy").exists():
        np.save(folder / "patterns.npy", np.asarray(program.encode())[..., 0])
        return
    frames = np.load(folder / "frames.npy")
    program.decode(frames)
    seconds = []
    for _ in range(RUNS):
        begin = time.perf_counter()
        _, modulation, column = program.decode(frames)
        seconds.append(time.perf_counter() - begin)
    finest = np.load(folder / "wrapped.npy")
    parameters = cv2.phase_unwrapping.HistogramPhaseUnwrapping.Params()
    parameters.height, parameters.width = finest.shape
    unwrapper = cv2.phase_unwrapping.HistogramPhaseUnwrapping.create(parameters)
    mask = np.where(np.isfinite(finest), 255, 0).astype(np.uint8)
    unwrapped = unwrapper.unwrapPhaseMap(np.nan_to_num(finest).astype(np.float32), shadowMask=mask)
    np.savez(
        folder / "decoded.npz",
        column=np.squeeze(column),
        modulation=np.squeeze(modulation),
        seconds=seconds,
        unwrapped=unwrapped,
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
