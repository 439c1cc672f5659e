"""Part and length of measured vectors against the plain formula, with holes in different components."""

import math

import numpy as np
import pytest

from fringedic.steps.statistics import measured_part_and_rms


def test_holes_in_any_component_leave_their_vector_out() -> None:
    field = np.random.default_rng(1).normal(2.0, 1.0, (37, 53, 2)).astype(np.float32)
    field[3, 5, 0] = field[3:6, 7, 1] = np.nan
    field[0, 0, 1] = np.inf
    whole = np.isfinite(field).all(axis=-1)
    part, rms = measured_part_and_rms(field[..., 0], field[..., 1])
    assert part == whole.mean() == 1 - 5 / (37 * 53)
    assert rms == pytest.approx(math.sqrt(np.mean(np.sum(field[whole].astype(float) ** 2, axis=-1))), rel=1e-12)


def test_nothing_measured_has_no_length() -> None:
    part, rms = measured_part_and_rms(np.full((4, 5), np.nan, np.float32))
    assert part == 0
    assert math.isnan(rms)
