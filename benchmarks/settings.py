"""Declarations of each setting: fields that a section of a rig file and a node declare twice, and files of a driver.

A field of a section counts as declared again when a node has it, or a parameter of the same meaning, from another
declaration.
"""

from __future__ import annotations

import inspect
import subprocess
from pathlib import Path

from pydantic import BaseModel
from rich.console import Console
from rich.table import Table

from fringedic.configuration.sections import ExtensometerSection, RecordingSection
from fringedic.settings.camera import CAMERAS, CameraNodeSettings
from fringedic.settings.devices import Devices
from fringedic.settings.experiment import ExperimentNodeSettings, SequenceSettings
from fringedic.settings.extensometer import ExtensometerNodeSettings
from fringedic.settings.load_frame import LOAD_FRAMES, LoadFrameNodeSettings
from fringedic.settings.projector import PROJECTORS, ProjectorNodeSettings
from fringedic.settings.recorder import RecorderNodeSettings

ROOT = Path(__file__).parents[1]
# Parameters of another name that mean the same as a key of a section
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
_DEVICES: dict[str, Devices] = {"camera": CAMERAS, "projector": PROJECTORS, "load_frame": LOAD_FRAMES}
_SECTIONS: dict[str, tuple[tuple[type[BaseModel], ...], tuple[type[BaseModel], ...]]] = {
    "camera": (tuple(CAMERAS.own.values()), (CameraNodeSettings,)),
    "projector": (tuple(PROJECTORS.own.values()), (ProjectorNodeSettings,)),
    "sequence": ((SequenceSettings,), (ExperimentNodeSettings,)),
    "load_frame": (tuple(LOAD_FRAMES.own.values()), (LoadFrameNodeSettings, ExperimentNodeSettings)),
    "extensometer": ((ExtensometerSection,), (ExtensometerNodeSettings,)),
    "recording": ((RecordingSection,), (RecorderNodeSettings,)),
}


def declaring(model: type[BaseModel], name: str) -> type | None:
    """Return the class that declares a field of a model; None when the model does not have it."""
    return next((each for each in model.__mro__ if name in inspect.get_annotations(each)), None)


def declared_again(sections: tuple[type[BaseModel], ...], nodes: tuple[type[BaseModel], ...]) -> list[str]:
    """Return the fields of a section that its nodes do not take from a declaration of the section."""
    ours = {each for section in sections for each in section.__mro__}
    again = []
    for name in dict.fromkeys(name for section in sections for name in section.model_fields):
        theirs = {declaring(node, each) for node in nodes for each in (name, _SAME.get(name, name))} - {None}
        if theirs - ours:
            again.append(name)
    return again


def files_of_a_source(model: type[BaseModel]) -> list[str]:
    """Return the files of the product that name the model of a source."""
    found = subprocess.run(
        ["git", "grep", "-l", "-w", model.__name__, "--", "ros2_ws/src/*.py"],
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
    total = [0, 0]
    for name, (sections, nodes) in _SECTIONS.items():
        fields = {field for section in sections for field in section.model_fields}
        again = declared_again(sections, nodes)
        table.add_row(name, str(len(fields)), str(len(again)), ", ".join(again))
        total = [total[0] + len(fields), total[1] + len(again)]
    table.add_row("all", *map(str, total), "target 0")
    console.print(table)
    files = Table("device", "source", "files", "names", title="Files of the product that name the model (target 2)")
    for device, kinds in _DEVICES.items():
        for source, model in kinds.own.items():
            names = files_of_a_source(model)
            files.add_row(device, source, str(len(names)), ", ".join(Path(name).name for name in names))
    console.print(files)


if __name__ == "__main__":
    main()
