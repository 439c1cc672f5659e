"""Least squares along curved valleys: Levenberg-Marquardt with geodesic acceleration (Transtrum and Sethna 2012).

Camera, projector and the centre of its lens may turn together with hardly any effect on the phases. A straight step
along such a valley leaves it by its curvature, so that the plain method makes thousands of tiny steps. Here each step
is bent by the second derivative along it, and the whole step to the minimum of the linear problem is tried before the
damped ones: damping holds back what the residuals determine least, which is the direction of the valley.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

_DAMPING = 1e-3  # at the start, of the squares of the singular values of the scaled Jacobian
_SMALLER, _LARGER = 5.0, 3.0  # factors of the damping after a good and a bad step
_MOST_DAMPING = 1e12
_ATTAINED = 0.5  # an undamped step is good when the sum of squares decreases by this part of what was expected
_BEND = 0.1  # part of a step at which its second derivative is taken
_MOST_BENT = 0.75  # a step is good when its bend is at most this part of it
_CONVERGED = 1e-3  # of chi square: parameters are within .03 of their standard deviation


class _Slopes(NamedTuple):
    """Singular values of the Jacobian, whose columns are divided by their lengths."""

    left: np.ndarray
    singular: np.ndarray
    right: np.ndarray
    unit: np.ndarray

    @classmethod
    def of(cls, jacobian: np.ndarray) -> _Slopes:
        unit = np.linalg.norm(jacobian, axis=0)
        unit = np.where(unit > 0, unit, 1.0)
        left, singular, right = np.linalg.svd(jacobian / unit, full_matrices=False)
        seen = singular > np.finfo(float).eps * len(jacobian) * singular[0]
        return cls(left[:, seen], singular[seen], right[seen], unit)

    def gain(self, residual: np.ndarray) -> float:
        """Return by how much the sum of squares would decrease if the residuals were linear."""
        return float(np.sum((self.left.T @ residual) ** 2))

    def step(self, residual: np.ndarray, damping: float) -> np.ndarray:
        """Return the damped step that reduces the residuals, in scaled variables."""
        step: np.ndarray = -self.right.T @ (self.singular / (self.singular**2 + damping) * (self.left.T @ residual))
        return step

    def change(self, step: np.ndarray) -> np.ndarray:
        """Return the change of linear residuals by a step."""
        change: np.ndarray = self.left @ (self.singular * (self.right @ step))
        return change


class Minimum(NamedTuple):
    """Where the sum of squares is smallest, the residuals and their derivatives there.

    ``converged`` is False when the steps ended before.
    """

    x: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    converged: bool


def minimise(
    residuals: Callable[[np.ndarray], np.ndarray],
    jacobian: Callable[[np.ndarray], np.ndarray],
    start: np.ndarray,
    most_steps: int,
) -> Minimum:
    """Return the minimum of a sum of squares.

    Parameters
    ----------
    residuals, jacobian
        Functions of the variables (n,): residuals in units of their standard deviation (m,), and their derivatives
        (m, n).
    start
        First values of the variables, (n,).
    most_steps
        The search ends after so many steps.

    References
    ----------
    M. K. Transtrum, J. P. Sethna, "Improvements to the Levenberg-Marquardt algorithm for nonlinear least-squares
    minimization", arXiv:1201.5885 (2012).

    Examples
    --------
    Rosenbrock's valley:

    >>> found = minimise(
    ...     lambda x: np.array([100 * (x[1] - x[0] ** 2), 1 - x[0]]),
    ...     lambda x: np.array([[-200 * x[0], 100.0], [-1.0, 0.0]]),
    ...     np.array([-2.0, 4.0]),
    ...     most_steps=40,
    ... )
    >>> found.x.round(1).tolist()
    [1.0, 1.0]
    """
    x = np.array(start, float)
    residual, slopes = residuals(x), jacobian(x)
    cost, damping, converged = residual @ residual, _DAMPING, False
    for _ in range(most_steps):
        linear = _Slopes.of(slopes)
        gain = linear.gain(residual)
        converged = gain < _CONVERGED
        if converged:
            break
        tried, least = 0.0, _ATTAINED * gain
        while tried < _MOST_DAMPING:
            step = linear.step(residual, tried)
            ahead = residuals(x + _BEND * step / linear.unit)
            curvature = 2 / _BEND * ((ahead - residual) / _BEND - linear.change(step))
            bend = linear.step(curvature, tried)
            reached = x + (step + 0.5 * bend) / linear.unit
            found = residuals(reached)
            if np.linalg.norm(bend) <= _MOST_BENT * np.linalg.norm(step) and found @ found < cost - least:
                break
            tried, least = (tried * _LARGER if tried else damping), 0.0
        else:
            converged = True  # no step is downhill: rounding errors are larger than what remains
            break
        x, residual, cost, slopes = reached, found, found @ found, jacobian(reached)
        damping = tried / _SMALLER if tried else damping
    return Minimum(x, residual, slopes, converged)
