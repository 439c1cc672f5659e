"""Export of a dataset in several formats: a format that fails is reported, the others are written."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import xarray as xr

from fringedic.datasets.attributes import file_stem, first_time
from fringedic.datasets.quantities import TIME_ZERO
from fringedic.errors import DatasetError, ExportError, FringedicError
from fringedic.evidence.changes import noted
from fringedic.export import r3xa, surfaces, tables
from fringedic.figures.animation import save_animation
from fringedic.figures.maps import save_pictures
from fringedic.figures.panels import ANIMATED
from fringedic.wording.arguments import check_arguments, optional, path, several, text, whole
from fringedic.wording.arguments import dataset as dataset_of
from fringedic.wording.causes import cause_of


class _Format(NamedTuple):
    """The function that writes a format, and the ending of its name after that of the experiment."""

    write: Callable[[xr.Dataset, Path], list[str]]
    ending: str


def _write_png(dataset: xr.Dataset, folder: Path) -> list[str]:
    if not save_pictures(dataset, folder):
        raise ExportError("no step has a map to show")
    return []


def _write_gif(dataset: xr.Dataset, folder: Path) -> list[str]:
    folder.mkdir(parents=True)
    absent = []
    for panel in ANIMATED:
        try:
            save_animation(dataset, folder / f"{panel.name}.gif", panel)
        except DatasetError as error:
            absent.append(str(error))
    if len(absent) == len(ANIMATED):
        raise ExportError("no step has a map to show")
    return absent


_FORMATS = {
    "netcdf": _Format(tables.write_netcdf, ".nc"),
    "zarr": _Format(tables.write_zarr, ".zarr"),
    "vtk": _Format(surfaces.write_vtk, "_vtk"),
    "ply": _Format(surfaces.write_ply, "_ply"),
    "csv": _Format(tables.write_csv, "_csv"),
    "mat": _Format(tables.write_matlab, ".mat"),
    "tiff": _Format(tables.write_tiff, "_tiff"),
    "png": _Format(_write_png, "_png"),
    "gif": _Format(_write_gif, "_gif"),
    "r3xa": _Format(r3xa.write_r3xa, "_r3xa.json"),
}
FORMATS = tuple(_FORMATS)


@dataclass
class Exported:
    """The result of one format.

    Attributes
    ----------
    format
        Its name.
    path
        The file or folder, None if it was not written.
    problems
        What it does not contain, or why it was not written.
    """

    format: str
    path: Path | None = None
    problems: list[str] = field(default_factory=list)


_EXPERIMENT = dataset_of(over=("step", "row", "column"))


@check_arguments(
    ExportError, dataset=_EXPERIMENT, folder=path, formats=several(text), steps=optional(several(whole(), least=1))
)
def export_dataset(
    dataset: xr.Dataset,
    folder: Path,
    formats: Iterable[str],
    *,
    steps: Iterable[int] | None = None,
    overwrite: bool = False,
) -> list[Exported]:
    """Write a dataset in several formats; a format that fails does not stop the others.

    Parameters
    ----------
    dataset
        From `fringedic.open_experiment`; read step by step.
    folder
        Folder of the files, which are named after the experiment; made if it is missing.
    formats
        Of `FORMATS`.
    steps
        Numbers of the steps; all by default.
    overwrite
        Replace existing files.

    Returns
    -------
    list of Exported
        One entry per format.

    Raises
    ------
    ExportError
        A format or a step does not exist, or the folder cannot be made.

    Examples
    --------
    >>> import fringedic
    >>> dataset = fringedic.open_experiment("recordings/plate-7/bag")
    >>> for each in export_dataset(dataset, Path("plate-7"), ["csv", "ply"], steps=[2]):
    ...     print(each.format, each.path, each.problems)
    csv plate-7/tiny_csv []
    ply plate-7/tiny_ply []
    """
    folder, formats = Path(folder), list(formats)
    unknown = [name for name in formats if name not in _FORMATS]
    if unknown:
        raise ExportError(f"there is no format {', '.join(unknown)}; known are {', '.join(FORMATS)}")
    if steps is not None:
        chosen = list(dict.fromkeys(steps))
        absent = [number for number in chosen if number not in dataset["step"].values]
        if absent:
            present = ", ".join(str(number) for number in dataset["step"].values)
            raise ExportError(f"the dataset has no step {', '.join(map(str, absent))}; it has {present}")
        if "time" in dataset:  # the times of a selection count from the first step of the whole dataset
            dataset = dataset.assign_attrs({TIME_ZERO: str(first_time(dataset))})
        dataset = dataset.sel(step=chosen)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ExportError(f"{folder}: cannot be made: {cause_of(error)}") from error
    with noted(folder, f"export as {', '.join(formats)}"):
        return [_export(dataset, folder, name, overwrite) for name in formats]


def _export(dataset: xr.Dataset, folder: Path, name: str, overwrite: bool) -> Exported:
    write, ending = _FORMATS[name]
    target = folder / f"{file_stem(dataset)}{ending}"
    try:
        with _replacing(target, overwrite) as temporary:
            skipped = write(dataset, temporary)
    except FringedicError as error:  # it may name the file that was written, which no one looks for
        return Exported(name, None, [str(error).replace(_temporary(target).name, target.name)])
    except OSError as error:
        return Exported(name, None, [f"{target}: cannot be written: {cause_of(error)}"])
    return Exported(name, target, skipped)


@contextmanager
def _replacing(target: Path, overwrite: bool) -> Iterator[Path]:
    """Give a temporary name, which becomes the target when everything is written."""
    if target.exists() and not overwrite:
        raise ExportError(f"{target} exists already; choose another folder or ask to overwrite it")
    temporary = _temporary(target)
    _remove(temporary)
    try:
        yield temporary
        _remove(target)
        temporary.replace(target)
    finally:
        _remove(temporary)


def _temporary(target: Path) -> Path:
    return target.with_name(f".writing-{target.name}")


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
