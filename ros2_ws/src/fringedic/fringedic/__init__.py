"""Shape and 3D displacement of a surface with one camera and one fringe projector.

The public functions are listed here and loaded when they are first used: most nodes need only a few of them.
"""

from __future__ import annotations

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

os.environ.setdefault("NUMBA_THREADING_LAYER", "omp")
# Threads that wait by spinning take the processor from the other nodes: three times slower on a busy machine.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

__version__ = "0.1.0"

if TYPE_CHECKING:
    from fringedic.advice import Advice, advise_settings
    from fringedic.calibration import RigCalibration, RigCheck, calibrate_rig, check_rig
    from fringedic.camera.distortion import DistortionMap
    from fringedic.camera.grid import measure_distortion
    from fringedic.correlation import Reference, measure_displacement
    from fringedic.errors import FringedicError
    from fringedic.export import export_dataset
    from fringedic.increments import accumulate
    from fringedic.patterns import fringe_sequence, gray_code_sequence, one_image_sequence
    from fringedic.phase import absolute_phase, demodulate, unwrap_hierarchical, unwrap_spatial
    from fringedic.pictures import save_pictures
    from fringedic.probes import (
        Region,
        extensometer,
        force_curve,
        profile,
        region_statistics,
        remove_rigid_motion,
    )
    from fringedic.report import write_report
    from fringedic.response import ResponseCurve, measure_response
    from fringedic.results import compare_with_truth, open_experiment, process_bag
    from fringedic.rig import RigModel
    from fringedic.rig_file import load_programme, load_rig_file
    from fringedic.surface import (
        CylinderFrame,
        PreparedShape,
        SpecimenFrame,
        couple,
        surface_strain,
        to_local_frame,
    )

_HOMES = {
    "Advice": "advice",
    "CylinderFrame": "surface",
    "DistortionMap": "camera.distortion",
    "FringedicError": "errors",
    "PreparedShape": "surface",
    "Reference": "correlation",
    "Region": "probes",
    "ResponseCurve": "response",
    "RigCalibration": "calibration",
    "RigCheck": "calibration",
    "check_rig": "calibration",
    "RigModel": "rig",
    "SpecimenFrame": "surface",
    "absolute_phase": "phase",
    "accumulate": "increments",
    "advise_settings": "advice",
    "calibrate_rig": "calibration",
    "compare_with_truth": "results",
    "couple": "surface",
    "demodulate": "phase",
    "export_dataset": "export",
    "extensometer": "probes",
    "force_curve": "probes",
    "fringe_sequence": "patterns",
    "gray_code_sequence": "patterns",
    "load_programme": "rig_file",
    "load_rig_file": "rig_file",
    "measure_displacement": "correlation",
    "measure_distortion": "camera.grid",
    "measure_response": "response",
    "one_image_sequence": "patterns",
    "open_experiment": "results",
    "process_bag": "results",
    "profile": "probes",
    "region_statistics": "probes",
    "remove_rigid_motion": "probes",
    "save_pictures": "pictures",
    "surface_strain": "surface",
    "to_local_frame": "surface",
    "unwrap_hierarchical": "phase",
    "unwrap_spatial": "phase",
    "write_report": "report",
}

__all__ = [
    "Advice",
    "CylinderFrame",
    "DistortionMap",
    "FringedicError",
    "PreparedShape",
    "Reference",
    "Region",
    "ResponseCurve",
    "RigCalibration",
    "RigCheck",
    "RigModel",
    "SpecimenFrame",
    "absolute_phase",
    "accumulate",
    "advise_settings",
    "calibrate_rig",
    "check_rig",
    "compare_with_truth",
    "couple",
    "demodulate",
    "export_dataset",
    "extensometer",
    "force_curve",
    "fringe_sequence",
    "gray_code_sequence",
    "load_programme",
    "load_rig_file",
    "measure_displacement",
    "measure_distortion",
    "measure_response",
    "one_image_sequence",
    "open_experiment",
    "process_bag",
    "profile",
    "region_statistics",
    "remove_rigid_motion",
    "save_pictures",
    "surface_strain",
    "to_local_frame",
    "unwrap_hierarchical",
    "unwrap_spatial",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'fringedic' has no attribute '{name}'")
    return getattr(import_module(f"fringedic.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
