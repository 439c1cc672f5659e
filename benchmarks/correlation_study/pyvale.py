"""pyvale on the same images: writes the tasks to files, runs it in its own environment, reads the fields back."""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from correlation_study.estimators import RIVAL_STEP, Measured
from correlation_study.scenes import Task

sys.path.append(str(Path(__file__).resolve().parents[1] / "rivals"))
from environment import rival_python, run_in


@dataclass(frozen=True)
class Subset:
    """Shape function and width [px] of pyvale's subsets."""

    shape: str  # "AFFINE" or "QUAD"
    size: int

    def __str__(self) -> str:
        return f"pyvale {'affine' if self.shape == 'AFFINE' else 'quadratic'} {self.size}"


Job = tuple[Task, Subset]


def measure(jobs: list[Job], step: int = RIVAL_STEP) -> dict[tuple[str, Subset], Measured] | None:
    """Fields by the name of the task and the subset; None where pyvale cannot be installed or fails."""
    python = rival_python("pyvale")
    if python is None:
        return None
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files: dict[str, str] = {}
        described = []
        for k, (task, subset) in enumerate(jobs):
            if task.name not in files:
                files[task.name] = f"images-{len(files)}.npy"
                np.save(folder / files[task.name], task.images)
            described.append(
                {
                    "images": files[task.name],
                    "pairs": task.pairs,
                    "shape": subset.shape,
                    "size": subset.size,
                    "step": step,
                    "output": f"result-{k}.npz",
                }
            )
        (folder / "jobs.json").write_text(json.dumps(described))
        if not run_in(python, "measure_with_pyvale.py", folder):
            return None
        found = {}
        for k, (task, subset) in enumerate(jobs):
            with np.load(folder / f"result-{k}.npz") as result:
                found[task.name, subset] = Measured(
                    result["rows"], result["columns"], result["fields"], float(result["seconds"])
                )
        return found
