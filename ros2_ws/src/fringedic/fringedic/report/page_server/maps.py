"""Maps of the steps of an experiment, from its dataset or from the messages of a running test."""

from __future__ import annotations

import functools
import json
import math
import shutil
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import xarray as xr

from fringedic.datasets import open_experiment
from fringedic.datasets.quantities import ALL_MAPS, MAPS, people_unit, resolution_of, sigma_of
from fringedic.errors import DatasetError
from fringedic.evaluation import extensometer, profile
from fringedic.frames.region import Point
from fringedic.wording.translation import Sentence, translatable

MOST_VALUES = 1_000_000  # of a tile
MOST_POINTS = 60_000  # of a cloud in the browser
MOST_BYTES = 2_000_000_000  # of the maps of a running test
_POSITION, _DISPLACEMENT = ("x", "y", "z"), ("u", "v", "w")
_IN_PLANE = ("displacement_x", "displacement_y", "displacement_sigma_x", "displacement_sigma_y")
_SIGMAS = ("sigma_u", "sigma_v", "sigma_w")


class StepMaps(Protocol):
    """The maps of an experiment, step by step."""

    def names(self) -> dict[int, list[str]]:
        """Return the names of the measured maps of each step."""

    def dataset(self, step: int, names: Sequence[str]) -> xr.Dataset:
        """Return maps of one step over (row, column).

        Raises
        ------
        DatasetError
            The step has no such map.
        """


class RecordedMaps:
    """The maps of a recorded experiment.

    Parameters
    ----------
    path, sensor
        As of `fringedic.open_experiment`.
    """

    def __init__(self, path: Path, sensor: str | None = None) -> None:
        self.experiment = open_experiment(path, sensor=sensor)
        self._lock = threading.Lock()  # the file is read by one thread at a time
        with self._lock:
            self._names = {int(step): self._measured(int(step)) for step in self.experiment.step.values}

    def names(self) -> dict[int, list[str]]:
        """Return the names of the measured maps of each step."""
        return self._names

    def dataset(self, step: int, names: Sequence[str]) -> xr.Dataset:
        """Return maps of one step."""
        _require(self._names, step, names)
        with self._lock:
            return self.experiment[list(names)].sel(step=step).load()

    def _measured(self, step: int) -> list[str]:
        """Return the maps with a value; each is read once, as a whole, because its checksum covers it."""
        if self.experiment.error.sel(step=step).item():
            return []
        one = self.experiment.sel(step=step)
        return [name for name in ALL_MAPS if name in one and np.isfinite(one[name].values).any()]


