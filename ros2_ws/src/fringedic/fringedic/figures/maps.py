"""Maps of shape, displacement and errors as figures and files."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr

from fringedic.datasets.attributes import origin_text
from fringedic.datasets.quantities import PeopleUnit, people_unit, strain_measure_of
from fringedic.datasets.signals import signal_names
from fringedic.errors import DatasetError
from fringedic.evaluation.step_maps import with_principal_strains
from fringedic.evaluation.truth import truth_errors
from fringedic.figures.panels import ERRORS, Panel, pictures_of
from fringedic.figures.previews import NOT_MEASURED
from fringedic.frames.region import Point
from fringedic.frames.sensor import JOINED
from fringedic.signals import FORCE, POSITION
from fringedic.surface.strain_measures import TENSORS
from fringedic.wording.arguments import check_arguments, path
from fringedic.wording.arguments import dataset as dataset_of
from fringedic.wording.causes import cause_of
from fringedic.wording.numbers import number_text
from fringedic.wording.optional_packages import optional_import

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_NOT_MEASURED_COLOUR = f"#{bytes(NOT_MEASURED).hex()}"
_WIDEST = 900  # points of a map along its longer side in a picture
_HIGHEST, _NARROWEST = 7.0, 3.0  # [inch] of a map
# [inch] around a map: its labels, its colour bar with labels, its title; a layout found by matplotlib takes as long as
# all drawing
_LEFT, _RIGHT, _BELOW, _ABOVE = 0.75, 1.15, 0.55, 0.35
_HEADING = 0.45  # [inch]
_TAIL = 0.5  # [%] of the values beyond either end of a colour scale
Extent = tuple[float, float, float, float]
"""Left, right, bottom and top of a map in the unit of its axes."""


class Scale(NamedTuple):
    """The colours of a map: their unit, and the values of the first and the last one in this unit."""

    unit: PeopleUnit
    low: float
    high: float


def _with_displacement(value: Any) -> Any:
    """Check a dataset of one sensor, or of the joined surface of several, which has no displacement in an image."""
    joined = isinstance(value, xr.Dataset) and value.attrs.get("sensor") == JOINED
    names = ("u", "v") if joined else ("displacement_x", "displacement_y")
    return dataset_of(*names, over=("step", "row", "column"))(value)


@check_arguments(
    DatasetError,
    dataset=_with_displacement,
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
        Folder of the pictures, ``step_003.png``, ``step_003_strain.png``, ``step_003_sigma.png``,
        ``step_003_resolution.png`` (smoothing error of the strain) and, with a truth, ``step_003_errors.png``; made if
        it is missing.
    truth
        From `fringedic.evaluation.open_truth`.

    Returns
    -------
    list of Path
        The pictures. Steps that failed have none; steps of one white frame, and images without a rig, show the
        in-plane displacement.

    Raises
    ------
    DatasetError
        The dataset lacks a map, or the folder cannot be made.
    FringedicError
        The package ``matplotlib`` is not installed.

    Examples
    --------
    >>> import fringedic
    >>> dataset = fringedic.open_experiment("recordings/plate-7/bag").isel(step=[2])
    >>> [picture.name for picture in save_pictures(dataset, "pictures")]
    ['step_002.png', 'step_002_strain.png', 'step_002_sigma.png', 'step_002_resolution.png']
    """
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DatasetError(f"{folder}: cannot be made: {cause_of(error)}") from error
    files, origin = [], origin_text(dataset)
    drawn: dict[tuple[Panel, ...], Figure] = {}  # each shows one step after the other

    def save(name: str, maps: xr.Dataset, panels: tuple[Panel, ...], title: str) -> None:
        if panels in drawn:
            # New axes would take as long as all drawing.
            figure = drawn[panels]
            _entitle(figure, title)
            for axes, panel in zip(figure.axes, panels, strict=True):
                _redraw(axes, maps, panel)
        else:
            drawn[panels] = maps_figure(maps, panels, title=title)
        files.append(target / name)
        drawn[panels].savefig(files[-1], metadata={"Description": origin})

    for step in dataset.step.values:
        number = int(step)
        measured = with_principal_strains(dataset.sel(step=step))
        if not np.isfinite(measured["displacement_x" if "displacement_x" in measured else "w"]).any():
            continue
        words = [f"{measured.attrs.get('experiment', 'experiment')}, step {number}"]
        if "image" in measured:
            words.append(str(measured["image"].values))
        for shown in signal_names(measured):
            value, unit = float(measured[shown]), people_unit(measured[shown])
            if shown == POSITION.name and np.isfinite(value):
                words.append(f"crosshead {value / unit.factor:.3f} {unit.text}")
            elif np.isfinite(value):
                words.append(
                    f"{'' if shown == FORCE.name else f'{shown} '}{number_text(value / unit.factor)} {unit.text}"
                )
        title = ", ".join(words)
        for name, panels in pictures_of(measured).items():
            words = [title] if name != "strain" else [title, f"{TENSORS[strain_measure_of(measured)].title} strain"]
            save(f"step_{number:03d}{name and f'_{name}'}.png", measured, panels, ", ".join(words))
        if truth is not None and "w" in measured and np.isfinite(measured["w"]).any():
            errors = truth_errors(dataset, truth, number)
            save(f"step_{number:03d}_errors.png", errors, ERRORS, f"{title}: measured minus true")
    return files


