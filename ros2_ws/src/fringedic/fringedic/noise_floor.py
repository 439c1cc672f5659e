"""The noise floor of a rig with its specimen mounted, from steps or images at rest.

The camera's noise over its brightness, var = read^2 + shot * level, from what every pixel does over the steps in the
same light; the noise of displacement, height and strain from their maps, over the points and over the steps. Kept as
YAML, named in a rig file (``noise_floor_file``), and carried by every later recording of the rig in its facts.
"""

from __future__ import annotations

import json
import math
import os
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
import yaml
from scipy.optimize import nnls

from fringedic.advice import strain_noise
from fringedic.correlation import Reference, measure_displacement
from fringedic.errors import NoiseFloorError
from fringedic.facts import NOISE_COLUMNS, NOISE_QUANTITIES, NoiseFacts
from fringedic.image_quality import full_scale_of
from fringedic.phase import CameraNoise
from fringedic.recording import BagReader
from fringedic.report.static import NoiseFloor, noise_floors
from fringedic.results import open_experiment
from fringedic.results.messages import image_array
from fringedic.sequence import frame_record, stamp_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FEWEST = 3
SAMPLED = 100_000  # pixels of each frame that the camera's noise is taken from
CLASSES = 24  # of brightness
STRAIN_POINTS = 5  # of the strain window, without a rig
CLEAR = 4  # standard deviations that a pixel has to keep from either end of the scale


@dataclass(frozen=True)
class StaticCamera:
    """Noise of the camera's pixels, from frames of a scene at rest.

    Attributes
    ----------
    noise
        The model ``var = read^2 + shot * level``, rounding to grey levels included.
    level, variance
        Means over the pixels of each class of brightness [grey level, grey level^2].
    flicker
        Standard deviation of the light from step to step over its mean; it is no part of the noise.
    """

    noise: CameraNoise
    level: np.ndarray
    variance: np.ndarray
    flicker: float


@dataclass(frozen=True)
class NoiseMeasurement:
    """Everything that steps at rest tell.

    Attributes
    ----------
    camera
        Noise of the pixels.
    floors
        Of displacement, height and strain, in the units of the dataset.
    facts
        The same in people's units, as it is kept.
    """

    camera: StaticCamera
    floors: tuple[NoiseFloor, ...]
    facts: NoiseFacts

    def save(self, folder: str | os.PathLike[str]) -> tuple[Path, Path]:
        """Write ``noise_floor.yaml`` and ``noise_floor.png`` into a folder, and return both."""
        target = Path(folder)
        target.mkdir(parents=True, exist_ok=True)
        file, picture = target / "noise_floor.yaml", target / "noise_floor.png"
        content = yaml.safe_dump(self.facts.model_dump(), sort_keys=False, allow_unicode=True)
        file.write_text(f"# Noise floor of the rig with the specimen at rest\n{content}", encoding="utf-8")
        noise_figure(self).savefig(picture)
        return file, picture


def static_camera(frames: Sequence[Sequence[np.ndarray]], *, full_scale: float | None = None) -> StaticCamera:
    """Return the camera's noise from frames at rest.

    Parameters
    ----------
    frames
        ``frames[k]``: images (row, column) of unsigned integers [grey level] in the same light, one per step; at least
        three steps. Each is scaled to their common mean first, so that flicker is told apart from noise.
    full_scale
        Grey level of a saturated pixel; by default that of the fewest usual bits that hold all.

    Raises
    ------
    NoiseFloorError
        Fewer than three steps, or no pixel that is neither black nor saturated.
    """
    if not frames or min(len(each) for each in frames) < FEWEST:
        raise NoiseFloorError(f"a noise floor needs at least {FEWEST} steps at rest")
    if full_scale is None:
        full_scale = full_scale_of([image for each in frames for image in each])
    levels, variances, flickers = [], [], []
    for each in frames:
        every = math.ceil(math.sqrt(each[0].size / SAMPLED))
        sample = np.stack([image[::every, ::every] for image in each]).reshape(len(each), -1)
        clipped = (sample == 0).any(axis=0) | (sample >= full_scale).any(axis=0)
        grey = sample[:, ~clipped].astype(np.float64)
        if grey.shape[1] == 0:
            continue
        brightness = grey.mean(axis=1)
        flickers.append(brightness.std(ddof=1) / brightness.mean())
        grey *= (brightness.mean() / brightness)[:, None]
        levels.append(grey.mean(axis=0))
        variances.append(grey.var(axis=0, ddof=1))
    if not levels:
        raise NoiseFloorError("every pixel is black or saturated: set the exposure first (`fringedic live`)")
    level, variance = np.concatenate(levels), np.concatenate(variances)
    typical = math.sqrt(float(np.median(variance)))
    inner = (level > CLEAR * typical) & (level < full_scale - CLEAR * typical)
    if inner.any():
        level, variance = level[inner], variance[inner]
    classes = np.array_split(np.argsort(level, kind="stable"), min(CLASSES, level.size))
    mean_level = np.array([level[each].mean() for each in classes])
    mean_variance = np.array([variance[each].mean() for each in classes])
    # the spread of a class's variance grows with the variance itself
    weight = 1 / np.maximum(mean_variance, 1e-12)
    basis = np.stack([np.ones_like(mean_level), mean_level], axis=1) * weight[:, None]
    read_variance, shot = nnls(basis, mean_variance * weight)[0]
    noise = CameraNoise(math.sqrt(read_variance), float(shot))
    return StaticCamera(noise, mean_level, mean_variance, float(np.mean(flickers)))


