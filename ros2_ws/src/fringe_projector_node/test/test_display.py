"""A real window on a virtual display: what is in the display's memory is compared pixel by pixel."""

from __future__ import annotations

import ctypes
import os
import struct
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Self

import numpy as np
import pygame
import pytest
import rclpy

from fringe_projector_node.display import DisplayScreen
from fringedic.errors import ScreenError
from fringedic.patterns import render_pattern
from fringedic.sequence import Orientation, PatternKind, Projection
from fringedic_msgs.srv import ShowPattern
from fringedic_ros.testing import NodeProcess, Peer

pytestmark = pytest.mark.hardware

WIDTH, HEIGHT = 640, 480


class VirtualDisplay:
    """An X server without a screen, whose memory can be read as a file in the format of `xwd`."""

    def __init__(self, folder: Path) -> None:
        self._memory = folder / "Xvfb_screen0"
        read_end, write_end = os.pipe()
        self.process = subprocess.Popen(
            ["Xvfb", "-displayfd", str(write_end), "-screen", "0", f"{WIDTH}x{HEIGHT}x24", "-fbdir", str(folder)],
            pass_fds=[write_end],
            stderr=subprocess.DEVNULL,
        )
        os.close(write_end)
        with open(read_end) as answer:
            self.name = f":{answer.readline().strip()}"

    def screenshot(self) -> np.ndarray:
        """Red, green and blue of every pixel, uint8 (row, column, 3)."""
        memory = self._memory.read_bytes()
        header = np.frombuffer(memory, ">u4", 25)
        start, columns, rows, line, colours = header[[0, 4, 5, 12, 19]].astype(int)
        pixels = np.frombuffer(memory, np.uint8, rows * line, start + 12 * colours)
        return pixels.reshape(rows, line)[:, : 4 * columns].reshape(rows, columns, 4)[:, :, 2::-1]


class WindowManager:
    """Another program that does to windows what a user or a window manager does."""

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
        """Top windows, the uppermost last."""
        root, parent, count = ctypes.c_ulong(), ctypes.c_ulong(), ctypes.c_uint()
        windows = ctypes.POINTER(ctypes.c_ulong)()
        found = (ctypes.byref(each) for each in (root, parent, windows, count))
        self._x11.XQueryTree(self._display, self._root, *found)
        return [windows[number] for number in range(count.value)]

    def do(self, function: str, window: int, *values: int) -> None:
        """Call a function of Xlib on a window."""
        getattr(self._x11, function)(self._display, ctypes.c_ulong(window), *values)
        self._x11.XSync(self._display, 0)

    def close(self, window: int) -> None:
        """Ask the window to close, as its button does: a ClientMessage of WM_PROTOCOLS."""
        protocols, delete = (
            self._x11.XInternAtom(self._display, name, 0) for name in (b"WM_PROTOCOLS", b"WM_DELETE_WINDOW")
        )
        fields = (33, 0, 1, self._display.value, window, protocols, 32, delete, 0, 0, 0, 0)
        message = struct.pack("iPiPLLi4xl4l32x", *fields)
        event = ctypes.create_string_buffer(message, 192)
        self.do("XSendEvent", window, 0, 0, ctypes.byref(event))


def shown_in_time(display: VirtualDisplay, pattern: np.ndarray) -> bool:
    """Whether the display shows a pattern before long."""
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        if np.array_equal(display.screenshot()[:, :, 0], pattern):
            return True
        time.sleep(0.01)
    return False


