"""For tests of the projector: a display without a screen, and another program that uses it."""

from __future__ import annotations

import ctypes
import os
import struct
import subprocess
from pathlib import Path
from typing import Any, Self

import numpy as np


class VirtualDisplay:
    """An X server without a screen, whose memory can be read as a file in the format of `xwd`."""

    def __init__(self, folder: Path, width: int, height: int) -> None:
        self._folder, self._size = folder, f"{width}x{height}"

    def __enter__(self) -> Self:
        read_end, write_end = os.pipe()
        screen = ["Xvfb", "-displayfd", str(write_end), "-screen", "0", f"{self._size}x24", "-fbdir", str(self._folder)]
        self._process = subprocess.Popen(screen, pass_fds=[write_end], stderr=subprocess.DEVNULL)
        os.close(write_end)
        with open(read_end) as answer:
            self.name = f":{answer.readline().strip()}"
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.wait()

    def screenshot(self) -> np.ndarray:
        """Return red, green and blue of every pixel, uint8 (row, column, 3)."""
        memory = (self._folder / "Xvfb_screen0").read_bytes()
        header = np.frombuffer(memory, ">u4", 25)
        start, columns, rows, line, colours = header[[0, 4, 5, 12, 19]].astype(int)
        pixels = np.frombuffer(memory, np.uint8, rows * line, start + 12 * colours)
        return pixels.reshape(rows, line)[:, : 4 * columns].reshape(rows, columns, 4)[:, :, 2::-1]

    def change_resolution(self, width: int, height: int) -> None:
        """Change the resolution to at most the initial one, as a user does in the settings."""
        name = f"{width}x{height}"
        timing = [str(n) for n in (1, width, width, width, width, height, height, height, height)]
        for words in (
            ["--newmode", name, *timing],
            ["--addmode", "screen", name],
            ["--output", "screen", "--mode", name],
        ):
            subprocess.run(
                ["xrandr", "--display", self.name, *words], check=words[0] == "--output", capture_output=True
            )


class WindowManager:
    """Another program that changes windows as a user or a window manager does."""

    def __enter__(self) -> Self:
        self._x11 = ctypes.CDLL("libX11.so.6")
        for function in (self._x11.XOpenDisplay, self._x11.XDefaultRootWindow, self._x11.XInternAtom):
            function.restype = ctypes.c_void_p
        self._display = ctypes.c_void_p(self._x11.XOpenDisplay(None))
        self._root = ctypes.c_ulong(self._x11.XDefaultRootWindow(self._display))
        return self

    def __exit__(self, *_: object) -> None:
        self._x11.XCloseDisplay(self._display)

    def windows(self) -> list[int]:
        """Return the top windows, the uppermost last."""
        root, parent, count = ctypes.c_ulong(), ctypes.c_ulong(), ctypes.c_uint()
        windows = ctypes.POINTER(ctypes.c_ulong)()
        found = (ctypes.byref(each) for each in (root, parent, windows, count))
        self._x11.XQueryTree(self._display, self._root, *found)
        return [windows[number] for number in range(count.value)]

    def do(self, function: str, window: int, *values: Any) -> None:
        """Call a function of Xlib on a window."""
        getattr(self._x11, function)(self._display, ctypes.c_ulong(window), *values)
        self._x11.XSync(self._display, 0)

    def close(self, window: int) -> None:
        """Request the window to close, as its button does: a ClientMessage of WM_PROTOCOLS."""
        protocols, delete = (
            self._x11.XInternAtom(self._display, name, 0) for name in (b"WM_PROTOCOLS", b"WM_DELETE_WINDOW")
        )
        fields = (33, 0, 1, self._display.value, window, protocols, 32, delete, 0, 0, 0, 0)
        message = struct.pack("iPiPLLi4xl4l32x", *fields)
        event = ctypes.create_string_buffer(message, 192)
        self.do("XSendEvent", window, 0, 0, ctypes.byref(event))
