"""Certainty of fringe orders: rate of wrong ones, and the harmonic error of the coarse pitch."""

import numpy as np
import pytest

from fringedic.phase.harmonic_correction import HarmonicError
from fringedic.phase.order_certainty import OrderCertainty, fit_order_certainty

TURN = 2 * np.pi


@pytest.mark.parametrize(("spread", "least"), [(0.3, 0.999999), (0.6, 0.9998), (0.9, 0.85), (1.25, 0.0)])
@pytest.mark.parametrize("harmonic", [0.0, 0.25])
def test_certain_orders_are_right(spread: float, least: float, harmonic: float) -> None:
    """At the worst spread, 1.25 rad, 0.6 of a million orders are expected to be wrong."""
    random, ratio, response = np.random.default_rng(1), 32.0, HarmonicError(3, harmonic)
    truth, sigma = random.uniform(-3, 3, 1_000_000), np.full(1_000_000, spread / ratio)
    seen = truth + response.at(truth) + random.normal(0, sigma)
    found = OrderCertainty(response, 0.0)
    predicted, _ = found.predict(seen, sigma, ratio)
    wrong = TURN * np.round((predicted - ratio * truth) / TURN)
    certain = found.certain((seen, sigma), (ratio * truth + wrong, np.zeros_like(sigma)), ratio)
    assert certain.mean() >= (0.0 if harmonic else least)
    assert int((certain & (wrong != 0)).sum()) <= 5


@pytest.mark.parametrize("ratio", [-0.3, 0.0, 0.1, 0.3])
@pytest.mark.parametrize("pitches", [2.0, 8.0, 32.0])
def test_the_harmonic_of_the_coarse_pitch_is_found(ratio: float, pitches: float) -> None:
    random, response = np.random.default_rng(2), HarmonicError(3, ratio)
    truth, sigma = random.uniform(-2.8, 2.8, 20_000), np.full(20_000, 0.01)
    noise = random.normal(0, 0.01, (2, 20_000))
    fine = pitches * truth + noise[1]
    fine -= TURN * np.round(fine / TURN)
    found = fit_order_certainty((truth + response.at(truth) + noise[0], sigma), (fine, sigma), pitches, 3)
    assert found.error.ratio == pytest.approx(ratio, abs=0.003)
    assert found.rest < 0.1


def test_phases_without_relation_have_no_certain_order() -> None:
    coarse, fine = np.random.default_rng(3).uniform(-np.pi, np.pi, (2, 20_000))
    sigma = np.full(20_000, 0.01)
    found = fit_order_certainty((coarse, sigma), (fine, sigma), 32.0, 3)
    assert not found.certain((coarse, sigma), (32 * coarse, sigma), 32.0).any()
    nothing = np.full(20_000, np.nan)
    assert fit_order_certainty((nothing, sigma), (fine, sigma), 32.0, 3).rest == np.inf
