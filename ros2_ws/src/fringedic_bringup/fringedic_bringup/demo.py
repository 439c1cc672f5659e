"""Virtual experiments from end to end: run on the real nodes, compared with the truth, drawn."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import xarray as xr

import fringedic
from fringedic.errors import RigFileError
from fringedic.pictures import save_pictures
from fringedic.results import compare_with_truth, dataset_from_derived, open_truth
from fringedic.rig_file import load_rig_file
from fringedic_bringup.run import ExperimentRun, Progress, run_programme

SPECIMENS = ("plate", "skin", "leather")


@dataclass(frozen=True)
class DemoResult:
    """One virtual experiment beside its truth.

    Attributes
    ----------
    specimen
        Which one.
    run
        What the nodes answered.
    errors
        See `fringedic.results.compare_with_truth`.
    folder
        Where bag, pictures and dataset are.
    """

    specimen: str
    run: ExperimentRun
    errors: xr.Dataset
    folder: Path


def run_demo(
    rig_file: Path, output: Path, *, domain: int, progress: Callable[[Progress], None], say: Callable[[str], None]
) -> DemoResult:
    """Run the programme of a virtual rig's file and compare each step with the truth.

    Parameters
    ----------
    rig_file
        A rig with the sections ``virtual_rig`` and ``programme``.
    output
        Folder of this experiment; what an earlier demo left there is replaced.
    domain
        ROS_DOMAIN_ID.
    progress, say
        Called with the progress of the steps, and with what follows them.
    """
    rig = load_rig_file(rig_file)
    if rig.programme is None:
        raise RigFileError(f"{rig_file}: a demo needs the section programme")
    shutil.rmtree(output, ignore_errors=True)
    run = run_programme(rig_file, rig.programme, output, domain=domain, progress=progress)
    say("dataset")
    dataset_file = dataset_from_derived(run.bag, output=output / "results.nc")
    with fringedic.open_experiment(dataset_file) as dataset:
        say("comparison with the truth")
        errors = compare_with_truth(dataset, output / "truth.nc").load()
        say("pictures")
        with open_truth(output / "truth.nc") as truth:
            save_pictures(dataset, output / "pictures", truth=truth)
    return DemoResult(rig_file.stem, run, errors, output)
