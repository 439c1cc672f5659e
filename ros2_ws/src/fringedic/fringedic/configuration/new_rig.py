"""A first rig file from a few answers."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from fringedic.configuration.rig_file import RigFile
from fringedic.configuration.yaml_section import validate
from fringedic.errors import ConfigurationError

_HEAD = """\
# Rig file of fringedic, lengths in mm and times in ms. The next commands, in their order:
#   fringedic live {name}        focus, exposure and speckle size
#   fringedic timing {name}      exposure and settle time for this projector
#   fringedic calibrate {name}   lens and rig, with a GO or NO-GO
#   fringedic run {name}         the programme
# fringedic plan {name} predicts uncertainties: replace the values of plan by those of the data sheets first.
"""
_ADDRESS = {"aravis": "camera", "v4l2": "camera", "files": "files", "video": "files", "topic": "topic"}  # its key
_PLAN = {
    "camera_pixel_um": 3.45,
    "focal_length_mm": 25.0,
    "camera_distance_mm": 450.0,
    "throw_ratio": 1.4,
    "projector_distance_mm": 450.0,
    "angle_degree": 25.0,
    "speckle_um": 250.0,
}
_NOT_IN_EXPERIMENTS = re.compile(r"[^A-Za-z0-9_-]+")


class Answers(NamedTuple):
    """What a person has to say about a rig; sizes are texts such as 1280x960."""

    camera: str
    address: str
    image_size: str
    display: int
    projector_size: str
    grid_pitch_mm: float
    operator: str


def write_rig_file(file: Path, answers: Answers) -> None:
    """Write a rig file for a camera and a display as projector, after a check of all its keys.

    Raises
    ------
    ConfigurationError
        An answer is not possible; the message names it and says what is.
    OSError
        The file cannot be written.
    """
    width, height = _size("image size", answers.image_size)
    columns, rows = _size("projector size", answers.projector_size)
    virtual = answers.camera == "virtual"
    size = {} if virtual else {"width": width, "height": height}
    address = {_ADDRESS[answers.camera]: answers.address} if answers.address and not virtual else {}
    display = {"source": "display", "display": answers.display, "width": columns, "height": rows}
    content: dict[str, Any] = {
        "camera": {"source": answers.camera, **address, **size},
        "projector": {"source": "virtual"} if virtual else display,
        **({"virtual_rig": {"preset": "plate"}, "calibration": "virtual_rig"} if virtual else {}),
        "sequence": {"shifts": 4},
        "plan": dict(_PLAN),
        "reference_plane": {"grid_pitch_mm": answers.grid_pitch_mm, "angles_degree": [0, -15, -10, -5, 5, 10, 15]},
        "specimen": {"name": file.stem, "operator": answers.operator},
        "programme": {
            "experiment": _NOT_IN_EXPERIMENTS.sub("-", file.stem).strip("-") or "experiment",
            "steps": [{}, {}, {}],
        },
    }
    content["reference_plane"]["held_out"] = [6]
    validate(RigFile, content, str(file))
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, default_flow_style=None)
    file.write_text(_HEAD.format(name=file) + text, encoding="utf-8")


def _size(name: str, text: str) -> tuple[int, int]:
    found = re.fullmatch(r"\s*(\d+)\s*[x×*]\s*(\d+)\s*", text)
    if found is None:
        raise ConfigurationError(f"{name} {text}: give width and height in px, such as 1280x960")
    return int(found[1]), int(found[2])