class SpooledMaps:
    """The maps of a running test in a folder, of which the oldest are removed when they become too many.

    Parameters
    ----------
    folder
        Created when it does not exist; the maps in it are those of a server that was ended.
    most_bytes
        Largest size of all maps.
    """

    def __init__(self, folder: Path, most_bytes: int = MOST_BYTES) -> None:
        self._folder, self._most = folder, most_bytes
        folder.mkdir(parents=True, exist_ok=True)
        # kept, because the page asks for them several times a second, and a step has some 40 files
        self._names = {int(place.name): _names_in(place) for place in sorted(folder.iterdir())}
        self._attributes: dict[Any, Any] = {}  # of the dataset, as soon as there is one

    def clear(self) -> None:
        """Remove all maps: another experiment begins."""
        self._names, self._attributes = {}, {}
        shutil.rmtree(self._folder, ignore_errors=True)
        self._folder.mkdir(parents=True, exist_ok=True)

    def put(self, step: int, maps: Mapping[str, np.ndarray], spacing: int) -> None:
        """Keep maps of a step; those at every pixel are sampled at the spacing of the points [px]."""
        place = self._folder / f"{step:06d}"
        place.mkdir(exist_ok=True)
        (place / "spacing.json").write_text(json.dumps(spacing))
        smallest = min(values.shape for values in maps.values())
        kept = [name for name in maps if name in MAPS]
        for name in kept:
            sampled = maps[name] if maps[name].shape == smallest else maps[name][::spacing, ::spacing]
            np.save(place / f".{name}.npy", np.ascontiguousarray(sampled, np.float32))
        for name in kept:  # all together when they are complete, because a browser may ask for them meanwhile
            (place / f".{name}.npy").rename(place / f"{name}.npy")
        places = sorted(self._folder.iterdir())
        sizes = [sum(file.stat().st_size for file in place.iterdir()) for place in places]
        forgotten = set()
        while sum(sizes) > self._most and len(places) > 1:
            forgotten.add(int(places[0].name))
            shutil.rmtree(places.pop(0))
            sizes.pop(0)
        names = {**self._names, step: _names_in(place)}
        self._names = {each: names[each] for each in sorted(names) if each not in forgotten}  # at once, for all threads

    def complete(self, recorded: StepMaps) -> None:
        """Take over what a recording states of its maps, and the maps that no server heard, or heard in part."""
        known = self.names()
        for step, names in recorded.names().items():
            if names and not self._attributes:
                self._attributes = dict(recorded.dataset(step, names[:1]).attrs)
            if set(names) & {"displacement_x", "u"} - set(known.get(step, ())):
                found = recorded.dataset(step, names)
                self.put(step, {name: found[name].values for name in names}, _spacing(found))

    def names(self) -> dict[int, list[str]]:
        """Return the names of the maps of each step."""
        return self._names

    def dataset(self, step: int, names: Sequence[str]) -> xr.Dataset:
        """Return maps of one step."""
        _require(self.names(), step, names)
        place = self._folder / f"{step:06d}"
        spacing = int(json.loads((place / "spacing.json").read_text()))
        maps = {name: np.load(place / f"{name}.npy", mmap_mode="r") for name in names}
        rows, columns = next(iter(maps.values())).shape
        fields = {name: (("row", "column"), values) for name, values in maps.items()}
        places = {"step": step, "row": spacing * np.arange(rows), "column": spacing * np.arange(columns)}
        return xr.Dataset(fields, places, self._attributes)


def _names_in(place: Path) -> list[str]:
    return [name for name in MAPS if (place / f"{name}.npy").exists()]


def _spacing(maps: xr.Dataset) -> int:
    """Return the distance of the points of maps [px]."""
    columns = maps["column"].values
    return int(columns[1] - columns[0]) if len(columns) > 1 else 1


def _require(known: Mapping[int, Sequence[str]], step: int, names: Sequence[str]) -> None:
    missing = [name for name in names if name not in known.get(step, ())]
    if missing:
        raise DatasetError(
            Sentence(
                "step {step} has no map {map}: choose a step and a map of the lists", step=step, map=", ".join(missing)
            )
        )


@dataclass(frozen=True)
class Tile:
    """A map for the browser.

    Attributes
    ----------
    values
        float32 (row, column) in SI units, NaN where not measured.
    spacing
        Distance of two values [px of the reference image]; the first lies at pixel (0, 0).
    """

    values: np.ndarray
    spacing: int


def tile(maps: StepMaps, step: int, name: str) -> Tile:
    """Return a map of a step, decimated to at most `MOST_VALUES`; every value is one of the dataset.

    Raises
    ------
    DatasetError
        The step has no such map.
    """
    found = maps.dataset(step, [name])
    values = np.asarray(found[name].values, np.float32)
    every = math.ceil(math.sqrt(max(values.size, 1) / MOST_VALUES))
    return Tile(np.ascontiguousarray(values[::every, ::every]), _spacing(found) * every)


def cloud(maps: StepMaps, step: int, colour: str) -> np.ndarray:
    """Return points of a step: x, y, z, u, v, w [m] and the value of a map, decimated to at most `MOST_POINTS`.

    Returns
    -------
    ndarray
        float32 (point, 7); only points of which everything is measured.

    Raises
    ------
    DatasetError
        The step has no surface, or no such map.
    """
    found = maps.dataset(step, [*dict.fromkeys((*_POSITION, *_DISPLACEMENT, colour))])
    every = math.ceil(math.sqrt(found["x"].size / MOST_POINTS))
    columns = [found[name].values[::every, ::every].ravel() for name in (*_POSITION, *_DISPLACEMENT, colour)]
    points = np.stack(columns, axis=1).astype(np.float32)
    return np.ascontiguousarray(points[np.isfinite(points).all(axis=1)])


