"""Interactive charts: the surface with its displacement, and curves over the steps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from fringedic.datasets.quantities import largest_of, people_unit, strain_unit
from fringedic.datasets.signals import knows_sigma, sigma_name, signal_names
from fringedic.errors import DatasetError
from fringedic.wording.optional_packages import optional_import

with optional_import("report"):
    import plotly.graph_objects as go

MILLI, MICRO, MEGA = 1e-3, 1e-6, 1e6
SURFACE_POINTS = 160  # along the longer side
VECTORS = 22  # along the longer side
_SURFACE_SIZE = 1.1  # the longest side has this length in the view, which shows about 2 at the distance of the eye
_LONGEST_VECTOR = 0.12  # the longest arrow is this part of the surface's longer side
_STRAINS = ("e_11", "e_22", "e_12", "e_xx", "e_yy", "e_xy")
_LAYOUT: dict[str, Any] = {
    "template": "plotly_white",
    "margin": {"l": 60, "r": 20, "t": 50, "b": 50},
    "height": 380,
    "xaxis": {"exponentformat": "none"},
    "yaxis": {"exponentformat": "none"},
}


def surface_chart(step: xr.Dataset) -> go.Figure:
    """Return the moved surface of a step [mm], coloured by w [µm], with its displacement as lines.

    Raises
    ------
    DatasetError
        The step has no surface.
    """
    arrays = {name: _thin(step[name].values, SURFACE_POINTS) for name in "xyzuvw"}
    if not np.isfinite(arrays["w"]).any():
        raise DatasetError(f"step {int(step.step)} has no surface")
    at = [(arrays[axis] + arrays[way]) / MILLI for axis, way in zip("xyz", "uvw", strict=True)]
    unmeasured = ~np.isfinite(at[0] + at[1] + at[2])
    for values in at:
        values[unmeasured] = np.nan
    figure = go.Figure(
        go.Surface(
            x=_filled(at[0]),
            y=_filled(at[1]),
            z=_short(at[2], 5),
            surfacecolor=_short(arrays["w"] / MICRO, 3),
            colorscale="Viridis",
            colorbar={"title": "w [µm]"},
            hovertemplate="x %{x:.3f} mm<br>y %{y:.3f} mm<br>z %{z:.4f} mm<br>w %{surfacecolor:.2f} µm<extra></extra>",
        )
    )
    title = f"Step {int(step.step)}: surface"
    thin = {name: _thin(step[name].values, VECTORS).astype(np.float64) for name in "xyzuvw"}
    known = np.isfinite(sum(thin.values()))
    length = np.sqrt(thin["u"] ** 2 + thin["v"] ** 2 + thin["w"] ** 2)[known]
    if not length.size or length.max() == 0:
        lines, heads, factor = [np.zeros(0)] * 3, [np.zeros(0)] * 3, 1.0
    else:
        size = max(np.ptp(thin[axis][known]) for axis in "xy")
        factor = _LONGEST_VECTOR * size / length.max()
        # the lines are above the surface: where it sinks they end on it, where it rises they start from it
        before = np.where(thin["w"][known] < 0, factor, 0.0)
        lines, heads = [], []
        for axis, way in zip("xyz", "uvw", strict=True):
            moved = thin[way][known]
            tail = thin[axis][known] + moved - before * moved
            head = tail + factor * moved
            lines.append(_short(np.stack([tail, head, np.full_like(tail, np.nan)], axis=-1).ravel() / MILLI, 4))
            heads.append(_short(head / MILLI, 4))
    if len(heads[0]):
        title += f"<br><sub>displacement x {factor:.3g}, from the line's end to its dot</sub>"
        along = dict(zip("xyz", lines, strict=True))
        figure.add_trace(go.Scatter3d(**along, mode="lines", line={"color": "crimson", "width": 3}, hoverinfo="skip"))
        tips = dict(zip("xyz", heads, strict=True))
        figure.add_trace(go.Scatter3d(**tips, mode="markers", marker={"color": "crimson", "size": 2}, hoverinfo="skip"))
    axes: dict[str, Any] = {f"{axis}axis_title": f"{axis} [mm]" for axis in "xyz"}
    # in proportion, but of a fixed size: plotly's own proportions draw a flat surface larger than its frame
    sizes = {axis: float(np.nanmax(values) - np.nanmin(values)) for axis, values in zip("xyz", at, strict=True)}
    proportions = {axis: _SURFACE_SIZE * size / max(sizes.values()) for axis, size in sizes.items()}
    axes |= {"aspectmode": "manual", "aspectratio": proportions, "camera": {"eye": {"x": 0.5, "y": -1.5, "z": 1.3}}}
    figure.update_layout(**{**_LAYOUT, "height": 620}, title=title, scene=axes, showlegend=False)
    return figure


def curve_charts(dataset: xr.Dataset, section: float | None) -> list[go.Figure]:
    """Return displacement, strain and force over the steps, and force or stress over strain.

    Each further signal, such as a torque or a temperature, has a curve over the steps; with one of them, the last chart
    shows any of these quantities over any other. Curves of displacement and strain are interrupted where the reference
    step changes, because they start again there.

    Parameters
    ----------
    dataset
        The experiment.
    section
        Area that carries the force [m²], None when it is not known.
    """
    numbers, breaks = dataset["step"].values, reference_changes(dataset["reference_step"].values)
    moved, unit = _medians(dataset, "uvw", MICRO), "µm"
    if not moved:
        moved, unit = _medians(dataset, ("displacement_x", "displacement_y"), 1.0), "px"
    figures = [_over("Median displacement", "step", f"displacement [{unit}]", numbers, moved, breaks)]
    strains = _medians(dataset, _STRAINS, 1.0)
    unit_of_strain = strain_unit(largest_of(strains.values()))
    strains = {name: values / unit_of_strain.factor for name, values in strains.items()}
    if strains:
        figures.append(_over("Median strain", "step", f"strain [{unit_of_strain.text}]", numbers, strains, breaks))
    if "force" in dataset and np.isfinite(dataset["force"].values).any():
        force, position = dataset["force"].values, dataset["position"].values / MILLI
        if np.isfinite(position).any():
            curve = {"force": force}
            # neither of the two is relative to a reference step
            figures.append(_over("Force over crosshead position", "position [mm]", "force [N]", position, curve, []))
        largest = max(strains, key=lambda name: _range(strains[name]), default=None)
        if largest is not None:
            title, label, values = "Force over strain", "force [N]", force
            if section is not None:
                title, label, values = "Stress over strain", "stress [MPa]", force / section / MEGA
            along = f"median {largest} [{unit_of_strain.text}]"
            figures.append(_over(title, along, label, strains[largest], {label: values}, breaks))
    signals = _signals(dataset)
    further = [name for name in signals if name not in ("force", "position")]
    for name in further:
        label, values = signals[name]
        figure = _over(name, "step", label, numbers, {name: values}, [])  # relative to no reference step
        if knows_sigma(dataset, name):
            sigma = dataset[sigma_name(name)].values / people_unit(dataset[name]).factor
            figure.data[0].error_y = {"type": "data", "array": sigma.tolist()}
        figures.append(figure)
    if further:
        choices = {"step": numbers.astype(float)} | dict(signals.values())
        choices |= {f"median {name} [{unit}]": values for name, values in moved.items()}
        choices |= {f"median {name} [{unit_of_strain.text}]": values for name, values in strains.items()}
        first = max(strains, key=lambda name: _range(strains[name]), default=None)
        x = "step" if first is None else f"median {first} [{unit_of_strain.text}]"
        figures.append(_of_choice(choices, x, signals[further[0]][0], breaks))
    return [figure for figure in figures if figure.data]


def _signals(dataset: xr.Dataset) -> dict[str, tuple[str, np.ndarray]]:
    """Return label and values over the steps of the signals that are known at any step, in the units of people."""
    found = {}
    for name in signal_names(dataset):
        unit = people_unit(dataset[name])
        values = np.asarray(dataset[name].values, float) / unit.factor
        if np.isfinite(values).any():
            found[name] = f"{name} [{unit.text}]", values
    return found


def _of_choice(choices: Mapping[str, np.ndarray], x: str, y: str, breaks: Sequence[int] | np.ndarray) -> go.Figure:
    """Return a chart of one quantity over another with a list for each axis, from which the reader chooses."""
    figure = _over("Any quantity over any other", x, y, choices[x], {y: choices[y]}, breaks)
    menus = []
    for axis, chosen, place in (("x", x, 0.0), ("y", y, 0.5)):
        buttons = [
            {
                "label": f"{axis}: {label}",
                "method": "update",
                "args": [{axis: [interrupt(values, breaks).tolist()]}, {f"{axis}axis.title.text": label}],
            }
            for label, values in choices.items()
        ]
        active = list(choices).index(chosen)
        menus.append(
            {"buttons": buttons, "active": active, "x": place, "y": 1.0, "xanchor": "left", "yanchor": "bottom"}
        )
    return figure.update_layout(updatemenus=menus, margin={**_LAYOUT["margin"], "t": 90})


def reference_changes(references: np.ndarray) -> np.ndarray:
    """Return the positions in values over the steps before which another reference step begins.

    A step without a result (-1) interrupts a curve already.
    """
    before, after = references[:-1], references[1:]
    return np.flatnonzero((before != after) & (before >= 0) & (after >= 0)) + 1


def interrupt(values: np.ndarray, breaks: Sequence[int] | np.ndarray) -> np.ndarray:
    """Return the values of a curve with NaN before each of the positions, at which its line is interrupted."""
    return np.insert(np.asarray(values, float), breaks, np.nan)


def comparison_charts(found: xr.Dataset, names: tuple[str, str]) -> list[go.Figure]:
    """Return mean strains of two experiments over the steps, and the force over them where it is known.

    Parameters
    ----------
    found
        From `fringedic.evaluation.compare_experiments`.
    names
        Of the two experiments.
    """
    strains = [name for name in found["quantity"].values.tolist() if name in _STRAINS]
    means = {name: (found["mean_one"].sel(quantity=name), found["mean_other"].sel(quantity=name)) for name in strains}
    figure = go.Figure(layout={**_LAYOUT, "title": "Mean strain over the common points"})
    for name, both in means.items():
        for label, values in zip(names, both, strict=True):
            figure.add_scatter(x=found["step"].values, y=values.values / MICRO, name=f"{name} {label}")
    figure.update_xaxes(title="step")
    figure.update_yaxes(title="strain [µstrain]")
    charts = [figure] if strains else []
    if strains and {"force_one", "force_other"} <= set(found.data_vars):
        figure = go.Figure(layout={**_LAYOUT, "title": "Force over mean strain"})
        for name, both in means.items():
            for label, values, force in zip(names, both, (found["force_one"], found["force_other"]), strict=True):
                figure.add_scatter(x=values.values / MICRO, y=force.values, name=f"{name} {label}")
        figure.update_xaxes(title="strain [µstrain]")
        figure.update_yaxes(title="force [N]")
        charts.append(figure)
    return charts


class SpecimenCurve(NamedTuple):
    """Axial strain of a specimen with its standard uncertainty [1], its load over the steps, and the load's label."""

    strain: np.ndarray
    sigma: np.ndarray
    load: np.ndarray
    label: str


