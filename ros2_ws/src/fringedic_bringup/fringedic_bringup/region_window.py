"""A window in which a person draws the region of interest, with the mouse or on a touch screen, in gloves as well."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fringedic.errors import RegionError
from fringedic.region import Polygon, Region

HANDLE = 14  # radius of a corner as drawn [window px]
REACH = 28  # how near to a corner counts as on it [window px]
BAR = 72  # height of the buttons [window px]
SMALLEST = (640, 480)  # of the window
MARGIN = 0.9  # of the display that the window takes
SHADE = 0.45  # brightness outside the region
GREEN, RED, WHITE, GREY, DARK = (60, 220, 90), (255, 80, 70), (255, 255, 255), (70, 70, 76), (24, 24, 28)
BUTTONS = ("undo", "next part", "hole", "done", "cancel")
HELP = "click: corner   drag: move it   right click: undo   N: next part   H: hole   Enter: done   Esc: cancel"

Point = tuple[float, float]


@dataclass
class Drawing:
    """The polygons while they are drawn; knows nothing of windows.

    Attributes
    ----------
    width, height
        Of the image [px].
    finished
        Closed polygons.
    points
        Corners of the open one, (column, row) [px].
    hole
        Whether the open one is cut out.
    """

    width: int
    height: int
    finished: list[Polygon] = field(default_factory=list)
    points: list[Point] = field(default_factory=list)
    hole: bool = False

    def add(self, point: Point) -> None:
        """Add a corner; beside the image it is taken to its edge."""
        self.points.append(self._inside(point))

    def move(self, index: int, point: Point) -> None:
        """Move a corner of the open polygon."""
        self.points[index] = self._inside(point)

    def undo(self) -> None:
        """Take back the last corner; when there is none, open the polygon before again."""
        if self.points:
            self.points.pop()
        elif self.finished:
            last = self.finished.pop()
            self.points, self.hole = list(last.points), last.hole

    def begin(self, *, hole: bool) -> str:
        """Close the open polygon and begin another; return in words why not, empty when it was done."""
        if self.points and len(self.points) < 3:
            return "three corners at least make a polygon"
        if self.points:
            self.finished.append(Polygon(tuple(self.points), self.hole))
        if hole and not self.finished:
            return "draw a part first, then a hole in it"
        self.points, self.hole = [], hole
        return ""

    def region(self) -> Region:
        """Return what has been drawn, the open polygon closed.

        Raises
        ------
        RegionError
            There is no polygon, or one has fewer than three corners, or the holes leave nothing.
        """
        polygons = list(self.finished)
        if self.points:
            if len(self.points) < 3:
                raise RegionError("three corners at least make a polygon")
            polygons.append(Polygon(tuple(self.points), self.hole))
        if not polygons:
            raise RegionError("nothing is drawn yet: click the corners of the region")
        region = Region(self.width, self.height, tuple(polygons))
        region.mask_for((self.height, self.width))
        return region

    def nearest(self, point: Point, reach: float) -> int | None:
        """Return the corner of the open polygon that is nearest, None when none is within `reach` [px]."""
        distances = [math.dist(point, corner) for corner in self.points]
        index = min(range(len(distances)), key=distances.__getitem__, default=None)
        return index if index is not None and distances[index] <= reach else None

    def _inside(self, point: Point) -> Point:
        return min(max(point[0], 0.0), self.width - 1.0), min(max(point[1], 0.0), self.height - 1.0)


def draw_region(image: np.ndarray) -> Region | None:
    """Open a window and let a person draw; None when he cancels or closes it.

    Parameters
    ----------
    image
        Grey image (row, column) of unsigned integers.

    Raises
    ------
    RegionError
        There is no display.
    """
    return _Window(image).run()


class _Window:
    """Pygame's window: events in, pictures out."""

    def __init__(self, image: np.ndarray) -> None:
        os.environ["PYGAME_HIDE_SUPPORT_PROMPT"] = "1"
        import pygame

        self._pygame: Any = pygame
        rows, columns = image.shape
        self._drawing = Drawing(columns, rows)
        self._words = HELP
        self._dragged: int | None = None
        if not os.environ.get("DISPLAY") and not os.environ.get("WAYLAND_DISPLAY"):
            raise RegionError("there is no display to draw on: neither DISPLAY nor WAYLAND_DISPLAY is set")
        try:
            pygame.display.init()
            pygame.font.init()
            desktop = pygame.display.get_desktop_sizes()[0]
            room = MARGIN * desktop[0], MARGIN * desktop[1] - 2 * BAR
            self._scale = min(room[0] / columns, room[1] / rows, 8.0)
            size = round(columns * self._scale), round(rows * self._scale)
            window = max(size[0], SMALLEST[0]), max(size[1] + 2 * BAR, SMALLEST[1])
            self._screen = pygame.display.set_mode(window)
        except pygame.error as error:
            raise RegionError(f"there is no display to draw on: {error}") from error
        pygame.display.set_caption("region of interest")
        self._font = pygame.font.Font(None, 30)
        low, high = np.percentile(image, (0.5, 99.5))
        grey = np.clip((image - low) * (255 / max(high - low, 1)), 0, 255).astype(np.uint8)
        whole = pygame.surfarray.make_surface(np.repeat(grey.T[:, :, None], 3, axis=2))
        self._picture = pygame.transform.smoothscale(whole, size)
        self._size = size

    def run(self) -> Region | None:
        """Take events until a person is done."""
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
                            return self._drawing.region()
                        except RegionError as error:
                            self._words = str(error)
                    elif command is not None:
                        self._do(command)
                self._draw()
                clock.tick(30)
        finally:
            pygame.display.quit()

    def _command(self, event: Any) -> str | None:
        """Name what an event asks for; corners are dealt with at once."""
        pygame = self._pygame
        if event.type == pygame.QUIT:
            return "cancel"
        if event.type == pygame.KEYDOWN:
            keys = {
                pygame.K_RETURN: "done",
                pygame.K_KP_ENTER: "done",
                pygame.K_ESCAPE: "cancel",
                pygame.K_h: "hole",
                pygame.K_n: "next part",
                pygame.K_BACKSPACE: "undo",
            }
            return keys.get(event.key)
        if event.type == pygame.MOUSEBUTTONDOWN and event.button == 3:
            return "undo"
        if event.type == pygame.MOUSEBUTTONDOWN and event.button == 1:
            if event.pos[1] >= self._size[1]:
                return self._button(event.pos)
            point = self._pixel(event.pos)
            self._dragged = self._drawing.nearest(point, REACH / self._scale)
            if self._dragged is None:
                self._drawing.add(point)
                self._dragged = len(self._drawing.points) - 1
            self._words = HELP
        elif event.type == pygame.MOUSEMOTION and self._dragged is not None:
            self._drawing.move(self._dragged, self._pixel(event.pos))
        elif event.type == pygame.MOUSEBUTTONUP and event.button == 1:
            self._dragged = None
        return None

    def _do(self, command: str) -> None:
        if command == "undo":
            self._drawing.undo()
            self._words = HELP
        else:
            self._words = self._drawing.begin(hole=command == "hole") or HELP

    def _pixel(self, position: tuple[int, int]) -> Point:
        return (position[0] + 0.5) / self._scale - 0.5, (position[1] + 0.5) / self._scale - 0.5

    def _place(self, point: Point) -> Point:
        return (point[0] + 0.5) * self._scale - 0.5, (point[1] + 0.5) * self._scale - 0.5

    def _button(self, position: tuple[int, int]) -> str | None:
        wide, top = self._screen.get_width() / len(BUTTONS), self._size[1] + BAR
        return BUTTONS[min(int(position[0] / wide), len(BUTTONS) - 1)] if position[1] >= top else None

    def _draw(self) -> None:
        pygame, drawing = self._pygame, self._drawing
        self._screen.fill(DARK)
        self._screen.blit(self._picture, (0, 0))
        shown = [*drawing.finished, Polygon(tuple(drawing.points), drawing.hole)]
        shade = pygame.Surface(self._size, pygame.SRCALPHA)
        shade.fill((0, 0, 0, round(255 * (1 - SHADE))))
        for polygon in shown:
            if len(polygon.points) > 2:
                alpha = round(255 * (1 - SHADE)) if polygon.hole else 0
                pygame.draw.polygon(shade, (0, 0, 0, alpha), [self._place(point) for point in polygon.points])
        if any(len(polygon.points) > 2 for polygon in shown):
            self._screen.blit(shade, (0, 0))
        for polygon in shown:
            places = [self._place(point) for point in polygon.points]
            colour = RED if polygon.hole else GREEN
            if len(places) > 1:
                pygame.draw.lines(self._screen, colour, polygon in drawing.finished or len(places) > 2, places, 3)
        for place in map(self._place, drawing.points):
            pygame.draw.circle(self._screen, RED if drawing.hole else GREEN, place, HANDLE)
            pygame.draw.circle(self._screen, WHITE, place, HANDLE, 3)
        self._draw_bars()
        pygame.display.flip()

    def _draw_bars(self) -> None:
        pygame = self._pygame
        width = self._screen.get_width()
        words = self._font.render(self._words, True, WHITE)
        if words.get_width() > width - 20:
            words = pygame.transform.smoothscale(words, (width - 20, words.get_height()))
        self._screen.blit(words, (10, self._size[1] + (BAR - words.get_height()) // 2))
        wide, top = width / len(BUTTONS), self._size[1] + BAR
        for number, name in enumerate(BUTTONS):
            box = pygame.Rect(round(number * wide) + 3, top + 3, round(wide) - 6, BAR - 6)
            on = name == "hole" and self._drawing.hole
            pygame.draw.rect(self._screen, RED if on else GREY, box, border_radius=10)
            label = self._font.render(name, True, WHITE)
            self._screen.blit(label, label.get_rect(center=box.center))
