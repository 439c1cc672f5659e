"""Several sensors of the virtual rig see the same points of one specimen, each in its own frame."""

from __future__ import annotations

import numpy as np
import pytest

from fringedic.errors import VirtualRigError
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration, preset, virtual_sensors


def in_frame_of_specimen(rig: VirtualRig, position: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions before and after (3, point) of the seen points."""
    truth, (rotation, translation) = rig.truth(position), rig.pose
    before = np.stack([truth[name].values.ravel() for name in "xyz"])
    after = before + np.stack([truth[name].values.ravel() for name in "uvw"])
    known = np.isfinite(before).all(axis=0)
    return rotation @ before[:, known] + translation[:, None], rotation @ after[:, known] + translation[:, None]


def test_four_sensors_see_the_full_circumference_of_a_cylinder_in_torsion() -> None:
    rigs, position = virtual_sensors("cylinder", size="tiny"), 5e-4
    seen = set()
    for rig in rigs.values():
        before, after = in_frame_of_specimen(rig, position)
        np.testing.assert_allclose(np.hypot(before[0], before[2]), 20e-3, atol=1e-12)
        strain = position / 60e-3
        radius, turned = 20e-3 * (1 - 0.33 * strain), np.radians(1.0) * 0.5 / 60e-3 * (before[1] + 30e-3)
        angle = np.arctan2(before[0], before[2])
        seen |= set(np.floor(np.degrees(angle) / 5.0))
        np.testing.assert_allclose(after[0], radius * np.sin(angle + turned), atol=1e-12)
        np.testing.assert_allclose(after[1], before[1] + strain * (before[1] + 30e-3), atol=1e-12)
        np.testing.assert_allclose(after[2], radius * np.cos(angle + turned), atol=1e-12)
    assert len(seen) == 72


def test_two_sensors_see_one_texture() -> None:
    """Material points that both see have one reflectance: the same grey level without light of the projectors."""
    left, right = (rig.view(0.0) for rig in virtual_sensors("plate", size="tiny").values())
    levels = []
    for view in (left, right):
        cells = np.stack([np.floor(view.X / 2e-3), np.floor(view.Y / 2e-3)])
        known = np.isfinite(cells).all(axis=0)
        keys = [tuple(each) for each in cells[:, known].T.astype(int)]
        levels.append(dict(zip(keys, view.offset[known].tolist(), strict=True)))
    common = sorted(set(levels[0]) & set(levels[1]))
    first, second = (np.array([each[key] for key in common]) for each in levels)
    assert len(common) > 100
    assert np.corrcoef(first, second)[0, 1] > 0.3  # of other pixels in the same cell


def test_light_of_another_projector_is_crosstalk() -> None:
    left, right = virtual_sensors("plate", size="tiny").values()
    white = np.full(left.projector_shape, 250, np.uint8)
    dark = np.zeros_like(white)
    alone = left.expose(white, 0.0, 0).astype(float)
    np.testing.assert_array_equal(left.expose_beside(white, 0.0, 0, []), alone)
    assert np.abs(left.expose_beside(white, 0.0, 0, [(right, dark)]) - alone).max() == 0
    both = left.expose_beside(dark, 0.0, 0, [(right, white)]).astype(float) - left.expose(dark, 0.0, 0)
    columns = both.mean(axis=0)
    assert columns[:5].max() < 1.0  # beyond the image of the right projector
    assert columns[-20:].min() > 50.0


def test_balls_in_space_are_round_from_every_side() -> None:
    for rig in virtual_sensors("cylinder", size="tiny").values():
        before, _ = in_frame_of_specimen(rig.with_specimen({"kind": "spheres"}), 0.0)
        centres = 1e-3 * np.array([(-16.0, -9.0, 0.0), (15.0, -11.0, 3.0), (-2.0, 12.0, -4.0)])
        away = np.linalg.norm(before[:, None] - centres.T[:, :, None], axis=0)
        np.testing.assert_allclose(away.min(axis=0), 8e-3, atol=1e-12)


def test_a_sensor_in_the_frame_of_the_specimen_is_the_rig_as_before() -> None:
    """The general search of a placed sensor finds the points that the search along the rows finds."""
    plain = VirtualRig.from_preset("plate", size="tiny")
    entries = preset("plate", size="tiny") | {"placement": {"translation_mm": (0.0, 0.0, 1e-12)}}
    placed = VirtualRig(VirtualRigConfiguration.from_dict(entries))
    np.testing.assert_allclose(placed.view(2e-4).X, plain.view(2e-4).X, atol=1e-12)
    np.testing.assert_allclose(placed.view(2e-4).projector_column, plain.view(2e-4).projector_column, atol=1e-6)


def test_an_unknown_arrangement_is_refused() -> None:
    with pytest.raises(VirtualRigError, match="sensors 'ring' are unknown; choose from plate, cylinder, leather"):
        virtual_sensors("ring")