def specimen_charts(title: str, curves: Mapping[str, SpecimenCurve]) -> list[go.Figure]:
    """Return the load over the strain of the specimens of a group, one chart for each kind of load.

    Parameters
    ----------
    title
        Of the charts.
    curves
        By the names of the specimens; those without a known load are left out.
    """
    charts: dict[str, go.Figure] = {}
    for name, curve in curves.items():
        if not np.isfinite(curve.load).any():
            continue
        layout = {"title": title, "xaxis_title": "mean axial strain [µstrain]", "yaxis_title": curve.label}
        chart = charts.setdefault(curve.label, go.Figure(layout={**_LAYOUT, **layout, "showlegend": True}))
        chart.add_scatter(
            x=(curve.strain / MICRO).tolist(),
            y=curve.load.tolist(),
            error_x={"type": "data", "array": (curve.sigma / MICRO).tolist()},
            mode="lines+markers",
            name=name,
        )
    return list(charts.values())


def extensometer_charts(
    dataset: xr.Dataset, gauges: Mapping[str, xr.Dataset], section: float | None
) -> list[go.Figure]:
    """Return the strain of virtual extensometers over the steps, and force or stress over it, as of `curve_charts`.

    Parameters
    ----------
    dataset
        The experiment.
    gauges
        From `fringedic.extensometer`, by name.
    section
        Area that carries the force [m²], None when it is not known.
    """
    if not gauges:
        return []
    unit = strain_unit(largest_of(each["strain"].values for each in gauges.values()))
    strains = {name: each["strain"].values / unit.factor for name, each in gauges.items()}
    numbers, breaks = dataset["step"].values, reference_changes(dataset["reference_step"].values)
    over_steps = _over("Virtual extensometers", "step", f"strain [{unit.text}]", numbers, strains, breaks)
    for trace, each in zip(over_steps.data, gauges.values(), strict=True):
        if "sigma_strain" in each:
            sigma = interrupt(each["sigma_strain"].values / unit.factor, breaks)
            trace.error_y = {"type": "data", "array": sigma.tolist()}
    figures = [over_steps]
    if "force" in dataset and np.isfinite(dataset["force"].values).any():
        force = dataset["force"].values
        title, label, load = "Force over their strain", "force [N]", force
        if section is not None:
            title, label, load = "Stress over their strain", "stress [MPa]", force / section / MEGA
        curves = go.Figure()
        for name, strain in strains.items():
            x, y = interrupt(strain, breaks).tolist(), interrupt(load, breaks).tolist()
            curves.add_trace(go.Scatter(x=x, y=y, mode="lines+markers", name=name))
        across = f"strain [{unit.text}]"
        layout = {"title": title, "xaxis_title": across, "yaxis_title": label, "hovermode": "closest"}
        figures.append(curves.update_layout(**_LAYOUT, **layout, showlegend=len(gauges) > 1))
    return figures