def noise_of_recording(path: str | os.PathLike[str]) -> NoiseMeasurement:
    """Return the noise floor that a recording of steps at rest holds; its first step is the reference.

    Parameters
    ----------
    path
        The recording, with its derived topics or its dataset.

    Raises
    ------
    NoiseFloorError
        It holds fewer than three measured steps.
    RecordingError, DatasetError
        It cannot be read.
    """
    with open_experiment(path) as dataset:
        measured = [
            int(step) for step, error in zip(dataset["step"].values, dataset["error"].values, strict=True) if not error
        ]
        if len(measured) < FEWEST:
            raise NoiseFloorError(f"{path}: {len(measured)} steps were measured, a noise floor needs at least {FEWEST}")
        reference = int(dataset["reference_step"].sel(step=measured[-1]))
        static = [step for step in measured if step != reference]
        floors = noise_floors(dataset, static)
        if "shape_z" in dataset and np.isfinite(dataset["shape_z"].sel(step=static[-1]).values).any():
            floors.append(_height_floor(dataset, measured))
        camera = static_camera(_frames_at_rest(Path(path), str(dataset.attrs["experiment"]), set(measured)))
        settings = _settings(dataset)
    return NoiseMeasurement(camera, tuple(floors), _facts(camera, floors, len(measured), settings))


def noise_of_images(images: Sequence[np.ndarray], *, window: int, spacing: int) -> NoiseMeasurement:
    """Return the noise floor of camera and in-plane displacement from images at rest; the first is the reference.

    Parameters
    ----------
    images
        At least three grey images (row, column) of unsigned integers.
    window, spacing
        Of `fringedic.measure_displacement` [px].

    Raises
    ------
    NoiseFloorError
        Fewer than three images.
    NoCorrelationError, ShapeMismatchError, WindowError
        The images do not show the same surface, see `measure_displacement`.
    """
    camera = static_camera([images])
    reference = Reference(images[0], window=window, spacing=spacing)
    fields = [measure_displacement(reference, image) for image in images[1:]]
    dataset = xr.concat(fields, dim=xr.DataArray(np.arange(1, len(images)), dims="step", name="step"))
    dataset = dataset.rename(sigma_x="displacement_sigma_x", sigma_y="displacement_sigma_y")
    floors = noise_floors(dataset, [int(step) for step in dataset["step"].values])
    maps = np.stack([dataset["displacement_x"].values, dataset["displacement_y"].values], axis=1).astype(np.float64)
    for name, spatial in zip(("e_11", "e_22", "e_12"), strain_noise(maps, spacing, STRAIN_POINTS), strict=True):
        floors.append(NoiseFloor(name, spatial, math.nan, math.nan, math.nan, maps[0, 0].size))
    settings = {
        "window_px": window,
        "spacing_px": spacing,
        "strain_window_px": (STRAIN_POINTS - 1) * spacing + 1,
    }
    return NoiseMeasurement(camera, tuple(floors), _facts(camera, floors, len(images), settings))


