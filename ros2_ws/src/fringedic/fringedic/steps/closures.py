"""Closures of a step: checks of phase and displacement by other criteria than those they were measured with."""

from __future__ import annotations

import numpy as np
import xarray as xr

from fringedic.correlation.closure import displacement_closure
from fringedic.frames.collector import Stack
from fringedic.frames.exposures import split_exposures
from fringedic.phase.closure import phase_closure
from fringedic.steps.references import LatestSteps
from fringedic.steps.step_results import DicResult, PhaseResult


class ClosureChecks:
    """Checks steps one after the other; keeps the textures that may be the reference of a later one."""

    def __init__(self) -> None:
        self._textures: LatestSteps[np.ndarray] = LatestSteps()

    @staticmethod
    def phase(stack: Stack, result: PhaseResult) -> dict[str, np.ndarray]:
        """Return the closure between the pitches of a step.

        There is none of several exposures, one pitch, a relative phase, or a moving surface, whose pitches are seen at
        several times.

        Parameters
        ----------
        stack
            Its frames.
        result
            Its phase.

        Returns
        -------
        dict
            ``phase_closure`` [standard deviations], float32 (row, column).
        """
        if stack.is_moving:
            return {}
        exposures = split_exposures(stack.frames, stack.patterns, stack.exposure_times)
        if result.relative or len(exposures) > 1:
            return {}
        frames = exposures[0].without_grey()
        closure = phase_closure(frames.frames, frames.patterns, result.phase, result.sigma, result.modulation)
        return {} if closure is None else {"phase_closure": closure}

    def displacement(self, result: DicResult, texture: np.ndarray, kept_steps: int) -> dict[str, np.ndarray]:
        """Return the closure of the displacement as `closure` does, as maps of a dataset.

        Returns
        -------
        dict
            ``displacement_closure_x`` and ``displacement_closure_y`` [standard deviations], float32 (row, column).
        """
        return closure_maps(self.closure(result, texture, kept_steps))

    def closure(self, result: DicResult, texture: np.ndarray, kept_steps: int) -> xr.Dataset | None:
        """Return the closure of the displacement; None for the reference step and where increments were summed.

        Parameters
        ----------
        result
            The displacement of a step.
        texture
            That it was measured in.
        kept_steps
            Number of the latest steps that can become the reference.
        """
        key, reference_key = (result.experiment, result.step), (result.experiment, result.reference_step)
        self._textures.keep(key, texture, kept_steps, reference_key)
        if key == reference_key or result.correlated_step != result.reference_step:
            return None
        return displacement_closure(self._textures[reference_key], texture, result.field)


def closure_maps(closure: xr.Dataset | None) -> dict[str, np.ndarray]:
    """Return the maps of the closure of a displacement by their names in a dataset; none without a closure."""
    if closure is None:
        return {}
    return {f"displacement_closure_{axis}": closure[f"closure_{axis}"].values for axis in "xy"}
