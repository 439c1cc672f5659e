"""Pictures for people: maps of shape, displacement and errors as PNG, and colour previews of running measurements.

Positions are those on the reference plane in millimetre, y upwards; without a calibration they are pixels, rows
downwards. Grey is not measured.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
import xarray as xr

from fringedic.errors import DatasetError
from fringedic.results import truth_errors
from fringedic.results.metadata import metadata_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NOT_MEASURED = (128, 128, 128)
_NOT_MEASURED_COLOUR = f"#{bytes(NOT_MEASURED).hex()}"
_WIDEST = 900  # points of a map along its longer side in a picture
_TAIL = 0.5  # per cent of the values beyond either end of a colour scale


class Panel(NamedTuple):
    """One map of a picture: its name in the dataset, what it is, its unit, and that unit's value in the dataset's."""

    name: str
    title: str
    units: str
    factor: float
    symmetric: bool = True


SHAPE_AND_DISPLACEMENT = (
    Panel("shape_z", "height z", "mm", 1e-3, symmetric=False),
    Panel("u", "displacement u along x", "µm", 1e-6, symmetric=False),
    Panel("v", "displacement v along y", "µm", 1e-6, symmetric=False),
    Panel("w", "displacement w along z", "µm", 1e-6, symmetric=False),
)
ERRORS = (
    Panel("shape_z", "error of z", "µm", 1e-6),
    Panel("u", "error of u", "µm", 1e-6),
    Panel("v", "error of v", "µm", 1e-6),
    Panel("w", "error of w", "µm", 1e-6),
)
ANIMATED = (
    Panel("u", "displacement u along x", "mm", 1e-3, symmetric=False),
    Panel("v", "displacement v along y", "mm", 1e-3, symmetric=False),
    Panel("w", "displacement w along z", "mm", 1e-3, symmetric=False),
    Panel("e_11", "strain e_11 along t1", "µstrain", 1e-6, symmetric=False),
    Panel("e_22", "strain e_22 along t2", "µstrain", 1e-6, symmetric=False),
    Panel("displacement_x", "displacement along columns", "px", 1.0, symmetric=False),
    Panel("displacement_y", "displacement along rows, downwards", "px", 1.0, symmetric=False),
)
IN_PLANE = (
    Panel("displacement_x", "displacement along columns", "px", 1.0, symmetric=False),
    Panel("displacement_y", "displacement along rows, downwards", "px", 1.0, symmetric=False),
    Panel("displacement_sigma_x", "its standard deviation along columns", "px", 1.0, symmetric=False),
    Panel("displacement_sigma_y", "its standard deviation along rows", "px", 1.0, symmetric=False),
)


def save_pictures(
    dataset: xr.Dataset, folder: str | os.PathLike[str], *, truth: xr.Dataset | None = None
) -> list[Path]:
    """Write the maps of every measured step, and of its errors where the truth is known, as PNG.

    Parameters
    ----------
    dataset
        From `fringedic.open_experiment`.
    folder
        Where the pictures go, ``step_003.png`` and ``step_003_errors.png``; made when it is not there.
    truth
        From `fringedic.results.open_truth`.

    Returns
    -------
    list of Path
        The pictures. Steps that failed have none; steps of one white frame show the in-plane displacement.
    """
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    files, origin = [], metadata_text(dataset)
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
        What to draw.
    title
        Written above.

    Raises
    ------
    DatasetError
        A panel's map is not in the dataset.
    """
    # not at the top: nodes use the previews of this module, and matplotlib takes its time to load
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
    figure.set_layout_engine("none")  # to lay it out anew takes longer than to draw it
    axes = figure.axes[0]
    axes.images[0].set_data(_thinned(maps[panel.name].values / panel.factor))
    axes.set_title(title)


def phase_preview(phase: np.ndarray) -> np.ndarray:
    """Colour a phase map [rad], shape (row, column), as one turn of the colour circle per fringe: uint8 rgb."""
    turns = np.mod(np.nan_to_num(phase) / (2 * np.pi), 1.0)
    circle = np.stack([turns * 180, np.full_like(turns, 200), np.full_like(turns, 255)], axis=-1)
    return _coloured(circle, np.isfinite(phase))


def displacement_preview(displacement: np.ndarray) -> np.ndarray:
    """Colour a displacement (d_x, d_y) [px], shape (row, column, 2): uint8 rgb.

    The hue is the direction (red to the right, green-yellow upwards), the saturation the length, full at the longest
    but for outliers.
    """
    along, down = displacement[..., 0], displacement[..., 1]
    measured = np.isfinite(along) & np.isfinite(down)
    length = np.hypot(np.nan_to_num(along), np.nan_to_num(down))
    longest = max(float(np.percentile(length[measured], 99)) if measured.any() else 0.0, 1e-6)
    turns = np.mod(np.arctan2(-np.nan_to_num(down), np.nan_to_num(along)) / (2 * np.pi), 1.0)
    circle = np.stack([turns * 180, np.clip(length / longest, 0, 1) * 255, np.full_like(length, 255)], axis=-1)
    return _coloured(circle, measured)


def _coloured(hue_saturation_value: np.ndarray, measured: np.ndarray) -> np.ndarray:
    colours = cv2.cvtColor(np.minimum(hue_saturation_value, (179, 255, 255)).astype(np.uint8), cv2.COLOR_HSV2RGB)
    colours[~measured] = NOT_MEASURED
    return colours


def _thinned(values: np.ndarray) -> np.ndarray:
    thin = max(1, max(values.shape) // _WIDEST)
    return values[::thin, ::thin]


def _draw(
    axes: Axes,
    values: np.ndarray,
    panel: Panel,
    extent: tuple[float, float, float, float],
    limits: tuple[float, float] | None = None,
) -> None:
    from matplotlib import colormaps

    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, (_TAIL, 100 - _TAIL)) if finite.size else (0.0, 1.0)
    if limits is not None:
        low, high = limits
    elif panel.symmetric:
        high = max(abs(low), abs(high))
        low = -high
    if high <= low:
        low, high = low - 0.5, low + 0.5
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


def _axes_of(maps: xr.Dataset) -> tuple[tuple[float, float, float, float], str, str]:
    """Return (left, right, bottom, top) of the image and what the axes are."""
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
    if np.isfinite(measured["position"]):
        words.append(f"crosshead {float(measured['position']) * 1e3:.3f} mm")
    if np.isfinite(measured["force"]):
        words.append(f"{float(measured['force']):.4g} N")
    return ", ".join(words)


def _save(figure: Figure, file: Path, origin: str) -> Path:
    figure.savefig(file, metadata={"Description": origin})
    return file
