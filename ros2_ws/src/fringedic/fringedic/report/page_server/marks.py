"""Marks that a person sets on the maps of a test, and notes on its steps, kept in its folder."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, model_validator

from fringedic.configuration.yaml_section import Section, load_sections
from fringedic.datasets.quantities import sigma_of
from fringedic.errors import DatasetError, FringedicError, OperatorError
from fringedic.evaluation import region_statistics
from fringedic.evaluation.mean_uncertainty import maps_for_mean
from fringedic.evidence.changes import noted
from fringedic.frames.region import Point, Polygon, Region
from fringedic.recording.manifest import write_whole
from fringedic.report.page_server.maps import StepMaps, gauge_at, line
from fringedic.surface.planes import spacing_of
from fringedic.wording.causes import cause_of

MARKS = "marks.yaml"
"""Name of the file in the folder of a test."""
MOST_MARKS = 50
_CORNERS = {"point": (1, 1), "gauge": (2, 2), "line": (2, 2), "area": (3, 100)}
_Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]


class Mark(Section):
    """A point, a virtual extensometer, a line or an area with its name."""

    name: str = Field(min_length=1, max_length=60, description="Name, in lists and curves.")
    kind: Literal["point", "gauge", "line", "area"] = Field(description="What it is.")
    points: list[Annotated[list[_Coordinate], Field(min_length=2, max_length=2)]] = Field(
        description="Columns and rows in the reference image [px]."
    )

    @model_validator(mode="after")
    def _has_its_corners(self) -> Mark:
        least, most = _CORNERS[self.kind]
        if not least <= len(self.points) <= most:
            raise ValueError(f"{self.name}: a {self.kind} has {least} to {most} points, not {len(self.points)}")
        return self

    @property
    def corners(self) -> list[Point]:
        """Its points (column, row) [px]."""
        return [(column, row) for column, row in self.points]


class Marks(Section):
    """The marks of a test, and the notes on its steps."""

    marks: list[Mark] = Field([], max_length=MOST_MARKS, description="Points, extensometers, lines and areas.")
    notes: dict[int, Annotated[str, Field(max_length=4000)]] = Field({}, description="Notes by the number of the step.")

    @model_validator(mode="after")
    def _names_differ(self) -> Marks:
        names = [mark.name for mark in self.marks]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f"two marks have the name {twice}: give one of them another name")
        return self

    def save(self, folder: Path) -> None:
        """Write the marks into the folder of a test; a signed test gets an entry about it.

        Raises
        ------
        OperatorError
            The file cannot be written.
        """
        file = folder / MARKS
        try:
            with noted(file, "marks and notes"):
                write_whole(file, yaml.safe_dump(self.model_dump(include={"marks", "notes"}), allow_unicode=True))
        except OSError as error:
            raise OperatorError(f"{file}: cannot be written: {cause_of(error)}") from error


class KeepMarks(Marks):
    """Keeps the marks and notes of a test; of the one that runs or ran last without its name."""

    test: str = Field("", max_length=200, description="Name of the test.")


def shown_marks(folder: Path) -> dict[str, Any]:
    """Return the marks in the folder of a test for the page; those of a damaged file as its ``problem``."""
    try:
        changed = (folder / MARKS).stat().st_mtime_ns
    except OSError:
        changed = 0
    return _shown(folder, changed)


@lru_cache(maxsize=50)
def _shown(folder: Path, changed: int) -> dict[str, Any]:  # noqa: ARG001 (a key of the cache)
    try:
        return load_marks(folder).model_dump() | {"problem": ""}
    except FringedicError as error:
        return {"marks": [], "notes": {}, "problem": str(error)}


def load_marks(folder: Path) -> Marks:
    """Return the marks in the folder of a test; empty without any.

    Raises
    ------
    ConfigurationError
        The file is damaged.
    """
    return load_sections(folder / MARKS, Marks) if (folder / MARKS).is_file() else Marks()


class Asked(BaseModel):
    """Which readings are asked for: of these marks, at these steps; none for all steps.

    Attributes
    ----------
    name
        The map that is read.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    name: str = Field(max_length=60)
    marks: list[Mark] = Field(max_length=MOST_MARKS)
    steps: list[int] | None = Field(None, max_length=10_000)
    subset: float = Field(9.0, gt=0, le=1000)