def _range(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.ptp(finite)) if finite.size else 0.0


def _medians(dataset: xr.Dataset, names: Iterable[str], unit: float) -> dict[str, np.ndarray]:
    """Return the median over all points of each step, in a unit; quantities that no step has are left out."""
    medians: dict[str, np.ndarray] = {}
    for name in names:
        if name not in dataset:
            continue
        values = np.full(dataset.sizes["step"], np.nan)
        for index in range(len(values)):
            values_of_step = dataset[name].isel(step=index).values
            if np.isfinite(values_of_step).any():
                values[index] = np.nanmedian(values_of_step) / unit
        if np.isfinite(values).any():
            medians[name] = values
    return medians


def _over(
    title: str, across: str, up: str, x: np.ndarray, curves: dict[str, np.ndarray], breaks: Sequence[int] | np.ndarray
) -> go.Figure:
    figure = go.Figure()
    at = interrupt(x, breaks).tolist()
    for name, values in curves.items():
        figure.add_trace(go.Scatter(x=at, y=interrupt(values, breaks).tolist(), mode="lines+markers", name=name))
    figure.update_layout(
        **_LAYOUT, title=title, xaxis_title=across, yaxis_title=up, showlegend=len(curves) > 1, hovermode="closest"
    )
    return figure


def _thin(values: np.ndarray, points: int) -> np.ndarray:
    thin = max(1, -(-max(values.shape) // points))
    return values[thin // 2 :: thin, thin // 2 :: thin]


def _filled(positions: np.ndarray) -> np.ndarray:
    """Return positions without gaps, as the chart needs them; points without z are not drawn."""
    finite = positions[np.isfinite(positions)]
    return _short(np.where(np.isfinite(positions), positions, finite.mean()), 4)


def _short(values: np.ndarray, digits: int) -> np.ndarray:
    return np.round(values.astype(np.float32), digits)
