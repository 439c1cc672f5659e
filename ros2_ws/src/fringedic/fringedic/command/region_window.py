"""A window in which a person draws the region of interest with the mouse or on a touch screen, also with gloves."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from fringedic.errors import ImageError
from fringedic.frames.region import Polygon, Region

HANDLE = 14  # radius of a drawn corner [window px]
REACH = 28  # largest distance of a click from the corner that it drags [window px]
BAR = 72  # height of the buttons [window px]
SMALLEST = (640, 480)  # size of the window [px]
MARGIN = 0.9  # largest fraction of the display
LARGEST_SCALE = 8.0  # of a small image
SHADE = 0.45  # brightness outside the region
GREEN, RED, WHITE, GREY, DARK = (60, 220, 90), (255, 80, 70), (255, 255, 255), (70, 70, 76), (24, 24, 28)
TOO_FEW = "a polygon needs at least three corners"
BUTTONS = ("undo", "next part", "hole", "done", "cancel")
SCALE_HELP = "click the two ends of the known length   drag: move   right click: undo   Enter: done   Esc: cancel"
HELP = "click: corner   drag: move it   right click: undo   N: next part   H: hole   Enter: done   Esc: cancel"

Point = tuple[float, float]
Drawn = TypeVar("Drawn")


@dataclass
class Drawing:
    """The polygons while they are drawn, independent of the window.

    Attributes
    ----------
    width, height
        Size of the image [px].
    finished
        Closed polygons.
    points
        Corners of the open polygon, (column, row) [px].
    hole
        Whether the open polygon is a hole.
    """

    width: int
    height: int
    finished: list[Polygon] = field(default_factory=list)
    points: list[Point] = field(default_factory=list)
    hole: bool = False

    def add(self, point: Point) -> None:
        """Add a corner; outside the image it is moved to the edge."""
        self.points.append(self._inside(point))

    def move(self, index: int, point: Point) -> None:
        """Move a corner of the open polygon."""
        self.points[index] = self._inside(point)

    def undo(self) -> None:
        """Remove the last corner; without one, open the previous polygon again."""
        if self.points:
            self.points.pop()
        elif self.finished:
            last = self.finished.pop()
            self.points, self.hole = list(last.points), last.hole

    def begin(self, *, hole: bool) -> str:
        """Close the open polygon and begin another; return the reason when that is not possible, otherwise empty."""
        if self.points and len(self.points) < 3:
            return TOO_FEW
        if self.points:
            self.finished.append(Polygon(tuple(self.points), self.hole))
        if hole and not self.finished:
            return "draw a part before the hole in it"
        self.points, self.hole = [], hole
        return ""

    def region(self) -> Region:
        """Return the region of all polygons; the open one is closed.

        Raises
        ------
        ImageError
            There is no polygon, one has fewer than three corners, or the holes cover everything.
        """
        polygons = list(self.finished)
        if self.points:
            if len(self.points) < 3:
                raise ImageError(TOO_FEW)
            polygons.append(Polygon(tuple(self.points), self.hole))
        if not polygons:
            raise ImageError("no region is drawn: click its corners")
        region = Region(tuple(polygons), self.width, self.height)
        region.mask_for((self.height, self.width))
        return region

    def two_points(self) -> tuple[Point, Point]:
        """Return the two points of a length.

        Raises
        ------
        ImageError
            There are not two different points.
        """
        if len(self.points) != 2 or self.points[0] == self.points[1]:
            raise ImageError("click two different points, the ends of the known length")
        return self.points[0], self.points[1]

    def nearest(self, point: Point, reach: float) -> int | None:
        """Return the number of the nearest corner of the open polygon; None when none is within `reach` [px]."""
        distances = [math.dist(point, corner) for corner in self.points]
        index = min(range(len(distances)), key=distances.__getitem__, default=None)
        return index if index is not None and distances[index] <= reach else None

    def _inside(self, point: Point) -> Point:
        return min(max(point[0], 0.0), self.width - 1.0), min(max(point[1], 0.0), self.height - 1.0)


def draw_region(image: np.ndarray) -> Region | None:
    """Open a window in which a person draws a region.

    Parameters
    ----------
    image
        Grey levels, unsigned integers of shape (row, column).

    Returns
    -------
    Region or None
        None when the person cancels or closes the window.

    Raises
    ------
    ImageError
        There is no display.
    """
    return _Window(image, Drawing.region, HELP).run()


def draw_scale(image: np.ndarray, length: float) -> float:
    """Open a window in which a person clicks the two ends of a known length; return the size of a pixel [m].

    Parameters
    ----------
    image
        Grey levels, unsigned integers of shape (row, column).
    length
        The known length [m].

    Raises
    ------
    ImageError
        There is no display, the person cancels, or the two points are the same.
    """
    points = _Window(image, Drawing.two_points, SCALE_HELP).run()
    if points is None:
        raise ImageError("no length was clicked; give the scale as --pixel-size-mm")
    return length / math.dist(*points)


class _Outline(NamedTuple):
    """A polygon as it is drawn: closed from three corners on, (column, row) [px]."""

    points: Sequence[Point]
    hole: bool

    @property
    def is_closed(self) -> bool:
        return len(self.points) > 2


class _Window(Generic[Drawn]):
    """The window: turns the events of pygame into calls of `Drawing` and draws the polygons.

    Parameters
    ----------
    image
        Grey levels, unsigned integers of shape (row, column).
    finish
        Returns the result of the drawing; raises ImageError while it is not complete.
    words
        Help below the image.
    """

    def __init__(self, image: np.ndarray, finish: Callable[[Drawing], Drawn], words: str) -> None:
        os.environ["PYGAME_HIDE_SUPPORT_PROMPT"] = "1"
        import pygame

        self._pygame: Any = pygame
        rows, columns = image.shape
        self._drawing = Drawing(columns, rows)
        self._finish, self._help = finish, words
        self._words = words
        self._dragged: int | None = None
        if not os.environ.get("DISPLAY") and not os.environ.get("WAYLAND_DISPLAY"):
            raise ImageError("no display: neither DISPLAY nor WAYLAND_DISPLAY is set; start the command on a desktop")
        try:
            pygame.display.init()
            pygame.font.init()
            desktop = pygame.display.get_desktop_sizes()[0]
            room = MARGIN * desktop[0], MARGIN * desktop[1] - 2 * BAR
            self._scale = min(room[0] / columns, room[1] / rows, LARGEST_SCALE)
            size = round(columns * self._scale), round(rows * self._scale)
            window = max(size[0], SMALLEST[0]), max(size[1] + 2 * BAR, SMALLEST[1])
            self._screen = pygame.display.set_mode(window)
        except pygame.error as error:
            raise ImageError(f"no display: {error}; start the command on a desktop") from error
        pygame.display.set_caption("region of interest")
        self._font = pygame.font.Font(None, 30)
        low, high = np.percentile(image, (0.5, 99.5))
        grey = np.clip((image - low) * (255 / max(high - low, 1)), 0, 255).astype(np.uint8)
        whole = pygame.surfarray.make_surface(np.repeat(grey.T[:, :, None], 3, axis=2))
        self._picture = pygame.transform.smoothscale(whole, size)
        self._size = size

    def run(self) -> Drawn | None:
        """Handle events until the person is done."""
        pygame = self._pygame
        clock = pygame.time.Clock()
        try:
            while True:
                for event in pygame.event.get():
                    command = self._command(event)
                    if command == "cancel":
                        return None
                    if command == "done":
                        try:
                            return self._finish(self._drawing)
                        except ImageError as error:
                            self._words = str(error)
                    elif command is not None:
                        self._do(command)
                self._draw()
                clock.tick(30)
        finally:
            pygame.display.quit()

    def _command(self, event: Any) -> str | None:
        """Return the command of an event, None without one; corners are added and moved at once."""
        pygame = self._pygame
        if event.type == pygame.QUIT:
            return "cancel"
        if event.type == pygame.KEYDOWN:
            return self._key(event.key)
        if event.type == pygame.MOUSEBUTTONDOWN:
            return self._press(event)
        if event.type == pygame.MOUSEMOTION and self._dragged is not None:
            self._drawing.move(self._dragged, self._pixel(event.pos))
        if event.type == pygame.MOUSEBUTTONUP and event.button == 1:
            self._dragged = None
        return None

    def _key(self, key: int) -> str | None:
        pygame = self._pygame
        commands = {
            pygame.K_RETURN: "done",
            pygame.K_KP_ENTER: "done",
            pygame.K_ESCAPE: "cancel",
            pygame.K_h: "hole",
            pygame.K_n: "next part",
            pygame.K_BACKSPACE: "undo",
        }
        return commands.get(key)

    def _press(self, event: Any) -> str | None:
        """Return the command of a mouse button; in the image the left button adds a corner or starts to drag one."""
        if event.button == 3:
            return "undo"
        if event.button != 1:
            return None
        if event.pos[1] >= self._size[1]:
            return self._button(event.pos)
        point = self._pixel(event.pos)
        self._dragged = self._drawing.nearest(point, REACH / self._scale)
        if self._dragged is None:
            self._drawing.add(point)
            self._dragged = len(self._drawing.points) - 1
        self._words = self._help
        return None

    def _do(self, command: str) -> None:
        if command == "undo":
            self._drawing.undo()
            self._words = self._help
        else:
            self._words = self._drawing.begin(hole=command == "hole") or self._help

    def _pixel(self, position: tuple[int, int]) -> Point:
        return (position[0] + 0.5) / self._scale - 0.5, (position[1] + 0.5) / self._scale - 0.5

    def _place(self, point: Point) -> Point:
        return (point[0] + 0.5) * self._scale - 0.5, (point[1] + 0.5) * self._scale - 0.5

    def _button(self, position: tuple[int, int]) -> str | None:
        wide, top = self._screen.get_width() / len(BUTTONS), self._size[1] + BAR
        return BUTTONS[min(int(position[0] / wide), len(BUTTONS) - 1)] if position[1] >= top else None

    def _draw(self) -> None:
        drawing = self._drawing
        self._screen.fill(DARK)
        self._screen.blit(self._picture, (0, 0))
        outlines = [_Outline(polygon.points, polygon.hole) for polygon in drawing.finished]
        outlines.append(_Outline(drawing.points, drawing.hole))
        self._shade_outside([outline for outline in outlines if outline.is_closed])
        self._draw_outlines(outlines)
        self._draw_message()
        self._draw_buttons()
        self._pygame.display.flip()

    def _shade_outside(self, outlines: list[_Outline]) -> None:
        pygame, dark = self._pygame, round(255 * (1 - SHADE))
        if not outlines:
            return
        shade = pygame.Surface(self._size, pygame.SRCALPHA)
        shade.fill((0, 0, 0, dark))
        for outline in outlines:
            places = [self._place(point) for point in outline.points]
            pygame.draw.polygon(shade, (0, 0, 0, dark if outline.hole else 0), places)
        self._screen.blit(shade, (0, 0))

    def _draw_outlines(self, outlines: list[_Outline]) -> None:
        pygame, drawing = self._pygame, self._drawing
        for outline in outlines:
            places = [self._place(point) for point in outline.points]
            if len(places) > 1:
                pygame.draw.lines(self._screen, RED if outline.hole else GREEN, outline.is_closed, places, 3)
        for place in map(self._place, drawing.points):
            pygame.draw.circle(self._screen, RED if drawing.hole else GREEN, place, HANDLE)
            pygame.draw.circle(self._screen, WHITE, place, HANDLE, 3)

    def _draw_message(self) -> None:
        width = self._screen.get_width()
        words = self._font.render(self._words, True, WHITE)
        if words.get_width() > width - 20:
            words = self._pygame.transform.smoothscale(words, (width - 20, words.get_height()))
        self._screen.blit(words, (10, self._size[1] + (BAR - words.get_height()) // 2))

    def _draw_buttons(self) -> None:
        pygame = self._pygame
        wide, top = self._screen.get_width() / len(BUTTONS), self._size[1] + BAR
        for number, name in enumerate(BUTTONS):
            box = pygame.Rect(round(number * wide) + 3, top + 3, round(wide) - 6, BAR - 6)
            on = name == "hole" and self._drawing.hole
            pygame.draw.rect(self._screen, RED if on else GREY, box, border_radius=10)
            label = self._font.render(name, True, WHITE)
            self._screen.blit(label, label.get_rect(center=box.center))
