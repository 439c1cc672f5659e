"""Where patterns are shown."""

from __future__ import annotations

from typing import Protocol

import numpy as np


class Screen(Protocol):
    """The projector's screen. Each method may raise `ScreenError`."""

    def open(self) -> None:
        """Take the screen."""

    def show(self, image: np.ndarray) -> None:
        """Return when the image, uint8 of shape (row, column), is on the screen."""

    def close(self) -> None:
        """Give the screen back."""


class VirtualScreen:
    """The screen of the virtual rig: its camera looks at `projector/image`, so publishing is showing."""

    def open(self) -> None:
        """There is nothing to take."""

    def show(self, image: np.ndarray) -> None:
        """The image is there at once."""

    def close(self) -> None:
        """There is nothing to give back."""
