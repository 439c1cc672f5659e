"""A window that fills one of the displays of this computer, through SDL."""

from __future__ import annotations

import ctypes
import os
import time
from typing import Any

import numpy as np

from fringedic.errors import ScreenError
from fringedic.settings.projector import DisplayProjector

_SETTLING_S = 0.2  # time in which a window manager may still move a new window


class DisplayScreen:
    """Full screen at the resolution of the display: one pattern pixel is one projector pixel, without scaling.

    All calls have to come from the same thread.

    Parameters
    ----------
    settings
        Number of the display, in the order of the system's settings, and its resolution, which is that of the patterns.

    Raises
    ------
    ScreenError
        There is no such display, or it has another size; the message lists the displays.
    """

    def __init__(self, settings: DisplayProjector, _node: object = None) -> None:
        os.environ["PYGAME_HIDE_SUPPORT_PROMPT"] = "1"
        os.environ["SDL_VIDEO_MINIMIZE_ON_FOCUS_LOSS"] = "0"  # an operator works on another display
        import pygame
        from pygame._sdl2 import sdl2

        self._pygame: Any = pygame
        self._errors = (pygame.error, sdl2.error)  # the latter comes from window, renderer and texture
        self._display = settings.display
        self._size = (settings.width, settings.height)
        self._origin = (0, 0)
        self._window: Any = None
        self._renderer: Any = None
        self._texture: Any = None
        self._desktop = _Desktop()
        self._desktop_size = self._desktop.size()
        self._open()

    def show(self, image: np.ndarray) -> int:
        """Show an image and wait until the display has received it.

        With vertical synchronisation this is the start of a refresh. The delay until the projector shows the image can
        only be measured with the camera.

        Returns
        -------
        int
            Time at which the display received it [ns].

        Raises
        ------
        ScreenError
            The window was closed, hidden, moved or resized, or the display changed; the next call opens it again.
        """
        self.check()
        if self._window is None:
            self._open()
        rows, columns = image.shape
        if (columns, rows) != self._size:
            raise ScreenError(f"a pattern of {columns}x{rows} px for a display of {self._size[0]}x{self._size[1]} px")
        grey = np.repeat(image[:, :, np.newaxis], 3, axis=2)
        try:
            self._texture.update(self._pygame.image.frombuffer(grey, self._size, "RGB"))
            self._renderer.clear()
            self._texture.draw()
            self._renderer.present()
        except self._errors as error:
            self._close_window()
            raise ScreenError(f"the display does not accept the pattern: {error}") from error
        return time.time_ns()

    def check(self) -> None:
        """Check that the window still fills the display.

        Raises
        ------
        ScreenError
            It was closed, hidden, moved or resized, or the displays changed.
        """
        lost = ""
        for event in self._pygame.event.get():  # a window whose events are not read counts as hanging
            lost = self._loss(event) or lost
        if (size := self._desktop.size()) != self._desktop_size:
            self._close_window()
            raise ScreenError(
                "the displays changed from {}x{} to {}x{} px in all; restore their resolution, or start this node "
                "again with the right one".format(*self._desktop_size, *size)
            )
        if self._window is None:
            return
        if not lost and self._window.size != self._size:
            lost = "the projector's window has {}x{} px; restore its resolution".format(*self._window.size)
        if lost:
            self._close_window()
            raise ScreenError(f"{lost}; the next pattern opens it again")

    def _loss(self, event: Any) -> str:
        """Return what an event did to the window; empty when the window still fills the display."""
        pygame = self._pygame
        if event.type in (pygame.WINDOWCLOSE, pygame.QUIT):
            return "the projector's window was closed"
        if event.type in (pygame.WINDOWHIDDEN, pygame.WINDOWMINIMIZED):
            return "the projector's window was hidden"
        if event.type == pygame.WINDOWDISPLAYCHANGED and event.display_index != self._display:
            return f"the projector's window is on display {event.display_index} now"
        if event.type == pygame.WINDOWMOVED and (event.x, event.y) != self._origin:
            return f"the projector's window was moved by {event.x - self._origin[0]}, {event.y - self._origin[1]} px"
        if event.type == pygame.WINDOWSIZECHANGED and (event.x, event.y) != self._size:
            return f"the projector's display or window changed to {event.x}x{event.y} px; restore its resolution"
        return ""

    def close(self) -> None:
        """Close the window."""
        self._close_window()
        self._pygame.display.quit()
        self._desktop.close()

    def _open(self) -> None:
        pygame = self._pygame
        try:
            pygame.display.quit()
            pygame.display.init()
            sizes = pygame.display.get_desktop_sizes()
        except pygame.error as error:
            raise ScreenError(f"there is no display: {error}; check the environment variable DISPLAY") from error
        if not os.environ.get("DISPLAY") and not os.environ.get("WAYLAND_DISPLAY"):
            raise ScreenError("there is no display: neither DISPLAY nor WAYLAND_DISPLAY is set")
        found = ", ".join(f"{number}: {width}x{height} px" for number, (width, height) in enumerate(sizes))
        if self._display >= len(sizes):
            raise ScreenError(f"there is no display {self._display}; there are {found}")
        if sizes[self._display] != self._size:
            raise ScreenError(
                f"the patterns have {self._size[0]}x{self._size[1]} px and display {self._display} another size; "
                f"there are {found}"
            )
        try:
            self._open_window()
        except self._errors as error:
            self._close_window()
            raise ScreenError(
                f"a window cannot be opened on display {self._display}: {error}; check its graphics driver"
            ) from error

    def _open_window(self) -> None:
        pygame = self._pygame
        self._window = pygame.Window(
            "fringes", self._size, position=pygame.WINDOWPOS_CENTERED | self._display, borderless=True
        )
        self._window.set_fullscreen(True)
        pygame.mouse.set_visible(False)
        from pygame._sdl2.video import Renderer, Texture

        self._renderer = Renderer(self._window, vsync=True)
        self._texture = Texture(self._renderer, self._size)
        self._renderer.present()
        settled = time.monotonic() + _SETTLING_S
        while time.monotonic() < settled:
            pygame.event.clear()
            time.sleep(0.01)
        self._origin = self._window.position

    def _close_window(self) -> None:
        window, self._window = self._window, None
        if window is not None:
            self._texture = self._renderer = None
            window.destroy()


class _Desktop:
    """Total size of the displays of an X server; SDL requests it only once in a process."""

    def __init__(self) -> None:
        self._server: Any = None
        if os.environ.get("DISPLAY"):
            try:
                self._x11 = ctypes.CDLL("libX11.so.6")
            except OSError:  # then there is no window either, which `_open` reports
                return
            self._x11.XOpenDisplay.restype = ctypes.c_void_p
            self._x11.XDefaultRootWindow.restype = ctypes.c_ulong
            self._server = self._x11.XOpenDisplay(None)

    def size(self) -> tuple[int, int]:
        """Return width and height [px]; (0, 0) without an X server."""
        if not self._server:
            return 0, 0
        server = ctypes.c_void_p(self._server)
        root, x, y = ctypes.c_ulong(), ctypes.c_int(), ctypes.c_int()
        width, height, border, depth = (ctypes.c_uint() for _ in range(4))
        answers = (ctypes.byref(each) for each in (root, x, y, width, height, border, depth))
        self._x11.XGetGeometry(server, ctypes.c_ulong(self._x11.XDefaultRootWindow(server)), *answers)
        return width.value, height.value

    def close(self) -> None:
        """End the connection."""
        if self._server:
            self._x11.XCloseDisplay(ctypes.c_void_p(self._server))
            self._server = None
