"""One step on its way into a dataset, and what it was measured with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from fringedic.chain import DicParameters, Parameters
from fringedic.facts import Facts
from fringedic.rig import RigModel


@dataclass
class Row:
    """One step on its way into the dataset; the stamp is None when its last frame never came."""

    step: int
    stamp: int | None = None
    error: str = ""
    reference_step: int | None = None
    correlated_step: int | None = None
    force: float = float("nan")
    position: float = float("nan")
    valid_fraction: float = float("nan")
    rms_displacement: float = float("nan")
    maps: dict[str, np.ndarray] = field(default_factory=dict)


class Settings(NamedTuple):
    """What a row was measured with: parameters of the processing nodes, calibration, and of the other nodes and facts
    what the recording tells.
    """

    parameters: dict[str, Parameters]
    calibration: RigModel | None
    rig: dict[str, dict[str, Any]]
    facts: Facts | None

    @property
    def spacing(self) -> int:
        dic = self.parameters["dic"]
        assert isinstance(dic, DicParameters)
        return dic.spacing


def displacement_maps(displacement: np.ndarray, sigma: np.ndarray) -> dict[str, np.ndarray]:
    return {
        "displacement_x": displacement[..., 0],
        "displacement_y": displacement[..., 1],
        "displacement_sigma_x": sigma[..., 0],
        "displacement_sigma_y": sigma[..., 1],
    }


def in_order_of_steps(rows: Iterator[Row]) -> Iterator[Row]:
    """Put a reference step that was measured before its time back between its neighbours."""
    early = next(rows, None)
    for row in rows:
        if early is not None and row.step > early.step:
            yield early
            early = None
        yield row
    if early is not None:
        yield early
