"""Aravis, the library for GigE Vision and USB3 Vision cameras.

Aravis is a system library with GObject introspection, not a Python package: `docs/hardware.md` describes its
installation. It is loaded when the first camera is opened.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from fringedic.errors import CameraError

Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Aravis:
    """The loaded library.

    Attributes
    ----------
    module
        The GObject introspection module.
    error
        Exception of its calls.
    """

    module: Any
    error: type[Exception]

    def ask(self, what: str, question: Callable[[], Answer]) -> Answer:
        """Return the answer of a call.

        Raises
        ------
        CameraError
            The call failed; the message contains `what`.
        """
        try:
            return question()
        except (CameraError, self.error) as error:
            raise CameraError(f"{what}: {error_message(error)}") from error

    def camera(self, name: str) -> Any:
        """Open a camera by its identifier or network address; an empty name stands for the only one.

        Raises
        ------
        CameraError
            No camera is found, or several.
        """
        if name:
            return self.module.Camera.new(name)
        self.module.update_device_list()
        found = [self.module.get_device_id(index) for index in range(self.module.get_n_devices())]
        if len(found) != 1:
            seen = f"there are {len(found)} cameras: {', '.join(found)}" if found else "no camera is found"
            raise CameraError(f"{seen}; set camera to an identifier or a network address")
        return self.module.Camera.new(found[0])


def load_aravis() -> Aravis:
    """Load Aravis.

    Raises
    ------
    CameraError
        Aravis is not installed.
    """
    try:
        import gi

        gi.require_version("Aravis", "0.8")
        from gi.repository import Aravis as library
        from gi.repository import GLib
    except (ImportError, ValueError) as error:
        raise CameraError(f"Aravis is not installed ({error}); see docs/hardware.md") from error
    return Aravis(library, GLib.Error)


def error_message(error: Exception) -> str:
    """Return the message of an error of GLib without its domain and code."""
    return str(getattr(error, "message", error))
