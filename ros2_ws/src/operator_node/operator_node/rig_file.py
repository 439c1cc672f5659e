"""What the page shows of the rig file: programme, region, calibration; read again after each change."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from fringedic.calibration.sentences import in_force_words
from fringedic.configuration.programme import Programme
from fringedic.configuration.rig_file import RigFile, load_rig_file
from fringedic.configuration.sections import VIRTUAL_RIG
from fringedic.errors import FringedicError
from fringedic.frames.region import Region
from fringedic.wording.yaml_text import InvalidYamlError, load_yaml

MOST_ROWS = 1000  # of the programme table


class ShownRigFile:
    """Programme, region and calibration of a rig file, as plain values.

    Parameters
    ----------
    path
        The rig file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._changed = -1
        self._shown: dict[str, Any] = {}

    def shown(self) -> dict[str, Any]:
        """Return the present content."""
        try:
            changed = self._path.stat().st_mtime_ns
        except OSError:
            changed = 0
        if changed != self._changed:
            self._changed, self._shown = changed, self._read()
        return self._shown

    def _read(self) -> dict[str, Any]:
        shown: dict[str, Any] = {"file": self._path.name, "file_error": "", "programme": [], "region": []}
        try:
            rig = load_rig_file(self._path)
            shown |= {"load_frame": rig.load_frame is not None, "stage": rig.virtual_rig is not None}
            shown |= {"programme": _rows(rig.programme), "calibration": self._calibration(rig)}
            if rig.region_file is not None:
                region = Region.load(rig.region_file)
                shown["region"] = [{"points": each.points, "hole": each.hole} for each in region.polygons]
        except FringedicError as error:
            shown["file_error"] = str(error)
        return shown

    def _calibration(self, rig: RigFile) -> list[str]:
        if rig.calibration is None:
            return ["none: only the displacement in the image is measured"]
        if (file := rig.calibration_file) is not None:
            return in_force_words(file, datetime.now(UTC))
        return ["the values of the virtual rig" if rig.calibration == VIRTUAL_RIG else "values in the rig file"]


def programme_rows(text: str) -> list[dict[str, Any]]:
    """Return the steps of a programme in YAML; none of an empty text, or of a wrong one, which is refused later."""
    try:
        return _rows(Programme.model_validate(load_yaml(text)))
    except (ValueError, InvalidYamlError):
        return []


def _rows(programme: Programme | None) -> list[dict[str, Any]]:
    names = ("position_mm", "speed_mm_per_s", "hold_s", "mode", "set_reference")
    steps = [] if programme is None else programme.load_steps()[:MOST_ROWS]
    return [{name: getattr(step, name) for name in names} for step in steps]
