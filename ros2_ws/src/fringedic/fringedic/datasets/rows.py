"""One step on its way into a dataset."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
import xarray as xr

from fringedic.datasets.confirmation import confirmed_fraction
from fringedic.signals import SignalValue
from fringedic.steps.pipeline import MeasuredStep
from fringedic.steps.recorded_parameters import StepSettings


@dataclass
class Row:
    """One step on its way into the dataset; the stamp is None when its last frame never came, or there are no times.

    The settings are None if nothing was measured: the row is written later than those that follow it are measured.
    """

    step: int
    stamp: int | None = None
    error: str = ""
    reference_step: int | None = None
    correlated_step: int | None = None
    valid_fraction: float = float("nan")
    rms_displacement: float = float("nan")
    maps: dict[str, np.ndarray] = field(default_factory=dict)
    image: str = ""
    confirmed_fraction: float = float("nan")
    refuted_fraction: float = float("nan")
    remarks: str = ""
    settings: StepSettings | None = None
    signals: dict[str, SignalValue] = field(default_factory=dict)

    def reject(self, error: str) -> None:
        """Take away the results of a step that failed when it was exposed."""
        nothing = Row(self.step, self.stamp, self.error or error, settings=self.settings, image=self.image)
        vars(self).update(vars(nothing))


def row_of(measured: MeasuredStep, settings: StepSettings) -> Row:
    """Return the row of a step that was measured offline with these settings."""
    row = Row(measured.step, measured.stamp, error=measured.error, settings=settings)
    phase, displacement, coupling = measured.phase, measured.displacement, measured.coupling
    if phase is not None:
        row.valid_fraction = phase.valid_fraction
        row.maps |= {
            "phase": phase.phase,
            "phase_sigma": phase.sigma,
            "modulation": phase.modulation,
            "texture": phase.texture,
        }
    if displacement is not None:
        row.valid_fraction = displacement.valid_fraction
        row.reference_step = displacement.reference_step
        row.correlated_step = displacement.correlated_step
        row.maps |= displacement_maps(displacement.field)
    if coupling is not None:
        row.valid_fraction = coupling.valid_fraction
        row.rms_displacement = coupling.rms
        row.maps |= {f"shape_{name}": array.values for name, array in coupling.shape.items()}
        row.maps |= {str(name): array.values for name, array in coupling.displacement.items()}
    row.maps |= measured.closures
    row.confirmed_fraction = confirmed_fraction(measured.closures, settings.spacing)
    return row


def displacement_maps(field: xr.Dataset) -> dict[str, np.ndarray]:
    """Return the maps of an in-plane displacement by their names in a dataset."""
    return {
        "displacement_x": field.displacement_x.values,
        "displacement_y": field.displacement_y.values,
        "displacement_sigma_x": field.sigma_x.values,
        "displacement_sigma_y": field.sigma_y.values,
    }


def in_order_of_steps(rows: Iterator[Row]) -> Iterator[Row]:
    """Return the rows in the order of their steps, if a reference step was measured before the others."""
    early = next(rows, None)
    for row in rows:
        if early is not None and row.step > early.step:
            yield early
            early = None
        yield row
    if early is not None:
        yield early


def with_lost_steps(rows: Iterable[Row], exposed: Iterable[int], error: str) -> Iterator[Row]:
    """Return rows with a row of each exposed step that is not among them, with this error.

    It has its place among them if the steps were exposed in their order, and not after a clock that was set back.
    """
    numbers = list(exposed)
    lost = dict.fromkeys(numbers)
    in_order = numbers == sorted(numbers)
    for row in rows:
        lost.pop(row.step, None)
        while in_order and lost and (step := next(iter(lost))) < row.step:
            del lost[step]
            yield Row(step, error=error)
        yield row
    yield from (Row(step, error=error) for step in lost)
