"""Maps of shape, displacement and errors as figures and files."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from fringedic.arguments import check_arguments, path
from fringedic.arguments import dataset as dataset_of
from fringedic.errors import DatasetError, optional_import
from fringedic.figures.panels import ERRORS, IN_PLANE, SHAPE_AND_DISPLACEMENT, Panel
from fringedic.figures.previews import NOT_MEASURED
from fringedic.results.attributes import origin_text
from fringedic.results.truth import truth_errors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_NOT_MEASURED_COLOUR = f"#{bytes(NOT_MEASURED).hex()}"
_WIDEST = 900  # points of a map along its longer side in a picture
_TAIL = 0.5  # [%] of the values beyond either end of a colour scale
Extent = tuple[float, float, float, float]
"""Left, right, bottom and top of a map in the unit of its axes."""


@check_arguments(
    DatasetError,
    dataset=dataset_of("displacement_x", "displacement_y", "w", over=("step", "row", "column")),
    folder=path,
)
def save_pictures(
    dataset: xr.Dataset, folder: str | os.PathLike[str], *, truth: xr.Dataset | None = None
) -> list[Path]:
    """Write the maps of every measured step, and of its errors if the truth is known, as PNG.

    Parameters
    ----------
    dataset
        From `fringedic.open_experiment`.
    folder
        Folder of the pictures, ``step_003.png`` and ``step_003_errors.png``; made if it is missing.
    truth
        From `fringedic.results.open_truth`.

    Returns
    -------
    list of Path
        The pictures. Steps that failed have none; steps of one white frame show the in-plane displacement.

    Raises
    ------
    DatasetError
        The dataset lacks a map, or the folder cannot be made.
    FringedicError
        The package ``matplotlib`` is not installed.

    Examples
    --------
    >>> dataset = fringedic.open_experiment("recordings/plate-7/bag")  # doctest: +SKIP
    >>> save_pictures(dataset, "pictures")  # doctest: +SKIP
    [PosixPath('pictures/step_000.png'), PosixPath('pictures/step_001.png')]
    """
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DatasetError(f"{folder}: cannot be made: {error.strerror}") from error
    files, origin = [], origin_text(dataset)
    for step in dataset.step.values:
        number = int(step)
        measured = dataset.sel(step=step)
        spatial, in_plane = (bool(np.isfinite(measured[name]).any()) for name in ("w", "displacement_x"))
        if not in_plane:
            continue
        panels = SHAPE_AND_DISPLACEMENT if spatial else IN_PLANE
        title = _title(measured, number)
        files.append(_save(maps_figure(measured, panels, title=title), target / f"step_{number:03d}.png", origin))
        if truth is not None and spatial:
            errors = truth_errors(dataset, truth, number).assign_attrs(dataset.attrs)
            figure = maps_figure(errors, ERRORS, title=f"{title}: measured minus true")
            files.append(_save(figure, target / f"step_{number:03d}_errors.png", origin))
    return files


def maps_figure(maps: xr.Dataset, panels: tuple[Panel, ...], *, title: str) -> Figure:
    """Draw maps of one step side by side, each with its own colour bar.

    Parameters
    ----------
    maps
        Maps over (row, column); the attribute ``calibration`` of an experiment gives the axes their millimetres.
    panels
        The maps to draw.
    title
        Of the picture.

    Raises
    ------
    DatasetError
        A panel's map is not in the dataset.
    """
    with optional_import("figures"):
        from matplotlib.figure import Figure
    missing = [panel.name for panel in panels if panel.name not in maps]
    if missing:
        raise DatasetError(f"the dataset has no {', '.join(missing)}")
    lines = (len(panels) + 1) // 2
    extent, across, along = _axes_of(maps)
    height = 4.7 * abs((extent[3] - extent[2]) / (extent[1] - extent[0])) + 0.8
    figure = Figure(figsize=(12.5, lines * height + 0.5), dpi=100, layout="constrained")
    figure.suptitle(title)
    for place, panel in enumerate(panels):
        axes = figure.add_subplot(lines, 2, place + 1)
        _draw(axes, maps[panel.name].values / panel.factor, panel, extent)
        axes.set_xlabel(across)
        axes.set_ylabel(along)
    return figure


def map_figure(maps: xr.Dataset, panel: Panel, limits: tuple[float, float], *, title: str) -> Figure:
    """Draw one map of one step with given ends of its colour scale [the panel's unit].

    Parameters
    ----------
    maps, panel, title
        As for `maps_figure`.
    limits
        Values of the first and the last colour.
    """
    with optional_import("figures"):
        from matplotlib.figure import Figure
    extent, across, along = _axes_of(maps)
    figure = Figure(
        figsize=(6.4, 5.2 * abs((extent[3] - extent[2]) / (extent[1] - extent[0])) + 0.9), dpi=90, layout="constrained"
    )
    axes = figure.add_subplot()
    _draw(axes, maps[panel.name].values / panel.factor, panel, extent, limits)
    axes.set(xlabel=across, ylabel=along, title=title)
    return figure


def redraw_map(figure: Figure, maps: xr.Dataset, panel: Panel, *, title: str) -> None:
    """Show the map of another step in a figure of `map_figure`, with the same colour scale and layout."""
    figure.set_layout_engine("none")  # a new layout takes longer than drawing
    axes = figure.axes[0]
    axes.images[0].set_data(_thinned(maps[panel.name].values / panel.factor))
    axes.set_title(title)


def _thinned(values: np.ndarray) -> np.ndarray:
    thin = max(1, max(values.shape) // _WIDEST)
    return values[::thin, ::thin]


def _draw(
    axes: Axes,
    values: np.ndarray,
    panel: Panel,
    extent: Extent,
    limits: tuple[float, float] | None = None,
) -> None:
    from matplotlib import colormaps

    finite = values[np.isfinite(values)]
    low, high = limits or _colour_range(finite, panel.symmetric)
    name = "RdBu_r" if panel.symmetric else "viridis"
    image = axes.imshow(
        _thinned(values),
        cmap=colormaps[name].with_extremes(bad=_NOT_MEASURED_COLOUR),
        vmin=low,
        vmax=high,
        extent=extent,
        origin="upper",
        interpolation="nearest",
    )
    bar = axes.inset_axes((1.03, 0.0, 0.04, 1.0))
    axes.figure.colorbar(image, cax=bar, label=panel.units, extend="both", extendfrac=0.03)
    spread = f"RMS {np.sqrt(np.mean(finite**2)):.3g} {panel.units}" if panel.symmetric and finite.size else ""
    axes.set_title(f"{panel.title}   {spread}".rstrip())


def _colour_range(finite: np.ndarray, symmetric: bool) -> tuple[float, float]:
    """Return the ends of the colour scale of a map, without the tails of its values."""
    low, high = (float(end) for end in np.percentile(finite, (_TAIL, 100 - _TAIL))) if finite.size else (0.0, 1.0)
    if symmetric:
        high = max(abs(low), abs(high))
        low = -high
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def _axes_of(maps: xr.Dataset) -> tuple[Extent, str, str]:
    """Return the extent of the image and the labels of its axes."""
    row, column = (_edges(maps[name].values) for name in ("row", "column"))
    if "calibration" not in maps.attrs:
        return (column[0], column[1], row[1], row[0]), "column [px]", "row [px]"
    rig: Mapping[str, float] = json.loads(maps.attrs["calibration"])
    scale = 1e3 * rig["pixel_size"]
    x = [scale / rig["pixel_aspect"] * (edge - rig["principal_column"]) for edge in column]
    y = [-scale * (edge - rig["principal_row"]) for edge in row]
    return (x[0], x[1], y[1], y[0]), "x [mm]", "y [mm]"


def _edges(positions: np.ndarray) -> tuple[float, float]:
    half = 0.5 * (positions[1] - positions[0]) if len(positions) > 1 else 0.5
    return float(positions[0] - half), float(positions[-1] + half)


def _title(measured: xr.Dataset, step: int) -> str:
    words = [f"{measured.attrs.get('experiment', 'experiment')}, step {step}"]
    if "position" in measured and np.isfinite(measured["position"]):
        words.append(f"crosshead {float(measured['position']) * 1e3:.3f} mm")
    if "force" in measured and np.isfinite(measured["force"]):
        words.append(f"{float(measured['force']):.4g} N")
    return ", ".join(words)


def _save(figure: Figure, file: Path, origin: str) -> Path:
    figure.savefig(file, metadata={"Description": origin})
    return file
