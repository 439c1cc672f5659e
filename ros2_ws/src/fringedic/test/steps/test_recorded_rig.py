"""Sizes of the rig in recordings, which may have been changed by hand or come from another version."""

import pytest

from fringedic.errors import RecordingError
from fringedic.steps.recorded_rig import RecordedSizes


def test_sizes_that_were_not_recorded_are_unknown():
    older = RecordedSizes.of({"experiment": {"shifts": [4, 4]}})
    assert (older.projector_size, older.camera_first) == (None, (-1, -1))
    assert RecordedSizes.of({}) == older


@pytest.mark.parametrize("value", ["wide", 1.5, [800], 0])
def test_size_that_is_none_is_named(value):
    with pytest.raises(RecordingError, match="recorded projector_width_px of the experiment node is '") as refused:
        RecordedSizes.of({"experiment": {"projector_width_px": value, "projector_height_px": 600}})
    assert refused.value.code is None
