"""A phase up to whole fringes, and the calibration: the surface that lies nearest to the reference plane."""

import numpy as np
import pytest

from fringedic.patterns.pattern import Orientation
from fringedic.rig.model import RigModel
from fringedic.surface.nearest_order import nearest_order_to_plane
from fringedic.virtual_rig import VirtualRig

PITCH = 10.0


@pytest.mark.parametrize("orders", [-31, 4])
@pytest.mark.parametrize("orientation", list(Orientation))
def test_orders_are_those_of_the_reference_plane(orders: int, orientation: Orientation) -> None:
    twin = VirtualRig.from_preset("plate", size="tiny")
    rig, truth = RigModel(**twin.optics()), twin.truth(0.0)
    exact = rig.phase(truth.x.values, truth.y.values, truth.z.values, PITCH, orientation).astype(np.float32)
    found = nearest_order_to_plane(exact + np.float32(2 * np.pi * orders), rig, PITCH, orientation)
    assert found.dtype == np.float32
    wrong = float(np.nanmax(np.abs(found - exact)))
    assert wrong < 1e-3, f"off by {wrong / (2 * np.pi):.2f} fringe"


def test_a_surface_far_away_is_off_by_the_fewest_fringes() -> None:
    twin = VirtualRig.from_preset("plate", size="tiny")
    rig, truth = RigModel(**twin.optics()), twin.truth(0.0)
    lifted = rig.phase(truth.x.values, truth.y.values, truth.z.values + 0.05, PITCH).astype(np.float32)
    flat = rig.phase(truth.x.values, truth.y.values, truth.z.values, PITCH)
    away = np.nanmedian(nearest_order_to_plane(lifted, rig, PITCH, Orientation.VERTICAL) - flat) / (2 * np.pi)
    assert abs(np.nanmedian(lifted - flat)) > 2 * np.pi, "the case is one of several fringes"
    assert abs(away) < 0.6, f"{away:.2f} fringe from the plane"


def test_nothing_measured_stays_nothing() -> None:
    rig = RigModel(**VirtualRig.from_preset("plate", size="tiny").optics())
    assert np.isnan(
        nearest_order_to_plane(np.full((120, 160), np.nan, np.float32), rig, PITCH, Orientation.VERTICAL)
    ).all()