def noise_figure(measured: NoiseMeasurement) -> Figure:
    """Draw the camera's noise over its brightness with the model, and the noise floors as a table."""
    from matplotlib.figure import Figure

    camera, facts = measured.camera, measured.facts
    figure = Figure(figsize=(12.5, 5.0), dpi=100, layout="constrained")
    figure.suptitle(f"Noise floor, {facts.steps} steps at rest, {facts.created}")
    axes, table = figure.subplots(1, 2)
    axes.plot(camera.level, np.sqrt(camera.variance), "o", label="measured")
    level = np.linspace(0, camera.level[-1], 200)
    words = f"read {camera.noise.read:.2f}, shot {camera.noise.shot:.4f} per grey level"
    axes.plot(level, np.sqrt(camera.noise.variance(level)), label=words)
    axes.set(xlabel="brightness [grey level]", ylabel="noise of a pixel [grey level]", ylim=(0, None))
    axes.set_title(f"Camera; the light flickers by {100 * camera.flicker:.2g} %")
    axes.legend()
    rows = [[f"{quantity.title} [{quantity.unit}]", *cells] for quantity, cells in facts.table()]
    table.axis("off")
    table.set_title("Displacement, height and strain: standard deviations")
    drawn = table.table(
        rows, colLabels=["", *NOISE_COLUMNS], loc="upper center", colWidths=[0.42, *[0.145] * len(NOISE_COLUMNS)]
    )
    drawn.auto_set_font_size(False)
    drawn.set_fontsize(10)
    drawn.scale(1, 1.7)
    return figure


def _frames_at_rest(path: Path, experiment: str, steps: set[int]) -> list[list[np.ndarray]]:
    """Return the frames of each light over the steps, thinned as `static_camera` would."""
    reader = BagReader(path)
    names = reader.find("camera/image_raw", "camera/exposure")
    images: dict[int, np.ndarray] = {}
    records = {}
    found: defaultdict[int, list[np.ndarray]] = defaultdict(list)
    for topic, message, _ in reader.messages(names.values()):
        stamp = stamp_of(message)
        if topic == names["camera/image_raw"]:
            image = image_array(message)
            every = math.ceil(math.sqrt(image.size / SAMPLED))
            images[stamp] = image[::every, ::every].copy()
        else:
            records[stamp] = frame_record(message)
        if stamp in images and stamp in records:
            image, record = images.pop(stamp), records.pop(stamp)
            if record.experiment == experiment and record.step in steps:
                found[record.index].append(image)
    return [found[index] for index in sorted(found)]


def _height_floor(dataset: xr.Dataset, steps: Sequence[int]) -> NoiseFloor:
    """Return the noise of the height itself, over the steps; over the points the surface is not flat."""
    maps = dataset["shape_z"].sel(step=list(steps)).values.astype(np.float64)
    common = np.isfinite(maps).all(axis=0)
    values = maps[:, common]
    sigma = np.array([])
    if "shape_sigma_z" in dataset:
        sigma = dataset["shape_sigma_z"].sel(step=list(steps)).values[:, common].astype(np.float64)
    return NoiseFloor(
        name="shape_z",
        spatial=math.nan,
        temporal=float(np.sqrt(values.var(axis=0, ddof=1).mean())),
        bias=math.nan,
        predicted=float(np.sqrt(np.mean(sigma**2))) if sigma.size else math.nan,
        points=int(common.sum()),
    )


def _settings(dataset: xr.Dataset) -> dict[str, int]:
    """Return the widths that displacement and strain were measured with."""
    recorded = json.loads(dataset.attrs.get("parameters", "[]"))
    nodes = recorded[-1]["parameters"] if recorded else {}
    wanted = {
        "window_px": ("dic", "window"),
        "spacing_px": ("dic", "spacing"),
        "strain_window_px": ("coupling", "strain_window_px"),
    }
    return {name: nodes[node][key] for name, (node, key) in wanted.items() if key in nodes.get(node, {})}


def _facts(camera: StaticCamera, floors: Sequence[NoiseFloor], steps: int, settings: dict[str, int]) -> NoiseFacts:
    def of(attribute: str) -> dict[str, float]:
        kept = ((NOISE_QUANTITIES[floor.name], getattr(floor, attribute)) for floor in floors)
        values = {quantity.name: value / quantity.factor for quantity, value in kept}
        return {name: float(f"{value:.4g}") for name, value in values.items() if math.isfinite(value)}

    return NoiseFacts(
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