def line(maps: StepMaps, step: int, name: str, start: Point, end: Point) -> dict[str, Any]:
    """Return a map, and its standard deviation where there is one, along a line of the reference image.

    Returns
    -------
    dict
        ``position`` [px], ``value``, ``sigma``, and ``distance`` [m]: from the first measured point of the line in the
        plane of x and y, where the step has a surface.

    Raises
    ------
    DatasetError
        The step has no such map, or the line leaves the result.
    """
    sigma = sigma_of(name)
    known = maps.names().get(step, ())
    names = [name] if sigma is None or sigma not in known else [name, sigma]
    places = [each for each in ("x", "y") if each in known]
    read = [*dict.fromkeys((*names, *places))]
    found = profile(maps.dataset(step, read), read, start, end)
    values = {key: found[wanted].values.tolist() for key, wanted in zip(("value", "sigma"), names, strict=False)}
    if len(places) == 2:
        values["distance"] = _distance(found["x"].values, found["y"].values).tolist()
    return {"position": found["position"].values.tolist(), **values}


def _distance(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the distance of points from the first one that is measured."""
    seen = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    return np.hypot(x - x[seen[0]], y - y[seen[0]]) if seen.size else np.full(x.shape, np.nan)


def gauge(maps: StepMaps, first: Point, second: Point, subset: float) -> list[dict[str, float]]:
    """Return the strain of a virtual extensometer, and its standard deviation, at every step that has one.

    Parameters
    ----------
    maps
        The experiment.
    first, second
        (column, row) of the gauge points [px].
    subset
        Side of the gauge subsets [px].

    Raises
    ------
    DatasetError
        A gauge point lies outside the result, or no step has a displacement.
    """
    steps = [step for step, names in maps.names().items() if set(_POSITION + _DISPLACEMENT) <= set(names)]
    if not steps:
        raise DatasetError(translatable("no step has a displacement yet: measure two steps"))
    return [{"step": step, **gauge_at(maps, step, first, second, subset)} for step in steps]


def gauge_at(maps: StepMaps, step: int, first: Point, second: Point, subset: float) -> dict[str, float]:
    """Return the readings of a virtual extensometer at one step; the arguments are those of `gauge`.

    Raises
    ------
    DatasetError
        A gauge point lies outside the result, or the step has no displacement of a surface.
    """
    known = maps.names().get(step, ())
    sigmas = [name for name in _SIGMAS if name in known]
    found = extensometer(maps.dataset(step, [*_POSITION, *_DISPLACEMENT, *sigmas]), first, second, subset=subset)
    return {str(name): float(found[name]) for name in found}


@functools.cache
def described_signal(name: str, unit: str, source: str) -> dict[str, Any]:
    """Return name, unit for people and source of a signal, for the page."""
    of_people = people_unit(xr.DataArray(name=name, attrs={"units": unit, "quantity": ""}))
    return {"name": name, "unit": of_people.text, "factor": of_people.factor, "source": source}


def described(name: str) -> dict[str, Any]:
    """Return name, meaning, unit for people, standard deviation and smoothing error of a map, for the page.

    ``level`` is 1 for maps in the image, which a running step has first, and 2 for all others.
    """
    unit = people_unit(xr.DataArray(name=name))
    return {
        "name": name,
        "meaning": ALL_MAPS[name].long_name,
        "unit": "" if unit.text == "1" else unit.text,
        "factor": unit.factor,
        "sigma": sigma_of(name),
        "resolution": resolution_of(name),
        "level": 1 if name in _IN_PLANE else 2,
    }
