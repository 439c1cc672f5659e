"""Measures pairs of images with pyvale; runs in the environment of pyvale alone.

    python measure_with_pyvale.py FOLDER

FOLDER holds jobs.json, a list of {"images": file.npy, "pairs": [[i, j], ...], "shape": "AFFINE" or "QUAD", "size": px,
"step": px, "output": file.npz}. Everything else stays as pyvale recommends by its defaults: ZNSSD criterion, B-spline
interpolation, Gaussian prefilter of 1 px, multi-window start.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import tempfile
import time
from itertools import groupby
from pathlib import Path

import numpy as np
from pyvale import dic


def measure(images: np.ndarray, pairs: list[list[int]], shape: str, size: int, step: int) -> dict[str, np.ndarray]:
    """Fields (pair, component, row, column) on the grid of subsets, and the seconds they took."""
    height, width = images.shape[1:]
    # half a subset, the prefilter and the spline stay inside the image
    inside = np.zeros((height, width), bool)
    inside[4:-4, 4:-4] = True
    fields, seconds = [], 0.0
    for first, group in groupby(pairs, key=lambda pair: pair[0]):
        deformed = np.ascontiguousarray(images[[second for _, second in group]])
        with tempfile.TemporaryDirectory() as folder:
            begin = time.perf_counter()
            dic.calculate_2d(
                reference=np.ascontiguousarray(images[first]),
                deformed=deformed,
                roi_mask=inside,
                seed=[width // 2, height // 2],
                subset_size=size,
                subset_step=min(step, size),  # pyvale allows no larger one
                shape_function=shape,
                max_displacement=16,
                output_basepath=folder,
                print_level=0,
            )
            seconds += time.perf_counter() - begin
            found = dic.import_2d(
                sorted(Path(folder).glob("dic_results_*.csv")), layout="matrix", delimiter=",", print_level=0
            )
        fields.append(np.stack([found.u_px, found.v_px], axis=1))
        rows, columns = found.ss_y[:, 0], found.ss_x[0]
    return {"rows": rows, "columns": columns, "fields": np.concatenate(fields), "seconds": np.array(seconds)}


def main(folder: Path) -> None:
    """Do the jobs of a folder."""
    for job in json.loads((folder / "jobs.json").read_text()):
        images = np.load(folder / job["images"], mmap_mode="r")
        with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
            result = measure(images, job["pairs"], job["shape"], job["size"], job["step"])
        np.savez(folder / job["output"], **result)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
