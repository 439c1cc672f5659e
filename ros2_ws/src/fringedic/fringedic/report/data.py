"""The data of an experiment's report."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import xarray as xr

from fringedic.datasets.attributes import image_size, recorded_metadata
from fringedic.metadata import Metadata
from fringedic.report.recorded_exposures import Exposures
from fringedic.rig_setup.advice import Advice


@dataclass(frozen=True)
class ReportData:
    """Everything that a report is written from.

    Attributes
    ----------
    dataset
        The experiment, from `fringedic.open_experiment`.
    exposures
        From the recording, None without one.
    advice
        Figures of the texture from images at rest, None without them.
    """

    dataset: xr.Dataset
    exposures: Exposures | None
    advice: Advice | None

    def attribute(self, name: str) -> Any:
        """Return an attribute of the dataset, unpacked from JSON; an empty dict if it is missing."""
        return json.loads(self.dataset.attrs.get(name, "{}"))

    @cached_property
    def metadata(self) -> Metadata:
        """Specimen, hardware, calibration and noise floor as entered and recorded."""
        return recorded_metadata(self.dataset)

    @cached_property
    def calibration(self) -> dict[str, Any]:
        """Parameters of the rig's model in SI units; empty without a calibration."""
        return dict(self.attribute("calibration"))

    @cached_property
    def parameters(self) -> dict[str, dict[str, Any]]:
        """Parameters of the processing nodes at the last step, by node."""
        recorded = self.attribute("parameters")
        return dict(recorded[-1]["parameters"]) if recorded else {}

    @cached_property
    def camera(self) -> dict[str, Any]:
        """Parameters of the camera node."""
        return dict(self.attribute("rig").get("camera", {}))

    @property
    def section(self) -> float | None:
        """Area that carries the force [m²], None if it is not known."""
        square_millimetres = self.metadata.specimen.section_mm2
        return None if square_millimetres is None else 1e-6 * square_millimetres

    @property
    def images_alone(self) -> bool:
        """Whether the dataset is that of a series of images without a rig."""
        return "image" in self.dataset

    @property
    def image_size(self) -> tuple[int, int] | None:
        """Width and height of the camera's images [px], None if they are not known."""
        return image_size(self.dataset)

    @property
    def pixel_size(self) -> float | None:
        """Size of a pixel on the specimen [m], None without a scale."""
        size = self.calibration.get("pixel_size", self.dataset.attrs.get("pixel_size"))
        return None if size is None else float(size)

    @property
    def simulated(self) -> bool:
        """Whether a virtual rig replaced camera and projector."""
        return self.camera.get("source") == "virtual"

    def length(self, pixels: float) -> str:
        """Return a length on the surface in brackets, for a text that follows pixels; empty without a scale."""
        return "" if self.pixel_size is None else f" ({1e3 * self.pixel_size * pixels:.3g} mm)"
