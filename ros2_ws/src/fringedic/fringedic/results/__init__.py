"""From a recording to one labelled dataset, without ROS, and from datasets to figures of merit.

A dataset is a NetCDF file or a Zarr folder beside the recording, written step by step. Its dimensions are ``step``,
``row`` and ``column``; the coordinates ``row`` and ``column`` are pixel positions in the reference image. All maps
share the grid of the displacement: where its spacing is above one pixel, maps of the camera's pixels are taken at those
points.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fringedic.results.datasets import dataset_from_derived, process_bag
    from fringedic.results.messages import cloud_arrays, image_array
    from fringedic.results.opening import find_dataset, open_experiment
    from fringedic.results.quantities import MAPS, SCALARS, Quantity
    from fringedic.results.truth import compare_with_truth, open_truth, truth_errors

_HOMES = {
    "MAPS": "quantities",
    "SCALARS": "quantities",
    "Quantity": "quantities",
    "cloud_arrays": "messages",
    "compare_with_truth": "truth",
    "dataset_from_derived": "datasets",
    "find_dataset": "opening",
    "image_array": "messages",
    "open_experiment": "opening",
    "open_truth": "truth",
    "process_bag": "datasets",
    "truth_errors": "truth",
}

__all__ = [
    "MAPS",
    "SCALARS",
    "Quantity",
    "cloud_arrays",
    "compare_with_truth",
    "dataset_from_derived",
    "find_dataset",
    "image_array",
    "open_experiment",
    "open_truth",
    "process_bag",
    "truth_errors",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'fringedic.results' has no attribute '{name}'")
    return getattr(import_module(f"fringedic.results.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
