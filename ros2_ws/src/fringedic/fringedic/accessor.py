"""The methods of datasets: ``dataset.fringedic``, registered as soon as xarray and a public name are loaded."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import xarray as xr
from numpy.typing import ArrayLike

from fringedic.errors import DatasetError
from fringedic.frames.region import Point, Region
from fringedic.wording.arguments import check_arguments, text, whole
from fringedic.wording.optional_packages import optional_import

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from fringedic.export import Exported


@xr.register_dataset_accessor("fringedic")  # type: ignore[no-untyped-call]
class ExperimentAccessor:
    """Evaluations of an experiment, as methods of its dataset: ``experiment.fringedic.plot("w")``.

    The methods take the dataset of `fringedic.open_experiment` and, for a single step, that of `fringedic.couple` or
    `fringedic.measure_displacement`. Positions are (column, row) = (x, y) [px] of the reference image.

    Parameters
    ----------
    dataset
        The experiment.

    Examples
    --------
    >>> import fringedic
    >>> experiment = fringedic.open_experiment("recordings/plate-7/bag")
    >>> axes = experiment.fringedic.plot("w")
    >>> gauge = experiment.fringedic.extensometer((40, 60), (120, 60), subset=11)
    >>> round(1e3 * float(gauge.strain[-1]), 1)  # [1e-3]
    -2.0
    """

    def __init__(self, dataset: xr.Dataset) -> None:
        self._dataset = dataset

    @check_arguments(DatasetError, name=text, step=whole())
    def plot(self, name: str, *, step: int = -1, ax: Axes | None = None) -> Axes:
        """Draw a map as the report does: the first row at the top, millimetres where the scale is known.

        Parameters
        ----------
        name
            The map, such as ``"w"`` or ``"e_11"``.
        step
            Number of the step; negative numbers count from the last one, as in Python.
        ax
            Where to draw; by default axes of a new figure of matplotlib.pyplot.

        Returns
        -------
        Axes
            The axes with the map.

        Raises
        ------
        DatasetError
            The dataset has no such map or step.
        FringedicError
            The package ``matplotlib`` is not installed.
        """
        from fringedic.evaluation.step_maps import require_maps, step_of
        from fringedic.figures.maps import draw_map
        from fringedic.figures.panels import panel_of

        require_maps(self._dataset, [name])
        maps = step_of(self._dataset, step)
        if ax is None:
            with optional_import("figures"):
                from matplotlib import pyplot
            ax = pyplot.subplots(layout="constrained")[1]
        draw_map(ax, maps, panel_of(name))
        if "step" in maps.coords:
            ax.set_title(f"step {int(maps.step)}: {ax.get_title()}")
        return ax

    def extensometer(self, first: Point, second: Point, *, subset: float = 1.0) -> xr.Dataset:
        """Return length, elongation and strain between two points; see `fringedic.evaluation.extensometer`."""
        from fringedic.evaluation.probes import extensometer

        return extensometer(self._dataset, first, second, subset=subset)

    def profile(self, names: str | Sequence[str], start: Point, end: Point, *, points: int | None = None) -> xr.Dataset:
        """Return maps along a line; see `fringedic.evaluation.profile`."""
        from fringedic.evaluation.probes import profile

        return profile(self._dataset, _list(names), start, end, points=points)

    def region(self, names: str | Sequence[str], region: Region) -> xr.Dataset:
        """Return mean with its uncertainty, deviation, range and median in a region; see `region_statistics`."""
        from fringedic.evaluation.probes import region_statistics

        return region_statistics(self._dataset, _list(names), region)

    def strain(self, window: int, *, step: int = -1, measures: Iterable[str] = ()) -> xr.Dataset:
        """Return the strain of a step with a window of one's own; see `fringedic.evaluation.strain_of_step`."""
        from fringedic.evaluation.strain import strain_of_step

        return strain_of_step(self._dataset, window, step=step, measures=measures)

    def remove_rigid_motion(self, region: Region | None = None) -> xr.Dataset:
        """Return the displacement without its rigid motion; see `fringedic.evaluation.remove_rigid_motion`."""
        from fringedic.evaluation.rigid_motion import remove_rigid_motion

        return remove_rigid_motion(self._dataset, region)

    def force_curve(
        self,
        strain: ArrayLike,
        *,
        section: float | None = None,
        tare: float = 0.0,
        sign: int = 1,
        load: str = "force",
    ) -> xr.Dataset:
        """Return force and stress against a strain; see `fringedic.evaluation.force_curve`."""
        from fringedic.evaluation.force import force_curve

        return force_curve(self._dataset, strain, section=section, tare=tare, sign=sign, load=load)

    def compare_with_truth(self, truth: str | os.PathLike[str]) -> xr.Dataset:
        """Return the errors against the truth of a virtual rig; see `fringedic.evaluation.compare_with_truth`."""
        from fringedic.evaluation.truth import compare_with_truth

        return compare_with_truth(self._dataset, truth)

    def save_pictures(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write the maps of every measured step as PNG; see `fringedic.figures.save_pictures`."""
        from fringedic.figures.maps import save_pictures

        return save_pictures(self._dataset, folder)

    def export(
        self,
        folder: str | os.PathLike[str],
        formats: str | Sequence[str],
        *,
        steps: Iterable[int] | None = None,
        overwrite: bool = False,
    ) -> list[Exported]:
        """Write files of other programs; see `fringedic.export.export_dataset`."""
        from fringedic.export import export_dataset

        return export_dataset(self._dataset, Path(folder), _list(formats), steps=steps, overwrite=overwrite)


def _list(names: str | Sequence[str]) -> list[str]:
    return [names] if isinstance(names, str) else list(names)
