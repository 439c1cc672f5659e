"""Noise floor of a rig with its specimen at rest, from a recording or from images."""

from __future__ import annotations

import json
import math
import os
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import xarray as xr
import yaml

from fringedic.correlation import Reference, measure_displacement
from fringedic.correlation.limit import displacement_limit
from fringedic.datasets import open_experiment
from fringedic.errors import RigSetupError
from fringedic.evaluation.noise_floor import NoiseFloor, noise_floors, single_step_noise_floors
from fringedic.frames.noise import CameraNoise
from fringedic.metadata import NOISE_QUANTITIES, NoiseFloorMetadata
from fringedic.patterns.pattern import PatternKind
from fringedic.phase.limit import phase_limit
from fringedic.recording.frames import RecordedFrame, frames
from fringedic.recording.reader import BagReader
from fringedic.rig_setup.camera_noise import FEWEST_STEPS, EstimatedCameraNoise, estimate_camera_noise, thinned
from fringedic.rig_setup.recommended_settings import strain_noise
from fringedic.wording.sealed_yaml import sealed

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
        content = yaml.safe_dump(sealed(self.metadata.model_dump()), sort_keys=False, allow_unicode=True)
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
        reference_of = dataset["reference_step"].sel(step=measured).values
        measured = [step for step, each in zip(measured, reference_of, strict=True) if each == reference_of[-1]]
        if len(measured) < FEWEST_STEPS:
            raise RigSetupError(
                f"{path}: {len(measured)} steps were measured against one reference, a noise floor needs at least "
                f"{FEWEST_STEPS}"
            )
        reference = int(reference_of[-1])
        static = [step for step in measured if step != reference]
        experiment = str(dataset.attrs["experiment"])
        steps = set(measured)
        found: defaultdict[int, list[np.ndarray]] = defaultdict(list)
        recorded = _RecordedAtRest()
        for frame in frames(BagReader(Path(path)), experiment):
            record = frame.record
            if record.step not in steps:
                continue
            found[record.index].append(thinned(frame.image).copy())
            if record.step == reference:
                recorded.add(frame)
        recorded.thinned = [found[index] for index in sorted(found)]
        camera = estimate_camera_noise(recorded.thinned)
        settings = _settings(dataset)
        limits = recorded.displacement_limits(camera.noise, settings)
        limits |= recorded.phase_limits(camera.noise, dataset.sel(step=reference))
        floors = noise_floors(dataset, static) + single_step_noise_floors(dataset, measured)
        floors = [replace(floor, limit=limits.get(floor.name, math.nan)) for floor in floors]
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
    limits = _displacement_limits(images[0].astype(float), camera.noise.variance(images[0]), window)
    floors = [
        replace(floor, limit=limits[floor.name])
        for floor in noise_floors(dataset, [int(step) for step in dataset["step"].values])
    ]
    points = dataset.sizes["row"] * dataset.sizes["column"]
    for name, spatial in zip(("e_11", "e_22", "e_12"), strain_noise(fields, spacing, STRAIN_POINTS), strict=True):
        floors.append(NoiseFloor(name, spatial, math.nan, math.nan, math.nan, points))
    settings = {
        "window_px": window,
        "spacing_px": spacing,
        "strain_window_px": (STRAIN_POINTS - 1) * spacing + 1,
    }
    return NoiseMeasurement(camera, tuple(floors), _metadata(camera, floors, len(images), settings))


@dataclass
class _RecordedAtRest:
    """What the noise is compared with: thinned frames of each pattern over the steps, and the texture of one step.

    ``texture`` is the mean of the fringe frames of the reference step, as of the phase, or its white frame;
    ``averaged`` is their number, and ``shifts`` that of the finest fringes (0 in white light).
    """

    thinned: list[list[np.ndarray]] = field(default_factory=list)
    texture: np.ndarray | None = None
    averaged: int = 0
    shifts: int = 0

    def add(self, frame: RecordedFrame) -> None:
        """Take the next frame of the reference step."""
        pattern, image = frame.record.pattern, frame.image.astype(float)
        if pattern.kind == PatternKind.FRINGES:
            before, count = (self.texture, self.averaged) if self.shifts and self.texture is not None else (0.0, 0)
            self.texture = (count * before + image) / (count + 1)
            self.averaged, self.shifts = count + 1, pattern.shifts
        elif pattern.kind == PatternKind.WHITE and not self.shifts:
            self.texture, self.averaged = image, 1

    def displacement_limits(self, noise: CameraNoise, settings: dict[str, int]) -> dict[str, float]:
        """Return the Cramer-Rao bounds of the displacement, RMS over the image [px]."""
        if self.texture is None or "window_px" not in settings:
            return {}
        variance = noise.variance(self.texture) / self.averaged
        return _displacement_limits(self.texture, variance, settings["window_px"])

    def phase_limits(self, noise: CameraNoise, step: xr.Dataset) -> dict[str, float]:
        """Return the Cramer-Rao bound of the phase, RMS over the points where it is measured [rad]."""
        if not self.shifts:
            return {}
        texture, modulation, phase = (step[name].values.astype(float) for name in ("texture", "modulation", "phase"))
        return {"phase": _rms(phase_limit(texture, modulation, phase, self.shifts, noise))}


def _displacement_limits(texture: np.ndarray, variance: np.ndarray, window: int) -> dict[str, float]:
    # a window at the border is cut off
    inside = displacement_limit(texture, variance, window)[:, window // 2 : -window // 2, window // 2 : -window // 2]
    return dict(zip(("displacement_x", "displacement_y"), map(_rms, inside), strict=True))


def _rms(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return math.sqrt(np.mean(known**2)) if known.size else math.nan


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
        limit=of("limit"),
    )