@pytest.fixture
def display(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[VirtualDisplay]:
    folder = tmp_path / "display"
    folder.mkdir()
    display = VirtualDisplay(folder)
    monkeypatch.setenv("DISPLAY", display.name)
    yield display
    pygame.display.quit()
    display.process.terminate()
    display.process.wait()


@pytest.mark.parametrize(
    "projection",
    [
        Projection(PatternKind.FRINGES, Orientation.VERTICAL, 10.0, 3, 8),
        Projection(PatternKind.FRINGES, Orientation.HORIZONTAL, 16.0, 1, 4),
        Projection(PatternKind.WHITE),
    ],
)
def test_every_pixel_is_the_patterns(display: VirtualDisplay, projection: Projection) -> None:
    pattern = render_pattern(projection, WIDTH, HEIGHT)
    screen = DisplayScreen(0, WIDTH, HEIGHT)
    before = time.time_ns()
    shown = screen.show(pattern)
    assert before < shown <= time.time_ns()
    assert shown_in_time(display, pattern)
    for colour in range(3):
        np.testing.assert_array_equal(display.screenshot()[:, :, colour], pattern)
    screen.close()


@pytest.mark.parametrize(
    ("number", "size", "words"),
    [
        (3, (WIDTH, HEIGHT), "no display 3; there are 0: 640x480 px"),
        (0, (800, 600), "patterns have 800x600 px and display 0 another size; there are 0: 640x480 px"),
    ],
)
def test_wrong_display_is_named(display: VirtualDisplay, number: int, size: tuple[int, int], words: str) -> None:
    with pytest.raises(ScreenError, match=words):
        DisplayScreen(number, *size)


def test_no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(ScreenError, match="there is no display"):
        DisplayScreen(0, WIDTH, HEIGHT)


@pytest.mark.parametrize(
    ("what", "values", "words"),
    [
        ("close", (), "window was closed"),
        ("XResizeWindow", (320, 240), "changed to 320x240 px"),
        ("XMoveWindow", (100, 50), "moved by 100, 50 px"),
        ("XUnmapWindow", (), "window was hidden"),
    ],
)
def test_window_that_is_lost_opens_again(display: VirtualDisplay, what: str, values: tuple, words: str) -> None:
    screen = DisplayScreen(0, WIDTH, HEIGHT)
    pattern = render_pattern(Projection(PatternKind.FRINGES, pitch=20.0, shift=1, shifts=4), WIDTH, HEIGHT)
    screen.show(pattern)
    with WindowManager() as manager:
        if what == "close":
            manager.close(manager.windows()[-1])
        else:
            manager.do(what, manager.windows()[-1], *values)
    deadline = time.monotonic() + 10
    with pytest.raises(ScreenError, match=words):
        while time.monotonic() < deadline:
            screen.check()
            time.sleep(0.01)
    screen.show(pattern)
    assert shown_in_time(display, pattern)
    screen.close()


def test_node_shows_on_the_display(display: VirtualDisplay, tmp_path: Path) -> None:
    """What the service answers for is on the display; a pattern of the set-up, too."""
    rclpy.init()
    operator = Peer()
    show = operator.create_client(ShowPattern, "projector/show")
    parameters = {"screen": "display", "width_px": WIDTH, "height_px": HEIGHT}
    try:
        with NodeProcess("fringe_projector_node.projector_node", tmp_path, parameters):
            operator.wait(show.service_is_ready, "the projector's service")
            for request, name in (
                (ShowPattern.Request(kind=1, pitch=20.0, shift=2, shifts=4), ""),
                (ShowPattern.Request(kind=2, name="crosshair"), "crosshair"),
                (ShowPattern.Request(kind=2, name="focus"), "focus"),
            ):
                future = show.call_async(request)
                operator.wait(future.done, "the answer", 10)
                assert future.result().error_code == ShowPattern.Request.NONE, future.result().error_message
                projection = Projection(
                    PatternKind(request.kind), pitch=request.pitch, shift=request.shift, shifts=request.shifts
                )
                expected = render_pattern(projection, WIDTH, HEIGHT, name)
                operator.wait(
                    lambda expected=expected: np.array_equal(display.screenshot()[:, :, 1], expected),
                    f"the pattern {projection} {name} on the display",
                    10,
                )
    finally:
        operator.destroy_node()
        rclpy.shutdown()
