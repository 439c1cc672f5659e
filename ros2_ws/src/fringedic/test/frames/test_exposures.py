"""Exposures merged on a surface that no single exposure covers."""

import numpy as np
import pytest

from fringedic.errors import ImageError
from fringedic.frames.exposures import merge_exposures
from fringedic.frames.noise import CameraNoise
from fringedic.patterns.sequences import fringe_sequence
from fringedic.phase import absolute_phase
from fringedic.virtual_rig import VirtualRig, VirtualRigConfiguration

NOISE = CameraNoise(read=float(np.hypot(1, 12**-0.5)), shot=0.02)
TIMES = (1.0, 4.0, 16.0)


def test_merged_exposures_measure_dark_and_glaring_parts_with_less_noise() -> None:
    """Brightness differs by a factor of 50 over the surface, and the brightest parts glare at the middle exposure."""
    entries = {"preset": "sphere", "size": "small", "texture": {"floor": 0.02}, "sensor": {"ambient_light": 0.005}}
    twin = VirtualRig(VirtualRigConfiguration.from_dict({**entries, "seed": 2}))
    rows, columns = twin.projector_shape
    sequence = fringe_sequence(columns, rows, [columns, 40, 10], 4)
    stacks = [
        np.array(
            [
                twin.expose(image, 0.0, 100 * number + index, exposure_factor=times)
                for index, image in enumerate(sequence)
            ]
        )
        for number, times in enumerate(TIMES)
    ]
    truth = 2 * np.pi * (twin.view(0.0).projector_column - (columns - 1) / 2) / 10
    merged, sigma = merge_exposures(stacks, TIMES, noise=NOISE)
    together = absolute_phase(merged, sequence.patterns, noise=sigma)
    alone = [absolute_phase(stack, sequence.patterns, noise=NOISE) for stack in stacks]
    fractions = [float(each.valid.mean()) for each in alone]
    error = together.phase.values - truth
    score = float(np.nanstd(error / together.sigma.values))
    valid = float(together.valid.mean())
    assert valid > 0.99 > max(fractions)
    assert not (np.abs(error) > np.pi).any()
    assert 0.95 < score < 1.05
    for each in alone:
        both = (each.valid & together.valid).values
        noise = float(np.std((each.phase.values - truth)[both])), float(np.std(error[both]))
        assert noise[1] < 1.005 * noise[0]
        assert np.nanmax((together.sigma / each.sigma).values[both]) < 1.1


def test_all_frames_of_a_pixel_come_from_the_same_exposures() -> None:
    levels = np.array([10.0, 60.0, 30.0])[:, None, None] * np.ones((1, 2, 3))
    stacks = [np.clip(np.rint(levels * times), 0, 255).astype(np.uint8) for times in (1, 4, 5)]
    merged, sigma = merge_exposures(stacks, (1, 4, 5), noise=CameraNoise(2.0))
    # the third exposure saturates in the second frame: weights 1/4 and 16/4
    assert np.allclose(merged, levels)
    assert np.allclose(sigma, 2 / np.sqrt(17))
    stacks[0][1, 0, 0] = stacks[1][1, 0, 0] = 255
    merged, sigma = merge_exposures(stacks, (1, 4, 5), noise=CameraNoise(2.0))
    assert np.isinf(merged[:, 0, 0]).all()
    assert np.isnan(sigma[0, 0])
    assert np.isfinite(merged[:, 1:]).all()


def test_exposures_that_cannot_be_merged_are_refused() -> None:
    stack = np.zeros((4, 5, 6), np.uint8)
    for times in ((1.0, 1.0), (0.0, 1.0), (-1.0, 2.0)):
        with pytest.raises(ImageError, match="positive and different"):
            merge_exposures([stack, stack], times, noise=NOISE)
    with pytest.raises(ImageError, match="two or more"):
        merge_exposures([stack], (1.0,), noise=NOISE)
    with pytest.raises(ImageError, match="one for each"):
        merge_exposures([stack, stack], (1.0,), noise=NOISE)
    with pytest.raises(ImageError, match="cannot be merged"):
        merge_exposures([stack, stack[:3]], (1.0, 2.0), noise=NOISE)
