"""A hardware node whose device fails at a transition."""

from __future__ import annotations

import pytest

from fringedic.errors import CameraError, ProcessError
from fringedic.settings.base import HardwareNodeSettings
from fringedic_ros.lifecycle import HardwareNode


class Failing(HardwareNode[HardwareNodeSettings]):
    """Raises the error of the test when it opens its device."""

    error: Exception

    def __init__(self) -> None:
        super().__init__("device", HardwareNodeSettings)

    def open(self) -> None:
        raise self.error


@pytest.mark.usefixtures("ros")
@pytest.mark.parametrize(
    ("error", "words"),
    [
        (CameraError("there is no camera"), "device cannot configure: there is no camera"),
        (OSError(5, "Input/output error"), r"device cannot configure: OSError: \[Errno 5\] Input/output error"),
    ],
)
def test_error_at_the_start_is_the_reason_of_the_end(
    error: Exception, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also an error of a library, which rclpy drops without a word."""
    monkeypatch.setattr(Failing, "error", error, raising=False)
    with pytest.raises(ProcessError, match=f"^{words}$"):
        Failing.started()
