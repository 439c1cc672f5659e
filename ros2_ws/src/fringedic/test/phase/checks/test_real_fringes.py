"""Real images: two sponges before a wall, with shadow, specular background and depth steps."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from fringedic.patterns.pattern import Orientation, PatternKind, ProjectedPattern
from fringedic.phase.checks import check_stack

SHARED = Path(__file__).parents[7] / "shared" / "data"
FOLDER = Path(os.environ.get("FRINGEDIC_DATA", SHARED)) / "fringes_object"
FIRST = {
    (Orientation.VERTICAL, 200 / 3): 0,
    (Orientation.VERTICAL, 100.0): 3,
    (Orientation.HORIZONTAL, 200 / 3): 6,
    (Orientation.HORIZONTAL, 100.0): 9,
}


@pytest.mark.skipif(not FOLDER.is_dir(), reason="no real fringes here")
@pytest.mark.parametrize("orientation", list(Orientation))
@pytest.mark.parametrize("pitches", [(100.0,), (200 / 3,), (100.0, 200 / 3)])
def test_real_fringes_are_accepted(orientation: Orientation, pitches: tuple[float, ...]) -> None:
    """The shifts grow the other way: the first image is shift 1, the last shift 2."""
    frames, patterns = [], []
    for pitch in pitches:
        for shift, offset in ((1, 0), (2, 2), (3, 1)):
            path = FOLDER / f"pat{FIRST[orientation, pitch] + offset:02d}.png"
            frames.append(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
            patterns.append(ProjectedPattern(PatternKind.FRINGES, orientation, pitch, shift, 3))
    assert check_stack(np.array(frames), patterns) == []
