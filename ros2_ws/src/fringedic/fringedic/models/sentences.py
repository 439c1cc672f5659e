"""Sentences about a comparison with a model or a nominal shape."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import xarray as xr

from fringedic.wording.numbers import number_text


def shape_sentences(comparison: xr.Dataset) -> list[str]:
    """Return how many points agree with the nominal shape, and the range of the deviation beside that of noise."""
    step = comparison.isel(step=0)
    spread, noise = deviation_text(step["peak_to_valley"]), deviation_text(step["noise_peak_to_valley"])
    return [
        f"{100 * float(step['within_2_sigma']):.1f} % of {int(step['points'])} points are within 2 sigma of the "
        f"nominal shape (95 % expected of noise); RMS deviation {deviation_text(step['rms_difference'])}, of which "
        f"{deviation_text(step['systematic'])} exceed the noise",
        f"The deviation ranges over {spread} ± {deviation_text(2 * step['sigma_peak_to_valley'])} (95 %; the flatness, "
        f"if the nominal shape is a plane); noise alone would give {noise}.",
    ]


def deviation_text(value: xr.DataArray) -> str:
    """Return a deviation [m] in micrometres."""
    return f"{number_text(1e6 * float(value))} µm"


def agreement_sentences(step: xr.Dataset) -> list[str]:
    """Return a sentence for each quantity of a step, how many points agree and the factor, and one of the shift."""
    sentences = []
    for name in step["quantity"].values.tolist():
        found = step.sel(quantity=name)
        factor, sigma = float(found["factor"]), float(found["sigma_factor"])
        sentences.append(
            f"{name}: {100 * float(found['within_2_sigma']):.1f} % of {int(found['points'])} points within 2 sigma "
            f"(95 % expected of noise); the model times {factor:.4f} ± {2 * sigma:.4f} (95 %) fits best"
        )
    return [*sentences, *_shift_sentences(step), *_rigid_sentences(step)]


def left_out_sentences(comparison: xr.Dataset) -> list[str]:
    """Return which steps are not compared because the model has no result at their load."""
    left_out = json.loads(comparison.attrs.get("left_out", "{}"))
    if not left_out.get("steps"):
        return []
    first, last = left_out["model"]
    steps = ", ".join(f"{step} ({load:g})" for step, load in left_out["steps"].items())
    return [
        f"The model has results between the loads {first:g} and {last:g}; left out are the steps beyond, each with its "
        f"load: {steps}. Compute further load steps to compare them."
    ]


def _rigid_sentences(step: xr.Dataset) -> list[str]:
    """Return the rigid motion of the specimen beside the model."""
    found = [
        f"{number_text(scale * float(step[name]), 3)} {unit} {way} {axis}"
        for kind, scale, unit, way in (("translation", 1e3, "mm", "along"), ("rotation", 180 / np.pi, "°", "about"))
        for axis in "xyz"
        if np.isfinite(step[name := f"rigid_{kind}_{axis}"])
    ]
    if step.attrs.get("rigid_motion") == "removed":
        return [f"A rigid motion was removed from the measured displacement: {', '.join(found)}."]
    return [
        f"The difference contains a rigid motion of the specimen: {', '.join(found)}; --remove-rigid-motion "
        "(remove_rigid_motion) removes it."
    ]


def _shift_sentences(step: xr.Dataset) -> list[str]:
    """Return by how much the features of the model have to be moved along the surface, where that is determined."""
    found = [
        f"{number_text(1e3 * float(step[f'shift_{axis}']))} ± "
        f"{number_text(2e3 * float(step[f'sigma_shift_{axis}']))} mm along {axis}"
        for axis in "xy"
        if np.isfinite(step[f"shift_{axis}"])
    ]
    if not found:
        return []
    return [
        f"The displacement fits best with the model shifted by {' and '.join(found)} (95 %, without the uncertainty of "
        "the alignment)."
    ]


def placement_sentences(comparison: xr.Dataset) -> list[str]:
    """Return how well the model is aligned, and what its shape does not determine."""
    placement: dict[str, Any] = json.loads(comparison.attrs["placement"])
    shift = ", ".join(number_text(1e6 * each) for each in placement["sigma_translation"])
    turn = ", ".join(number_text(1e3 * each) for each in placement["sigma_rotation"])
    sentences = [
        f"Alignment: {placement['points']} points, residual {number_text(1e6 * placement['residual'])} µm; standard "
        f"uncertainty of the translation {shift} µm along x, y, z, of the rotation {turn} mrad about them."
    ]
    if placement["alternatives"]:
        sentences.append(
            f"{placement['alternatives']} other orientations by principal axes fit the surface as well: check the "
            "orientation in the maps, or give point pairs."
        )
    if placement["free"] is not None:
        free = placement["free"]
        directions = [f"translation along {_vector(each)}" for each in free["translations"]]
        directions += [f"rotation about {_vector(each)}" for each in free["rotations"]]
        sentences.append(
            f"The shape is {free['shape']} and does not determine the {' and the '.join(directions)}; "
            + (
                f"{placement['undetermined']} of these count as exact: give holes, edges or point pairs."
                if placement["undetermined"]
                else "features of the surface or the displacement determine them."
            )
        )
    return sentences


def _vector(direction: list[float]) -> str:
    return f"({', '.join(f'{each:.2f}' for each in direction)})"
