"""Closed form of the rig with six parameters (Molimard, Boyer, Zahouani, eq. 10; Breque et al. 2004)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class SixParameterModel:
    """Six-parameter model (eq. 10 with corrected signs): both optical axes meet in the origin, fringes along y.

    The fifth and the sixth parameter are the position of the rotation axis and the phase on it, which a calibration
    finds (`fringedic.calibration.closed_form`); here both are 0.

    Attributes
    ----------
    camera_distance, projector_distance
        h0 and hp, heights of the pin-holes above the reference plane [m].
    base
        d, distance of the projector from the camera's axis [m], negative on the left.
    sensitivity
        K = 2 pi f_p / P_t [rad], projector focal length over fringe pitch.

    References
    ----------
    J. Molimard, G. Boyer, H. Zahouani, "Frequency-based image analysis of random patterns: an alternative way to
    classical stereocorrelation", eq. 8 to 10.

    C. Breque, J.-C. Dupre, F. Bremand, "Calibration of a system of projection moire for relief measuring: biomechanical
    applications", Optics and Lasers in Engineering 41 (2004) 241-260.

    Examples
    --------
    >>> from fringedic.rig import SixParameterModel
    >>> model = SixParameterModel(camera_distance=0.4, projector_distance=0.38, base=0.18, sensitivity=2136.0)
    >>> x, y, z = model.position(model.phase(0.02, 0.001), reference_x=0.02 / (1 - 0.001 / 0.4), reference_y=0.0)
    >>> round(float(x), 6), round(float(z), 6)
    (0.02, 0.001)
    """

    camera_distance: float
    projector_distance: float
    base: float
    sensitivity: float

    def phase(self, x: ArrayLike, z: ArrayLike) -> np.ndarray:
        """Return the phase [rad] on points at x and z [m], in their shape."""
        x, z = np.asarray(x, float), np.asarray(z, float)
        d, hp = self.base, self.projector_distance
        phase: np.ndarray = self.sensitivity * (x * hp - z * d) / (d**2 + hp**2 - x * d - z * hp)
        return phase

    def position(
        self, phase: ArrayLike, reference_x: ArrayLike, reference_y: ArrayLike
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x, y, z [m] of pixels whose lines of sight meet the reference plane in (`reference_x`, `reference_y`).

        Parameters
        ----------
        phase
            Absolute phase [rad].
        reference_x, reference_y
            X and Y [m] of eq. 10, arrays of the phase's shape.
        """
        phi, big_x, big_y = (np.asarray(each, float) for each in (phase, reference_x, reference_y))
        h0 = self.camera_distance
        numerator = self._e(phi) * big_x - self._length_squared * phi
        z = h0 * numerator / self._denominator(phi, big_x)
        return (h0 - z) * big_x / h0, (h0 - z) * big_y / h0, z

    def dz_dphi(self, phase: ArrayLike, reference_x: ArrayLike) -> np.ndarray:
        """Return the derivative of z with respect to the phase along the line of sight [m/rad]."""
        phi, big_x = np.asarray(phase, float), np.asarray(reference_x, float)
        h0, hp, d = self.camera_distance, self.projector_distance, self.base
        growth = h0 * self.sensitivity * self._length_squared * ((h0 - hp) * big_x - h0 * d)
        slope: np.ndarray = growth / self._denominator(phi, big_x) ** 2
        return slope

    @property
    def _length_squared(self) -> float:
        return self.base**2 + self.projector_distance**2

    def _e(self, phi: np.ndarray) -> np.ndarray:
        return self.sensitivity * self.projector_distance + self.base * phi

    def _denominator(self, phi: np.ndarray, big_x: np.ndarray) -> np.ndarray:
        opposite = self.sensitivity * self.base - self.projector_distance * phi
        denominator: np.ndarray = self._e(phi) * big_x + self.camera_distance * opposite
        return denominator
