"""The data summary of a campaign: ``data-summary.json`` in the form of the data-storage guide of UKAEA.

References
----------
UKAEA Applied Materials Technology, Data storage guide: a campaign consists of general data, samples, diagnostics and
experiments, https://applied-materials-technology.github.io/data-storage-guide.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from fringedic.campaign.opening import open_group
from fringedic.campaign.receipts import Receipt
from fringedic.campaign.run import Status
from fringedic.campaign.store import RECEIPTS, RECORDINGS, CampaignStore
from fringedic.datasets.attributes import origin_of, recorded_metadata

FILE = "data-summary.json"
_AXES = {"X": "to the right of the image", "Y": "upwards in the image", "Z": "towards the camera"}
_COORDINATES = {
    "Type": "Cartesian, right-handed",
    "Perspective": "view of the camera",
    "Origin": "point of the reference plane (z = 0) below the pin-hole of the camera",
    "Orientation": _AXES,
    "Note": "SI units; displacements and strains belong to points of the reference configuration",
}


def data_summary(store: CampaignStore, status: Status) -> dict[str, Any]:
    """Return the content of ``data-summary.json``: the keys of the guide, empty where nothing was recorded.

    Parameters
    ----------
    store, status
        Of the campaign.

    Raises
    ------
    CampaignError
        The store cannot be read.
    """
    datasets = {name: open_group(store, name) for name in status.done}
    entries = {name: _Recorded(status.done[name], dataset) for name, dataset in datasets.items()}
    paths = {unit.name: unit.path for unit in status.plan.units}
    return {
        "Campaign": {
            "GeneralData": {
                "Title": status.plan.title,
                "Authors": _distinct(each.specimen.operator for each in entries.values()),
                "DatesGenerated": _distinct(each.date for each in entries.values()),
                "Rig": ", ".join(_distinct(each.rig for each in entries.values())),
                "Software": status.plan.units[0].software if status.plan.units else {},
                "Settings": {unit.name: unit.processing for unit in status.plan.units},
            },
            "Samples": {
                "Description": ", ".join(_distinct(each.receipt.labels["group"] for each in entries.values())),
                "Identifiers": _distinct(each.sample for each in entries.values()),
                "CoordinateSystem": _COORDINATES,
                "Geometry": {
                    name: {"Section_mm2": each.specimen.section_mm2, **each.specimen.entries}
                    for name, each in entries.items()
                },
                "Materials": {name: each.material for name, each in entries.items()},
            },
            "Diagnostics": {
                "DigitalImageCorrelation (DIC)": {name: each.diagnostic() for name, each in entries.items()}
            },
            "CampaignDescription": {name: each.experiment(paths[name]) for name, each in entries.items()},
        }
    }


class _Recorded:
    """A complete recording with its metadata."""

    def __init__(self, receipt: Receipt, dataset: xr.Dataset) -> None:
        self.receipt = receipt
        self.origin: Mapping[str, Any] = origin_of(dataset)
        self.rig = str(self.origin.get("calibration", {}).get("identifier", ""))
        self._metadata = recorded_metadata(dataset)
        self.specimen = self._metadata.specimen
        self.sample = receipt.labels["specimen"] or self.specimen.name or receipt.name
        self.material = receipt.labels["material"] or self.specimen.material
        self.date = str(np.datetime_as_string(dataset["time"].values.min(), unit="D"))

    def diagnostic(self) -> dict[str, Any]:
        """Return the entry of the measuring system."""
        hardware, floor = self._metadata.hardware, self.receipt.figures
        calibration = self.origin.get("calibration", {})
        shape = [calibration.get(f"camera_{side}") for side in ("width", "height")]
        return {
            "Config.": "fringe projection and digital image correlation, one camera and one projector",
            "CameraMake/Model": hardware.camera,
            "CameraResolution": "x".join(map(str, shape)) if all(shape) else "",
            "FieldOfView (FOV)": "",
            "ImageScale": calibration.get("pixel_size", ""),
            "StereoAngle": "",
            "Stand-offDistance": calibration.get("camera_distance", ""),
            "ImageAcquisitionRate": "",
            "ImageNoise": self._metadata.noise.read_noise_grey_level,
            "DisplacementNoise": {name: floor[f"noise_{name}"] for name in ("u", "v", "w")},
            "SpecimenSurface": "",
            "Software&Version": self.origin["software"],
            "PatternTechnique": self.specimen.pattern,
            "PatternBackground": "",
            "PatternSpeckle": "",
            "ApproxFeatureSize": "",
            "LensMake/Model": hardware.lens,
            "LensFocalLength": hardware.focal_length_mm,
            "LensAperture": hardware.aperture,
            "Cal.TargetMake": hardware.calibration_target,
            "Cal.TargetDims": "",
            "Projector": hardware.projector,
        }

    def experiment(self, path: str) -> dict[str, Any]:
        """Return the entry of the test."""
        name = self.receipt.name
        return {
            "Date": self.date,
            "Sample": self.sample,
            "Diagnostics": [name],
            "Description": self.specimen.notes or self.origin["experiment"],
            "DiagnosticParameters": self.origin["parameters"],
            "ConstantTestParameters": {},
            "VariedTestParameters": {"Steps": self.receipt.figures["steps"], "Test": self.receipt.labels["test"]},
            "Files": {"Recording": path, "RecordingChecksums": self.receipt.fingerprint},
            "Directories": {
                "Checks": {},
                "StaticReferenceImages": {},
                "Tests": {"Results": f"{RECORDINGS}/{name}", "Receipt": f"{RECEIPTS}/{name}.json"},
            },
        }


def _distinct(values: Any) -> list[str]:
    return sorted({value for value in values if value})
