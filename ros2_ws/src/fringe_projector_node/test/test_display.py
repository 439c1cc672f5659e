"""A real window on a virtual display: what is in the display's memory is compared pixel by pixel."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pygame
import pytest
import rclpy
from pygame._sdl2 import sdl2, video

from fringe_projector_node.display import DisplayScreen
from fringe_projector_node.testing import VirtualDisplay, WindowManager
from fringedic.errors import ScreenError
from fringedic.patterns.pattern import Orientation, PatternKind, ProjectedPattern
from fringedic.patterns.render import render_pattern
from fringedic.settings.projector import DisplayProjector
from fringedic_msgs.srv import ShowPattern
from fringedic_ros.testing import NodeProcess, Peer

pytestmark = pytest.mark.hardware

WIDTH, HEIGHT = 640, 480
PROJECTOR = DisplayProjector(width=WIDTH, height=HEIGHT)


def shown_in_time(display: VirtualDisplay, pattern: np.ndarray) -> bool:
    """Whether the display shows a pattern before long."""
    deadline = time.monotonic() + 180
    while time.monotonic() < deadline:
        if np.array_equal(display.screenshot()[:, :, 0], pattern):
            return True
        time.sleep(0.01)
    return False


@pytest.fixture
def display(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[VirtualDisplay]:
    folder = tmp_path / "display"
    folder.mkdir()
    with VirtualDisplay(folder, WIDTH, HEIGHT) as display:
        monkeypatch.setenv("DISPLAY", display.name)
        yield display
        pygame.display.quit()


@pytest.mark.parametrize(
    "projection",
    [
        ProjectedPattern(PatternKind.FRINGES, Orientation.VERTICAL, 10.0, 3, 8),
        ProjectedPattern(PatternKind.FRINGES, Orientation.HORIZONTAL, 16.0, 1, 4),
        ProjectedPattern(PatternKind.WHITE),
    ],
)
def test_every_pixel_is_the_patterns(display: VirtualDisplay, projection: ProjectedPattern) -> None:
    pattern = render_pattern(projection, WIDTH, HEIGHT)
    screen = DisplayScreen(PROJECTOR)
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
@pytest.mark.usefixtures("display")
def test_wrong_display_is_named(number: int, size: tuple[int, int], words: str) -> None:
    with pytest.raises(ScreenError, match=words):
        DisplayScreen(DisplayProjector(display=number, width=size[0], height=size[1]))


def test_no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(ScreenError, match="there is no display"):
        DisplayScreen(PROJECTOR)


def refuse(*_: object, **__: object) -> None:
    """Fail like a graphics driver: this error is no `pygame.error`."""
    raise sdl2.error("out of memory")


def test_graphics_driver_that_fails(display: VirtualDisplay, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as failing:
        failing.setattr(video, "Renderer", refuse)
        with pytest.raises(ScreenError, match="a window cannot be opened on display 0: out of memory; check"):
            DisplayScreen(PROJECTOR)
    screen = DisplayScreen(PROJECTOR)
    pattern = render_pattern(ProjectedPattern(PatternKind.WHITE), WIDTH, HEIGHT)
    monkeypatch.setattr(screen, "_texture", SimpleNamespace(update=refuse))
    with pytest.raises(ScreenError, match="the display does not accept the pattern: out of memory"):
        screen.show(pattern)
    screen.show(pattern)
    assert shown_in_time(display, pattern), "in a new window"
    screen.close()


def check_for_10_s(screen: DisplayScreen) -> None:
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        screen.check()
        time.sleep(0.01)


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
    screen = DisplayScreen(PROJECTOR)
    pattern = render_pattern(ProjectedPattern(PatternKind.FRINGES, pitch=20.0, shift=1, shifts=4), WIDTH, HEIGHT)
    screen.show(pattern)
    with WindowManager() as manager:
        if what == "close":
            manager.close(manager.windows()[-1])
        else:
            manager.do(what, manager.windows()[-1], *values)
    with pytest.raises(ScreenError, match=words):
        check_for_10_s(screen)
    screen.show(pattern)
    assert shown_in_time(display, pattern)
    screen.close()


def test_display_at_another_resolution_is_refused_until_it_is_restored(display: VirtualDisplay) -> None:
    """No window manager resizes the window, and SDL gets no event."""
    screen = DisplayScreen(PROJECTOR)
    pattern = render_pattern(ProjectedPattern(PatternKind.WHITE), WIDTH, HEIGHT)
    screen.show(pattern)
    display.change_resolution(320, 240)
    for _ in range(2):
        with pytest.raises(ScreenError, match="changed from 640x480 to 320x240 px in all; restore"):
            screen.show(pattern)
    display.change_resolution(WIDTH, HEIGHT)
    screen.show(pattern)
    assert shown_in_time(display, pattern)
    screen.close()


def test_node_shows_on_the_display(display: VirtualDisplay, tmp_path: Path) -> None:
    """The confirmed pattern is on the display, set-up patterns included."""
    rclpy.init()
    operator = Peer()
    show = operator.create_client(ShowPattern, "projector/show")
    parameters = {"source": "display", "width": WIDTH, "height": HEIGHT}
    try:
        with NodeProcess("fringe_projector_node.projector_node", tmp_path, parameters):
            for request, name in (
                (ShowPattern.Request(kind=1, pitch=20.0, shift=2, shifts=4), ""),
                (ShowPattern.Request(kind=2, name="crosshair"), "crosshair"),
                (ShowPattern.Request(kind=2, name="focus"), "focus"),
            ):
                response = operator.ask(show, request, "the projector's answer")
                assert response.error_code == ShowPattern.Request.NONE, response.error_message
                pattern = ProjectedPattern(
                    PatternKind(request.kind), pitch=request.pitch, shift=request.shift, shifts=request.shifts
                )
                expected = render_pattern(pattern, WIDTH, HEIGHT, name)
                operator.wait(
                    lambda expected=expected: np.array_equal(display.screenshot()[:, :, 1], expected),
                    f"the pattern {pattern} {name} on the display",
                    10,
                )
    finally:
        operator.destroy_node()
        rclpy.shutdown()
