"""One step on its way into a dataset, and what it was measured with."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from fringedic.chain import DicParameters, Parameters
from fringedic.rig import RigModel


@dataclass
class Row:
    """One step on its way into the dataset; the stamp is None when its last frame never came."""

    step: int
    stamp: int | None = None
    error: str = ""
    reference_step: int | None = None
    force: float = float("nan")
    position: float = float("nan")
    valid_fraction: float = float("nan")
    rms_displacement: float = float("nan")
    maps: dict[str, np.ndarray] = field(default_factory=dict)


class Settings(NamedTuple):
    """What a row was measured with."""

    parameters: dict[str, Parameters]
    calibration: RigModel | None

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