def maps_figure(
    maps: xr.Dataset, panels: tuple[Panel, ...], *, title: str, scales: Mapping[str, Scale] | None = None
) -> Figure:
    """Draw maps of one step side by side, each with its own colour bar.

    Parameters
    ----------
    maps
        Maps over (row, column); the coordinates ``x_mm`` and ``y_mm`` of an experiment give the axes millimetres.
    panels
        The maps to draw.
    title
        Of the picture.
    scales
        Colour scales by the names of maps; others are without the tails of the values.

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
    size = _map_size(maps, 4.35)
    width, height = _panel_size(size)
    figure = Figure(figsize=(2 * width, lines * height + _HEADING), dpi=100)
    _entitle(figure, title)
    for place, panel in enumerate(panels):
        axes = _panel_axes(figure, size, place % 2, lines - 1 - place // 2)
        draw_map(axes, maps, panel, (scales or {}).get(panel.name))
    return figure


def _redraw(axes: Axes, maps: xr.Dataset, panel: Panel, scale: Scale | None = None) -> None:
    """Show another step in axes of `draw_map`."""
    shown = _prepare(maps, panel, scale)
    axes.images[0].set_data(shown.values)
    axes.images[0].set_clim(shown.scale.low, shown.scale.high)
    axes.child_axes[0].set_ylabel(shown.scale.unit.text)
    axes.set_title(shown.title, y=1.0)


def _entitle(figure: Figure, title: str) -> None:
    figure.suptitle(title, y=1 - 0.1 / figure.get_figheight())


def reference_figure(reference: xr.Dataset, measured: xr.Dataset, gauges: Mapping[str, tuple[Point, Point]]) -> Figure:
    """Draw the reference image with the outline of what was measured, and virtual extensometers with their names.

    Parameters
    ----------
    reference
        The reference step, with its ``texture``.
    measured
        A measured step, with ``displacement_x``.
    gauges
        Gauge points (column, row) [px] by name.
    """
    with optional_import("figures"):
        from matplotlib.figure import Figure
    size = _map_size(reference, 5.2)
    figure = Figure(figsize=_panel_size(size), dpi=100)
    axes = _panel_axes(figure, size, 0, 0)
    grey, extent = _thin(reference["texture"].values), _extent(reference)
    axes.imshow(grey, cmap="gray", extent=extent, origin="upper", interpolation="nearest")
    inside = _thin(np.isfinite(measured["displacement_x"].values).astype(float))
    if 0 < inside.mean() < 1 and min(inside.shape) > 1:
        axes.contour(inside, [0.5], colors="#ffb000", linewidths=1.5, extent=extent, origin="upper")
    left, right, bottom, top = extent
    columns, rows = (_edges(reference[name].values) for name in ("column", "row"))
    for name, points in gauges.items():
        x = np.interp([point[0] for point in points], columns, (left, right))
        y = np.interp([point[1] for point in points], rows, (top, bottom))
        axes.plot(x, y, "o-", color="#00c8ff", markersize=4, linewidth=1.5)
        axes.annotate(name, (x.mean(), y.mean()), color="#00c8ff", xytext=(4, 4), textcoords="offset points")
    across, down = ("x [mm]", "y [mm]") if "x_mm" in reference.coords else ("column [px]", "row [px]")
    axes.set(xlabel=across, ylabel=down, title="reference image, outline of the measured surface")
    return figure


def map_figure(maps: xr.Dataset, panel: Panel, scale: Scale, *, title: str) -> Figure:
    """Draw one map of one step with a given colour scale.

    Parameters
    ----------
    maps, panel, title
        As for `maps_figure`.
    scale
        Its colours.
    """
    with optional_import("figures"):
        from matplotlib.figure import Figure
    size = _map_size(maps, 5.0)
    figure = Figure(figsize=_panel_size(size), dpi=90)
    axes = _panel_axes(figure, size, 0, 0)
    draw_map(axes, maps, panel, scale)
    axes.set_title(title)
    return figure


def redraw_map(figure: Figure, maps: xr.Dataset, panel: Panel, scale: Scale, *, title: str) -> None:
    """Show the map of another step in a figure of `map_figure`."""
    _redraw(figure.axes[0], maps, panel, scale)
    figure.axes[0].set_title(title)


def _thin(values: np.ndarray) -> np.ndarray:
    thin = max(1, max(values.shape) // _WIDEST)
    return values[::thin, ::thin]


def draw_map(axes: Axes, maps: xr.Dataset, panel: Panel, scale: Scale | None = None) -> None:
    """Draw a map with its colour bar, as the camera sees it: x to the right, and the first row at the top.

    Parameters
    ----------
    axes
        Where to draw.
    maps, panel
        As for `maps_figure`.
    scale
        Its colours; by default without the tails of the values.
    """
    from matplotlib import colormaps

    values, (unit, low, high), title = _prepare(maps, panel, scale)
    name = "RdBu_r" if panel.symmetric else "viridis"
    image = axes.imshow(
        values,
        cmap=colormaps[name].with_extremes(bad=_NOT_MEASURED_COLOUR),
        vmin=low,
        vmax=high,
        extent=_extent(maps),
        origin="upper",
        interpolation="nearest",
    )
    place = axes.inset_axes((1.03, 0.0, 0.04, 1.0))
    bar = axes.figure.colorbar(image, cax=place, label=unit.text, extend="both", extendfrac=0.03)
    bar.formatter.set_useOffset(False)  # type: ignore[attr-defined] # numbers as they are, without "+1.8e2" above them
    bar.formatter.set_scientific(False)  # type: ignore[attr-defined]
    across, down = ("x [mm]", "y [mm]") if "x_mm" in maps.coords else ("column [px]", "row [px]")
    axes.set(xlabel=across, ylabel=down)
    axes.set_title(title, y=1.0)  # a place found by matplotlib takes a fifth of all drawing


class _Shown(NamedTuple):
    """The values of a picture in its unit, its colour scale, and its title."""

    values: np.ndarray
    scale: Scale
    title: str


def _prepare(maps: xr.Dataset, panel: Panel, scale: Scale | None = None) -> _Shown:
    values = maps[panel.name].values
    finite = values[np.isfinite(values)]
    if scale is None:
        alike = finite
        if panel.like:  # two maps with one colour scale
            other = maps[panel.like].values
            alike = np.concatenate([finite, other[np.isfinite(other)]])
        low, high = (float(end) for end in np.percentile(alike, (_TAIL, 100 - _TAIL))) if alike.size else (0.0, 0.0)
        if panel.symmetric:
            high = max(abs(low), abs(high))
            low = -high
        scale = scale_between(maps[panel.name], low, high)
    title = panel.title
    if panel.symmetric and finite.size:
        rms = float(np.sqrt(np.mean((finite / scale.unit.factor) ** 2)))
        title += f"   RMS {number_text(rms, 3)} {scale.unit.text}"
    return _Shown(_thin(np.asarray(values / scale.unit.factor)), scale, title)


def scale_between(variable: xr.DataArray, low: float, high: float) -> Scale:
    """Return the colour scale of a map between two of its values, in the unit of people."""
    unit = people_unit(variable, max(abs(low), abs(high)))
    low, high = low / unit.factor, high / unit.factor
    return Scale(unit, low, high) if high > low else Scale(unit, low - 0.5, low + 0.5)


def _extent(maps: xr.Dataset) -> Extent:
    """Return the edges of the points' pixels: millimetres where the scale is known, else pixels with rows downwards."""
    names = ("x_mm", "y_mm") if "x_mm" in maps.coords else ("column", "row")
    (left, right), (top, bottom) = (_edges(maps[name].values) for name in names)
    return left, right, bottom, top


