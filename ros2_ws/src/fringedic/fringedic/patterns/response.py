"""The response curve of a projector, for which patterns are pre-compensated."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
import yaml

from fringedic.errors import PatternError
from fringedic.wording.arguments import check_value, number, several
from fringedic.wording.sealed_yaml import sealed, unsealed
from fringedic.wording.yaml_text import load_yaml

FULL_SCALE = 255  # of the projector
_LEAST_BRIGHTNESS = 0.02  # below it, rounding to 8 bits and noise dominate the logarithm that gamma is fitted to


@dataclass(frozen=True)
class ResponseCurve:
    """Relative brightness in the camera's image for every grey level of the projector.

    Attributes
    ----------
    brightness
        (I(level) - I(0)) / (I(255) - I(0)) for level = 0..255: 256 values that grow from 0 to 1.
    sigma
        Standard deviation of the curve over the image in which it was measured [-].

    Raises
    ------
    PatternError
        There are not 256 finite values, or they do not grow from 0 to 1.

    Examples
    --------
    >>> curve = ResponseCurve(tuple((level / 255) ** 2.2 for level in range(256)))
    >>> round(curve.gamma, 3)
    2.2
    >>> float(curve.level_for(0.5).round(1))  # grey level that looks half as bright as white
    186.1
    """

    brightness: tuple[float, ...]
    sigma: float = 0.0

    def __post_init__(self) -> None:
        """Check the values."""
        values = np.array(check_value(PatternError, "brightness", self.brightness, several(number())))
        check_value(PatternError, "sigma", self.sigma, number())
        if values.shape != (FULL_SCALE + 1,) or not np.isfinite(values).all():
            raise PatternError(f"a response curve has {FULL_SCALE + 1} finite values, not {values.shape}")
        if (np.diff(values) < 0).any() or values[0] != 0 or values[-1] != 1:
            raise PatternError("a response curve has to grow from 0 to 1 and never fall")

    def level_for(self, brightness: np.ndarray | float) -> np.ndarray:
        """Return the grey level to show, not rounded, for a relative brightness of 0 to 1 (any shape)."""
        values = np.array(self.brightness)
        first = np.flatnonzero(np.diff(values, prepend=-1.0) > 0)  # a flat part of the curve keeps its lower end
        return np.asarray(np.interp(brightness, values[first], first.astype(float)))

    @property
    def gamma(self) -> float:
        """Exponent of the nearest power law, by least squares of the logarithms; 1 for a linear projector."""
        level = np.arange(1, FULL_SCALE) / FULL_SCALE
        values = np.array(self.brightness[1:-1])
        known = values > _LEAST_BRIGHTNESS
        logarithm = np.log(level[known])
        return float(np.sum(logarithm * np.log(values[known])) / np.sum(logarithm**2))

    def save(self, path: str | Path) -> None:
        """Write the curve as YAML."""
        content = {
            "response_curve": {
                "brightness": [round(value, 6) for value in self.brightness],
                "sigma": round(self.sigma, 6),
            }
        }
        Path(path).write_text(yaml.safe_dump(sealed(content), sort_keys=False))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a curve that `save` wrote.

        Raises
        ------
        PatternError
            The file cannot be read or contains no response curve.
        """
        try:
            content, _ = unsealed(load_yaml(Path(path).read_text("utf-8")), str(path))
            section = content["response_curve"]
            return cls(tuple(float(value) for value in section["brightness"]), float(section.get("sigma", 0.0)))
        except (OSError, yaml.YAMLError, KeyError, TypeError, ValueError) as error:
            raise PatternError(f"{path}: not a response curve: {error}") from error