def readings(maps: StepMaps, asked: Asked) -> list[list[dict[str, Any]]]:
    """Return what marks read on a map: for each mark a list over the steps.

    Returns
    -------
    list
        Each reading contains ``step``, ``value`` and ``sigma`` (strain for a gauge, the mean for an area or a line),
        for areas and lines also ``minimum``, ``maximum``, ``standard_deviation`` and ``measured``, for a gauge
        ``length`` [m]; SI units. A step without the map, or a mark outside of it, has a ``problem`` instead.
    """
    known = maps.names()
    steps = [step for step in (known if asked.steps is None else asked.steps) if known.get(step)]
    return [[{"step": step, **_reading(maps, step, asked, mark)} for step in steps] for mark in asked.marks]


def _reading(maps: StepMaps, step: int, asked: Asked, mark: Mark) -> dict[str, Any]:
    try:
        if mark.kind == "gauge":
            return _of_gauge(maps, step, mark, asked.subset)
        if mark.kind == "line":
            return _summary(np.array(line(maps, step, asked.name, *mark.corners)["value"]))
        if mark.kind == "point":
            return _of_point(maps, step, asked.name, mark.corners[0])
        return _of_area(maps, step, asked.name, mark)
    except FringedicError as error:
        return {"problem": str(error)}


def _with_sigma(maps: StepMaps, step: int, name: str) -> list[str]:
    sigma = sigma_of(name)
    return [name] if sigma is None or sigma not in maps.names().get(step, ()) else [name, sigma]


def _of_gauge(maps: StepMaps, step: int, mark: Mark, subset: float) -> dict[str, Any]:
    first, second = mark.corners
    found = gauge_at(maps, step, first, second, subset)
    return {"value": found["strain"], "sigma": found.get("sigma_strain", np.nan), "length": found["length"]}


def _of_point(maps: StepMaps, step: int, name: str, point: Point) -> dict[str, Any]:
    names = _with_sigma(maps, step, name)
    dataset = maps.dataset(step, names)
    half = abs(spacing_of(dataset["column"].values)) / 2
    try:
        nearest = dataset.sel(column=point[0], row=point[1], method="nearest", tolerance=half)
    except KeyError as error:
        raise DatasetError(f"the point {point} px (column, row) lies outside the result") from error
    values = [float(nearest[each]) for each in names]
    return {"value": values[0], "sigma": values[1] if len(values) > 1 else np.nan}


def _of_area(maps: StepMaps, step: int, name: str, mark: Mark) -> dict[str, Any]:
    places = [each for each in maps_for_mean(name) if each in maps.names().get(step, ())]
    dataset = maps.dataset(step, [*dict.fromkeys((*_with_sigma(maps, step, name), *places))])
    table = region_statistics(dataset, [name], Region((Polygon(tuple(mark.corners)),)))
    values = {str(each): float(table[name].sel(statistic=each)) for each in table["statistic"].values}
    return {
        "value": values["mean"],
        "sigma": values["standard_uncertainty"],
        **{each: values[each] for each in ("minimum", "maximum", "standard_deviation")},
        "measured": float(table["measured_fraction"].sel(map=name)),
    }


def _summary(values: np.ndarray) -> dict[str, Any]:
    seen = values[np.isfinite(values)]
    if not seen.size:
        return {"value": np.nan, "sigma": np.nan, "measured": 0.0}
    return {
        "value": float(seen.mean()),
        "sigma": np.nan,
        "minimum": float(seen.min()),
        "maximum": float(seen.max()),
        "standard_deviation": float(seen.std()),
        "measured": seen.size / values.size,
    }