def _map_size(maps: xr.Dataset, width: float) -> tuple[float, float]:
    """Return width and height [inch] of a map in a picture; high maps are made narrower."""
    left, right, bottom, top = _extent(maps)
    aspect = abs((top - bottom) / (right - left))
    wide = min(width, _HIGHEST / aspect)
    return wide, wide * aspect


def _panel_size(size: tuple[float, float]) -> tuple[float, float]:
    """Return width and height [inch] of a map with what stands around it; a title has space over a narrow map."""
    return max(size[0], _NARROWEST) + _LEFT + _RIGHT, size[1] + _BELOW + _ABOVE


def _panel_axes(figure: Figure, size: tuple[float, float], column: int, line: int) -> Axes:
    """Return axes for a map of a size [inch] in a column and a line of panels, lines counted from below."""
    panel, whole = _panel_size(size), figure.get_size_inches()
    left = column * panel[0] + _LEFT + 0.5 * (panel[0] - _LEFT - _RIGHT - size[0])
    corner = np.array([left, line * panel[1] + _BELOW])
    return figure.add_axes((*(corner / whole), *(size / whole)))


def _edges(positions: np.ndarray) -> tuple[float, float]:
    half = 0.5 * float(positions[1] - positions[0]) if len(positions) > 1 else 0.5
    return float(positions[0] - half), float(positions[-1] + half)
