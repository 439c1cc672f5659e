"""The figures of a calibration as a YAML file for people: mm, µm and degree, with the unit in every name."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from fringedic.calibration.findings import CalibrationWarning, ImageProblem
from fringedic.calibration.fit_results import Candidate, FitResult, Parameter, PlaneResult
from fringedic.calibration.variants import ModelVariant
from fringedic.camera.findings import Finding, GridFinding
from fringedic.patterns.pattern import Orientation
from fringedic.rig.geometry import current_model_name
from fringedic.wording.sealed_yaml import EDITED_WORDS, sealed, unsealed
from fringedic.wording.yaml_text import load_yaml

_VERSION = 2  # 1: verdict, warnings and problems were sentences
_MICRO, _MILLI = 1e-6, 1e-3
_FRINGE = 2 * math.pi
_CODES = {str(code): code for kind in (GridFinding, CalibrationWarning, ImageProblem) for code in kind}

# Fields in units of people: name in the file, and unit in SI.
_PLANE_UNITS: dict[str, tuple[str, float]] = {
    "angle": ("angle_degree", math.radians(1)),
    "height": ("height_mm", _MILLI),
    "residual_phase": ("residual_fringe", _FRINGE),
    "predicted_phase": ("predicted_fringe", _FRINGE),
    "residual": ("residual_um", _MICRO),
    "predicted": ("predicted_um", _MICRO),
    "systematic": ("systematic_um", _MICRO),
    "systematic_noise": ("systematic_noise_um", _MICRO),
    "ripple": ("ripple_fringe", _FRINGE),
}
_CANDIDATE_UNITS: dict[str, tuple[str, float]] = {"systematic": ("systematic_um", _MICRO)}
_FIT_UNITS: dict[str, tuple[str, float]] = {
    "pitch": ("pitch_px", 1.0),
    "residual": ("residual_um", _MICRO),
    "predicted": ("predicted_um", _MICRO),
    "systematic": ("systematic_um", _MICRO),
    "held_out": ("held_out_um", _MICRO),
    "height_sigma": ("height_sigma_um", _MICRO),
    "principal_effect": ("principal_effect_um", _MICRO),
}


def write_fit(fit: FitResult, path: Path, residual_map_sha256: str) -> None:
    """Write the figures of a calibration, and the hash of the file with its map of residuals, without its model."""
    content = {
        "version": _VERSION,
        "created": fit.created.isoformat(),
        "verdict": str(fit.verdict),
        "reason": str(fit.reason),
        "summary": fit.summary,
        "chosen": fit.chosen,
        "variant": str(fit.variant),
        "chi_square": fit.chi_square,
        "warnings": [_finding_to_people(each) for each in fit.warnings],
        "orientation": fit.orientation.name.lower(),
        **{people: _round(getattr(fit, name) / unit) for name, (people, unit) in _FIT_UNITS.items()},
        "planes": [_to_people(plane, _PLANE_UNITS) for plane in fit.planes],
        "candidates": [_to_people(each, _CANDIDATE_UNITS) for each in fit.candidates],
        "parameters": [_to_people(each, {}) for each in fit.parameters],
        "correlation": fit.correlation.tolist(),
        "residual_map_sha256": residual_map_sha256,
    }
    path.write_text(yaml.safe_dump(sealed(content), sort_keys=False, allow_unicode=True), encoding="utf-8")


def read_fit(path: Path) -> tuple[dict[str, Any], str | None]:
    """Return the fields of the `FitResult` that `write_fit` wrote, and the hash of the file of its residuals.

    In files of older versions the hash is missing.

    Raises
    ------
    OSError
        The file cannot be read.
    KeyError, TypeError, ValueError, yaml.YAMLError
        The content is not that of such a file, or of a newer version.
    """
    content, edited = unsealed(load_yaml(path.read_text(encoding="utf-8")), str(path))
    if content["version"] > _VERSION:
        raise ValueError(f"version {content['version']} is newer than this program")
    if content["version"] == 1:
        # A file of version 1 contains sentences, which are kept as text.
        candidates = [{**each, "name": current_model_name(each["name"])} for each in content["candidates"]]
        content = {
            **content,
            "summary": content["verdict"],
            "variant": min(candidates, key=lambda each: abs(each["criterion"]))["name"],
            "warnings": [{"code": CalibrationWarning.TEXT, "subject": each} for each in content["warnings"]],
            "candidates": candidates,
            "planes": [
                {
                    **each,
                    "problem": {"code": ImageProblem.TEXT, "subject": each["problem"]} if each["problem"] else None,
                }
                for each in content["planes"]
            ],
        }
    fields = {
        **{name: content[people] * unit for name, (people, unit) in _FIT_UNITS.items()},
        "summary": f"{EDITED_WORDS}: {content['summary']}" if edited else content["summary"],
        "variant": ModelVariant(content["variant"]),
        "chi_square": content["chi_square"],
        "orientation": Orientation[content["orientation"].upper()],
        "warnings": tuple(_finding_from_people(each) for each in content["warnings"]),
        "planes": tuple(PlaneResult(**_plane_values(each)) for each in content["planes"]),
        "candidates": tuple(
            Candidate(**{**_from_people(each, Candidate, _CANDIDATE_UNITS), "name": ModelVariant(each["name"])})
            for each in content["candidates"]
        ),
        "parameters": tuple(Parameter(**each) for each in content["parameters"]),
        "correlation": np.array(content["correlation"], float),
        "created": datetime.fromisoformat(content["created"]),
    }
    return fields, content.get("residual_map_sha256")


def _plane_values(content: Mapping[str, Any]) -> dict[str, Any]:
    values = _from_people(content, PlaneResult, _PLANE_UNITS)
    return {**values, "problem": None if content["problem"] is None else _finding_from_people(content["problem"])}


def _finding_to_people(finding: Finding) -> dict[str, Any]:
    content = {"code": str(finding.code), "subject": finding.subject, "values_si": dict(finding.values)}
    return {name: value for name, value in content.items() if value}


def _finding_from_people(content: Mapping[str, Any]) -> Finding:
    return Finding(_CODES[content["code"]], content.get("subject", ""), content.get("values_si", {}))


def _to_people(value: Any, units: Mapping[str, tuple[str, float]]) -> dict[str, Any]:
    result = {}
    for field in dataclasses.fields(value):
        name, unit = units.get(field.name, (field.name, None))
        content = getattr(value, field.name)
        if unit is not None:
            content = (
                [_round(each / unit) for each in content] if isinstance(content, tuple) else _round(content / unit)
            )
        elif isinstance(content, ModelVariant):
            content = str(content)
        elif isinstance(content, Finding):
            content = _finding_to_people(content)
        result[name] = content
    return result


def _from_people(content: Mapping[str, Any], kind: type, units: Mapping[str, tuple[str, float]]) -> dict[str, Any]:
    values = {}
    for field in dataclasses.fields(kind):
        name, unit = units.get(field.name, (field.name, None))
        value = content[name]
        if unit is not None:
            value = tuple(each * unit for each in value) if isinstance(value, Sequence) else value * unit
        values[field.name] = value
    return values


def _round(value: float) -> float:
    """Return the number that people expect: 15 degree, not 15.000000000000002."""
    return float(f"{value:.13g}")
