"""Declarations of each setting: keys of a rig file that a node declares again, and files that a camera driver touches.

A field counts as declared again when the node of its section has a parameter of the same meaning in a model of its own.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

from pydantic import BaseModel
from rich.console import Console
from rich.table import Table

from dic_node.extensometer_node import ExtensometerParameters
from experiment_node.experiment_parameters import ExperimentParameters
from fringe_projector_node.projector_node import ProjectorParameters
from fringedic.configuration.sections import (
    ExtensometerSection,
    LoadFrameSection,
    ProjectorSection,
    RecordingSection,
    SequenceSection,
)
from fringedic.settings.camera import CAMERAS, CameraNodeSettings
from load_frame_node.parameters import LoadFrameParameters
from recorder_node.recorder_node import RecorderParameters

ROOT = Path(__file__).parents[1]
# Parameters of another name, or on another node, that mean the same as a key of the section
_SAME = {
    "exposures_ms": "exposure_times_s",
    "file": "machine_file",
    "first_px": "first_column_px",
    "height": "height_px",
    "largest_sigma_ustrain": "largest_sigma",
    "response_curve": "response_file",
    "second_px": "second_column_px",
    "source": "screen",
    "split_minutes": "split_s",
    "subset_px": "pad_px",
    "width": "width_px",
}
_SECTIONS: dict[str, tuple[type[BaseModel], tuple[type[BaseModel], ...]]] = {
    "projector": (ProjectorSection, (ProjectorParameters,)),
    "sequence": (SequenceSection, (ExperimentParameters,)),
    "load_frame": (LoadFrameSection, (LoadFrameParameters, ExperimentParameters)),
    "extensometer": (ExtensometerSection, (ExtensometerParameters,)),
    "recording": (RecordingSection, (RecorderParameters,)),
}


def declared_again(section: type[BaseModel], nodes: tuple[type[BaseModel], ...]) -> list[str]:
    """Return the fields of a section that the models of its nodes declare again."""
    parameters = {name for node in nodes for name in node.model_fields}
    return [name for name in section.model_fields if {name, _SAME.get(name, name)} & parameters]


def files_of_a_source(source: str) -> list[str]:
    """Return the files of the product that name the model of a source of a camera."""
    found = subprocess.run(
        ["git", "grep", "-l", "-w", CAMERAS.own[source].__name__, "--", "ros2_ws/src/*.py"],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return [name for name in found.stdout.split() if "/test/" not in name]


def main() -> None:
    """Print both tables."""
    console = Console(markup=False)
    table = Table("section", "fields", "declared again", "which", title="Settings that a node declares again")
    camera = {name for model in CAMERAS.own.values() for name in model.model_fields}
    own = [name for name in CameraNodeSettings.model_fields if name in camera]
    table.add_row("camera", str(len(camera)), str(len(own)), ", ".join(own))
    total = [len(camera), len(own)]
    for name, (section, nodes) in _SECTIONS.items():
        again = declared_again(section, nodes)
        table.add_row(name, str(len(section.model_fields)), str(len(again)), ", ".join(again))
        total = [total[0] + len(section.model_fields), total[1] + len(again)]
    table.add_row("all", *map(str, total), "target 0")
    console.print(table)
    files = Table("source", "files", "names", title="Files of the product that name the model of a camera (target 2)")
    for source in CAMERAS.own:
        names = files_of_a_source(source)
        files.add_row(source, str(len(names)), ", ".join(Path(name).name for name in names))
    console.print(files)


if __name__ == "__main__":
    main()
