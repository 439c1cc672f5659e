"""Noise floor of a rig with its specimen at rest, from a recording or from images."""

from __future__ import annotations

import json
import math
import os
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import xarray as xr
import yaml

from fringedic.correlation import Reference, measure_displacement
from fringedic.errors import RigSetupError
from fringedic.metadata import NOISE_QUANTITIES, NoiseFloorMetadata
from fringedic.recording.frames import frames
from fringedic.recording.reader import BagReader
from fringedic.results import open_experiment
from fringedic.results.noise_floor import NoiseFloor, height_noise_floor, noise_floors
from fringedic.rig_setup.camera_noise import FEWEST_STEPS, EstimatedCameraNoise, estimate_camera_noise, thinned
from fringedic.rig_setup.recommended_settings import strain_noise

STRAIN_POINTS = 5  # of the strain window, where no rig defines one


@dataclass(frozen=True)
class NoiseMeasurement:
    """Noise of camera, displacement, height and strain from steps at rest.

    Attributes
    ----------
    camera
        Noise of the pixels.
    floors
        Noise of displacement, height and strain in the units of the dataset.
    metadata
        The same in the units of reports, as it is saved.
    """

    camera: EstimatedCameraNoise
    floors: tuple[NoiseFloor, ...]
    metadata: NoiseFloorMetadata

    def save(self, folder: str | os.PathLike[str]) -> Path:
        """Write ``noise_floor.yaml`` into a folder, which is created where it is missing, and return its path."""
        target = Path(folder)
        target.mkdir(parents=True, exist_ok=True)
        file = target / "noise_floor.yaml"
        content = yaml.safe_dump(self.metadata.model_dump(), sort_keys=False, allow_unicode=True)
        file.write_text(f"# Noise floor of the rig with the specimen at rest\n{content}", encoding="utf-8")
        return file


def noise_of_recording(path: str | os.PathLike[str]) -> NoiseMeasurement:
    """Return the noise floor of a recording of steps at rest; its first step is the reference.

    Parameters
    ----------
    path
        The recording, with its derived topics or its dataset.

    Raises
    ------
    RigSetupError
        It contains fewer than three measured steps.
    RecordingError
        The recording cannot be read.
    DatasetError
        Its dataset cannot be read.
    """
    with open_experiment(path) as dataset:
        measured = [
            int(step) for step, error in zip(dataset["step"].values, dataset["error"].values, strict=True) if not error
        ]
        if len(measured) < FEWEST_STEPS:
            raise RigSetupError(
                f"{path}: {len(measured)} steps were measured, a noise floor needs at least {FEWEST_STEPS}"
            )
        reference = int(dataset["reference_step"].sel(step=measured[-1]))
        static = [step for step in measured if step != reference]
        floors = noise_floors(dataset, static)
        height = height_noise_floor(dataset, measured)
        if height is not None:
            floors.append(height)
        camera = estimate_camera_noise(_frames_at_rest(Path(path), str(dataset.attrs["experiment"]), set(measured)))
        settings = _settings(dataset)
    return NoiseMeasurement(camera, tuple(floors), _metadata(camera, floors, len(measured), settings))


def noise_of_images(images: Sequence[np.ndarray], *, window: int, spacing: int) -> NoiseMeasurement:
    """Return the noise floor of camera and in-plane displacement from images at rest; the first is the reference.

    Parameters
    ----------
    images
        At least three grey images (row, column) of unsigned integers [grey level].
    window, spacing
        Width of the window and distance of the points [px], as of `fringedic.measure_displacement`.

    Raises
    ------
    RigSetupError
        There are fewer than three images, or every pixel is black or saturated.
    ImageError
        The images are invalid or differ in size.
    CorrelationError
        The images do not show the same surface.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy.ndimage import gaussian_filter
    >>> random = np.random.default_rng(1)
    >>> surface = 128 + 400 * gaussian_filter(random.normal(size=(120, 160)), 1.5)
    >>> images = [np.uint8(np.clip(surface + random.normal(0, 2, surface.shape), 0, 255)) for _ in range(4)]
    >>> measured = noise_of_images(images, window=32, spacing=8)
    >>> round(measured.metadata.read_noise_grey_level)
    2
    >>> [floor.name for floor in measured.floors]
    ['displacement_x', 'displacement_y', 'e_11', 'e_22', 'e_12']
    """
    camera = estimate_camera_noise([images])
    reference = Reference(images[0], window=window, spacing=spacing)
    fields = [measure_displacement(reference, image) for image in images[1:]]
    dataset = xr.concat(fields, dim=xr.DataArray(np.arange(1, len(images)), dims="step", name="step"))
    dataset = dataset.rename(sigma_x="displacement_sigma_x", sigma_y="displacement_sigma_y")
    floors = noise_floors(dataset, [int(step) for step in dataset["step"].values])
    points = dataset.sizes["row"] * dataset.sizes["column"]
    for name, spatial in zip(("e_11", "e_22", "e_12"), strain_noise(fields, spacing, STRAIN_POINTS), strict=True):
        floors.append(NoiseFloor(name, spatial, math.nan, math.nan, math.nan, points))
    settings = {
        "window_px": window,
        "spacing_px": spacing,
        "strain_window_px": (STRAIN_POINTS - 1) * spacing + 1,
    }
    return NoiseMeasurement(camera, tuple(floors), _metadata(camera, floors, len(images), settings))


def _frames_at_rest(path: Path, experiment: str, steps: set[int]) -> list[list[np.ndarray]]:
    """Return the thinned frames of each pattern of a sequence over the steps."""
    found: defaultdict[int, list[np.ndarray]] = defaultdict(list)
    for frame in frames(BagReader(path), experiment):
        if frame.record.step in steps:
            found[frame.record.index].append(thinned(frame.image).copy())
    return [found[index] for index in sorted(found)]


def _settings(dataset: xr.Dataset) -> dict[str, int]:
    """Return the windows and the spacing of displacement and strain."""
    recorded = json.loads(dataset.attrs.get("parameters", "[]"))
    nodes = recorded[-1]["parameters"] if recorded else {}
    wanted = {
        "window_px": ("dic", "window"),
        "spacing_px": ("dic", "spacing"),
        "strain_window_px": ("coupling", "strain_window_px"),
    }
    return {name: nodes[node][key] for name, (node, key) in wanted.items() if key in nodes.get(node, {})}


def _metadata(
    camera: EstimatedCameraNoise, floors: Sequence[NoiseFloor], steps: int, settings: dict[str, int]
) -> NoiseFloorMetadata:
    def of(attribute: str) -> dict[str, float]:
        kept = ((NOISE_QUANTITIES[floor.name], getattr(floor, attribute)) for floor in floors)
        values = {quantity.name: value / quantity.factor for quantity, value in kept}
        return {name: float(f"{value:.4g}") for name, value in values.items() if math.isfinite(value)}

    return NoiseFloorMetadata(
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        steps=steps,
        read_noise_grey_level=float(f"{camera.noise.read:.4g}"),
        shot_noise_grey_level=float(f"{camera.noise.shot:.4g}"),
        flicker_percent=float(f"{100 * camera.flicker:.3g}"),
        **settings,
        spatial=of("spatial"),
        temporal=of("temporal"),
        bias=of("bias"),
        predicted=of("predicted"),
    )
