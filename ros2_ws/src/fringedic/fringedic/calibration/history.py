"""Checks of a calibration, kept beside its files; reports of later experiments contain the latest."""

from __future__ import annotations

import math
import os
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import yaml
from pydantic import ValidationError

from fringedic.errors import CalibrationError
from fringedic.evidence.changes import noted
from fringedic.metadata import CheckMetadata
from fringedic.wording.sealed_yaml import sealed, unsealed
from fringedic.wording.yaml_text import load_yaml

if TYPE_CHECKING:
    from fringedic.calibration.check import RigCheck

CHECKS_FILE = "calibration_checks.yaml"
_UM, _MM, _FRINGE = 1e6, 1e3, 2 * math.pi


def record_check(folder: str | Path, check: RigCheck, when: datetime, *, verdict: str) -> CheckMetadata:
    """Add a check to those of the calibration in a folder, in ``calibration_checks.yaml``.

    Parameters
    ----------
    folder
        Of the calibration's files.
    check, when
        The check and its time.
    verdict
        Its result in words, stored for people; `fringedic.calibration.sentences.check_in_words`.

    Raises
    ------
    CalibrationError
        The existing file does not contain checks.
    OSError
        The folder cannot be written.
    """
    metadata = CheckMetadata(
        created=when.isoformat(timespec="seconds"),
        holds=check.holds,
        verdict=verdict,
        flatness_um=_known(_UM * check.flatness),
        noise_um=_known(_UM * check.noise),
        expected_mm=_known(_MM * check.expected),
        distance_mm=_known(_MM * check.distance),
        drift_um=_known(_UM * check.drift),
        response_fringe=_known(check.response / _FRINGE),
    )
    entries = [each.model_dump(exclude_defaults=True) for each in [*recorded_checks(folder), metadata]]
    file = Path(folder) / CHECKS_FILE
    written = file.with_suffix(".part")
    text = yaml.safe_dump(sealed({"checks": entries}), sort_keys=False, allow_unicode=True, width=120)
    with noted(file, "check of the calibration"):
        written.write_text(text, encoding="utf-8")
        os.replace(written, file)
    return metadata


def recorded_checks(folder: str | Path) -> list[CheckMetadata]:
    """Return the checks of the calibration in a folder, the oldest first; none when it was never checked.

    Raises
    ------
    CalibrationError
        The existing file does not contain checks.
    """
    file = Path(folder) / CHECKS_FILE
    try:
        content, _ = unsealed(load_yaml(file.read_text(encoding="utf-8")) or [], str(file))
        entries = content["checks"] if isinstance(content, dict) else content  # a list in earlier versions
        return [CheckMetadata.model_validate(each) for each in entries]
    except FileNotFoundError:
        return []
    except (OSError, yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError, ValidationError) as error:
        raise CalibrationError(f"{file} does not contain checks of a calibration: {error}") from error


def _known(value: float) -> float | None:
    """Return a number with six digits, None for NaN."""
    return None if math.isnan(value) else float(f"{value:.6g}")
