"""Parameters as recordings hold them, for the models of the processing steps."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from fringedic.steps.recorded_parameters import RecordedParameters


def test_lists_of_numbers_are_read_as_the_models_want_them() -> None:
    """A decoder hands out arrays; the models refuse NumPy's numbers."""
    value = SimpleNamespace(type=7, integer_array_value=np.array([4, 6, 40, 30]))
    message = SimpleNamespace(node="coupling", parameters=[SimpleNamespace(name="watch_region_px", value=value)])
    parameters = RecordedParameters({})
    parameters.take(message)
    assert parameters.coupling.drift_marker_px == [4, 6, 40, 30]
