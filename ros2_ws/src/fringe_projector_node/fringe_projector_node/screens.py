"""Screens that a projector node can show its patterns on."""

from __future__ import annotations

import time
from typing import Protocol

import numpy as np


class Screen(Protocol):
    """Where patterns appear."""

    def show(self, image: np.ndarray) -> int:
        """Put an image, uint8 (height, width), on the screen.

        Returns
        -------
        int
            When it was there [ns].

        Raises
        ------
        ScreenError
            The screen does not show it.
        """
        ...

    def check(self) -> None:
        """Notice what happened to the screen; called several times a second.

        Raises
        ------
        ScreenError
            It no longer shows patterns.
        """
        ...

    def close(self) -> None:
        """Give the screen back."""
        ...


class VirtualScreen:
    """The projector of a virtual rig: its camera sees whatever the node publishes."""

    def show(self, image: np.ndarray) -> int:
        """Appear at once."""
        return time.time_ns()

    def check(self) -> None:
        """Nothing can happen to it."""

    def close(self) -> None:
        """Nothing to give back."""
