"""The page of a comparison with a model: one HTML file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from fringedic.datasets.quantities import people_unit
from fringedic.figures.load_curve import load_curve_figure
from fringedic.figures.maps import maps_figure
from fringedic.figures.panels import Panel, panel_of
from fringedic.models.sentences import (
    agreement_sentences,
    deviation_text,
    left_out_sentences,
    placement_sentences,
    shape_sentences,
)
from fringedic.report.templates import base64_png, render_page, require_new, write_page
from fringedic.wording.numbers import number_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = (
    "step",
    "load",
    "quantity",
    "points",
    "RMS difference",
    "its uncertainty",
    "within 2 sigma [%]",
    "RMS over sigma",
    "systematic",
    "largest region [points]",
    "factor on the model",
)

_NOTE = (
    "The uncertainty is that of the measurement and of the alignment together. RMS over sigma: 1 for noise alone. "
    "Systematic: the part of the RMS difference beyond its uncertainty. Largest region: connected points whose "
    "difference exceeds 2 sigma with one sign. The factor is that on the model's map with the least squared "
    "difference, ± one standard uncertainty."
)
_SHAPE_NOTE = (
    "The deviation is positive outside the nominal shape. Its uncertainty contains the noise of the height and the "
    "alignment, not the systematic errors of the calibration."
)
_SHAPE_COLUMNS = {
    "rms_difference": "RMS deviation",
    "rms_sigma": "its uncertainty",
    "systematic": "systematic",
    "mean_error": "mean of nominal minus measured",
    "peak_to_valley": "peak to valley",
    "sigma_peak_to_valley": "its uncertainty",
    "noise_peak_to_valley": "peak to valley of noise",
}


def write_model_comparison(comparison: xr.Dataset, output: Path, *, overwrite: bool = False) -> Path:
    """Write the page of a comparison: a table of every step, maps of the last one, the placement of the model.

    Parameters
    ----------
    comparison
        From `fringedic.compare_model`.
    output
        HTML file.
    overwrite
        Replace an existing file.

    Raises
    ------
    DatasetError
        The file exists already or cannot be written.
    FringedicError
        A package of the extra ``report`` is not installed.
    """
    require_new(output, overwrite)
    last = comparison.isel(step=-1)
    page = _page(
        comparison,
        [*left_out_sentences(comparison), *agreement_sentences(last)],
        columns=COLUMNS,
        rows=[row for step in comparison["step"].values for row in _rows(comparison.sel(step=step))],
        shown=int(last["step"]),
        note=_NOTE,
        curve=base64_png(load_curve_figure(comparison)) if comparison.sizes["step"] > 1 else "",
        maps={name: base64_png(_maps(last, name)) for name in comparison["quantity"].values.tolist()},
    )
    return write_page(page, output)


def write_shape_comparison(comparison: xr.Dataset, output: Path, *, overwrite: bool = False) -> Path:
    """Write the page of a shape beside a nominal one: figures, maps of the deviation, the placement of the model.

    Parameters
    ----------
    comparison
        From `fringedic.models.compare_shape`.
    output, overwrite
        As in `write_model_comparison`.

    Raises
    ------
    DatasetError
        The file exists already or cannot be written.
    FringedicError
        A package of the extra ``report`` is not installed.
    """
    require_new(output, overwrite)
    step = comparison.isel(step=0)
    panels = (
        Panel("deviation", "deviation along the normal", symmetric=True),
        Panel("sigma_deviation", "its standard uncertainty"),
        Panel("normalized_deviation", "deviation over its uncertainty", symmetric=True),
    )
    lengths = {name: deviation_text(step[name]) for name in _SHAPE_COLUMNS}
    page = _page(
        comparison,
        shape_sentences(comparison),
        columns=list(_SHAPE_COLUMNS.values()),
        rows=[list(lengths.values())],
        shown=int(step["step"]),
        note=_SHAPE_NOTE,
        curve="",
        maps={"the deviation": base64_png(maps_figure(step, panels, title=f"step {int(step['step'])}"))},
    )
    return write_page(page, output)


def _page(comparison: xr.Dataset, sentences: list[str], **content: Any) -> str:
    return render_page(
        "model_comparison.html.j2",
        title=f"{comparison.attrs.get('experiment', 'experiment')} and {comparison.attrs['model']}",
        sentences=[*sentences, *placement_sentences(comparison)],
        **content,
    )


def _rows(step: xr.Dataset) -> list[list[str]]:
    rows = []
    for name in step["quantity"].values.tolist():
        found, unit = step.sel(quantity=name), people_unit(step[name])
        rms, sigma, systematic = (
            f"{number_text(float(found[each]) / unit.factor)} {unit.text}"
            for each in ("rms_difference", "rms_sigma", "systematic")
        )
        rows.append(
            [
                str(int(step["step"])),
                number_text(float(step["load_of_model"])),
                name,
                str(int(found["points"])),
                rms,
                sigma,
                f"{100 * float(found['within_2_sigma']):.1f}",
                f"{float(found['normalized_rms']):.2f}",
                systematic,
                str(int(found["largest_region"])),
                f"{float(found['factor']):.4f} ± {float(found['sigma_factor']):.4f}",
            ]
        )
    return rows


def _maps(step: xr.Dataset, name: str) -> Figure:
    title = panel_of(name).title
    panels = (
        Panel(name, f"measured {title}", like=f"model_{name}"),
        Panel(f"model_{name}", "model, filtered as the measurement", like=name),
        Panel(f"difference_{name}", "measured minus model", symmetric=True),
        Panel(f"normalized_{name}", "difference over its uncertainty", symmetric=True),
    )
    return maps_figure(step, panels, title=f"step {int(step['step'])}, {name}")
