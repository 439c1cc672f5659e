"""Screens for the patterns of a projector node."""

from __future__ import annotations

import time
from typing import Protocol

import numpy as np

from fringedic.settings.projector import VirtualProjector


class Screen(Protocol):
    """A screen that shows patterns."""

    def show(self, image: np.ndarray) -> int:
        """Show an image, uint8 (row, column).

        Returns
        -------
        int
            Time at which it was on the screen [ns].

        Raises
        ------
        ScreenError
            The screen does not show it.
        """
        ...

    def check(self) -> None:
        """Check the screen; called several times a second.

        Raises
        ------
        ScreenError
            It no longer shows patterns.
        """
        ...

    def close(self) -> None:
        """Close the screen."""
        ...


class VirtualScreen:
    """Projector of a virtual rig, whose camera receives the published patterns."""

    def show(self, image: np.ndarray) -> int:  # noqa: ARG002 (the interface of every screen)
        """Return the present time [ns]."""
        return time.time_ns()

    def check(self) -> None:
        """Do nothing: it is always present."""

    def close(self) -> None:
        """Do nothing: no device is open."""


def open_virtual_screen(_settings: VirtualProjector, _node: object) -> VirtualScreen:
    """Return the screen of a virtual rig."""
    return VirtualScreen()
