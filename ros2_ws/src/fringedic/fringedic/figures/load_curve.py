"""Agreement with a model at every load: the factor on the model and the differences over their uncertainty."""

from __future__ import annotations

import xarray as xr

from fringedic.datasets.quantities import PeopleUnit, people_unit
from fringedic.wording.optional_packages import optional_import

with optional_import("figures"):
    from matplotlib.figure import Figure


def load_curve_figure(comparison: xr.Dataset) -> Figure:
    """Draw factor (95 % intervals) and RMS difference over sigma of every quantity against the load.

    Parameters
    ----------
    comparison
        From `fringedic.compare_model`.
    """
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    load = comparison.attrs.get("load", "force")
    unit = people_unit(comparison[load]) if load in comparison else PeopleUnit("N", "N", 1.0)
    loads = comparison["load_of_model"].values / unit.factor
    for name in comparison["quantity"].values.tolist():
        found = comparison.sel(quantity=name)
        left.errorbar(loads, found["factor"], yerr=2 * found["sigma_factor"], marker="o", capsize=3, label=name)
        right.plot(loads, found["normalized_rms"], marker="o", label=name)
    left.axhline(1.0, color="grey", linewidth=0.8)
    right.axhline(1.0, color="grey", linewidth=0.8)
    for axes, label in ((left, "factor on the model"), (right, "RMS difference over sigma")):
        axes.set(xlabel=f"{load} [{unit.text}]", ylabel=label)
    right.set_yscale("log")
    figure.legend(*right.get_legend_handles_labels(), fontsize="small", loc="outside right upper")
    return figure
